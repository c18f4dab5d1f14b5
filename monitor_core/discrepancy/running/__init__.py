"""Which change explains that the frequency of a running axis moved: recent windows against the reference."""
