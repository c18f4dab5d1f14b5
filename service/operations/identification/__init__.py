"""Jobs that identify the joints of an axis."""
