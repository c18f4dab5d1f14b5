"""Any prediction beside any measurement: residuals in units of noise, errors of settings, the form of the model."""
