"""Read text files as loggers, controls and scopes write them; how one is written is said, never guessed."""
