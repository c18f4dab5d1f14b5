"""Screen effects: predict cheaply what a refit with each of them would gain."""
