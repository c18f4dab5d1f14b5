"""Locate a misfit and say what kind it is."""
