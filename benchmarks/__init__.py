"""Timings against peers and against the bound, in one run; ratios matter, milliseconds do not."""
