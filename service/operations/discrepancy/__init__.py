"""Jobs that explain discrepancies and alarms."""
