"""Give channels a meaning: the channel map, and what is made of raw files with it."""
