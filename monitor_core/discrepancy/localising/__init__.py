"""Where a misfit sits and of which kind it is, with tests that hold their level."""
