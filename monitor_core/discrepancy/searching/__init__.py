"""Which effects bring model and measurement together: the fit, the cheap looks, the search and its evidence."""
