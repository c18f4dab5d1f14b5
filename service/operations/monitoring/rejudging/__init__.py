"""Judge the history of an axis anew under another calibration, aside, and let it replace the old one."""
