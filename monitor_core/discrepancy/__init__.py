"""Find what a model lacks: where it differs from measurements, which effects may be missing, and which effect is."""
