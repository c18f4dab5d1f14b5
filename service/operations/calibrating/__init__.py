"""New axes and their calibrations: a drive from catalogue data, a plan of what to measure, the fit as a job."""
