"""Find the minimum: local and global least squares, fits of a hypothesis, posterior modes."""
