"""The papers' own forms of the drive model: the reference of errata and tests."""
