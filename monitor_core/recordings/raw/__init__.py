"""Read raw files of other programs: named channels, and a map that makes windows of them."""
