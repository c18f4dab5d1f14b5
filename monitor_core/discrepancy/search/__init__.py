"""Search for missing effects: textbook physics, one effect after the other, substitutions."""
