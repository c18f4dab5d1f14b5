"""Keeping and letting go: how long raw waveforms stay, what is kept whatever its age, and the purge of the rest."""
