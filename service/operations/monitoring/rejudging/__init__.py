"""Judge the history of an axis anew under another calibration, aside, and put it in the place of the old one."""
