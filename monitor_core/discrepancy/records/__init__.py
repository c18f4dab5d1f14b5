"""Look at single records: wrongly tagged, with a wrong gain, or wrong altogether."""
