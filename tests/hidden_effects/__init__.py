"""Hidden effects: data of plants that share nothing with the models under test, and what the workflow makes of it."""
