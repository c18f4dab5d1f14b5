"""Store everything that is kept: tables, one repository per resource, raw waveforms. All SQL of the service is here."""
