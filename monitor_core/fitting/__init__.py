"""The bench: described axes, observations, residuals, fits and their evidence."""
