"""Propose a channel map for a raw file: what seems to be in it, and a text to fill in that says so."""
