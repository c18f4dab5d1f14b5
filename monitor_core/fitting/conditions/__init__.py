"""What data were taken under: settings, groups of values, and errors that a setting shares."""
