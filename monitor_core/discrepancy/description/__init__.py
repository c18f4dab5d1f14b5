"""Describe what no catalogue names: which quantity varies over the settings, where, and by which law."""
