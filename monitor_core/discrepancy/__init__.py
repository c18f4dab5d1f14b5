"""Where simulation and measurement part: comparison, the effects that may be missing, and the decision which one is."""
