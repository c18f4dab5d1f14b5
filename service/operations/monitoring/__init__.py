"""Windows, measurements, trends, alarms and calibrations of the axes."""
