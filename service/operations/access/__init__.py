"""Users, keys, scopes, and the log of every change."""
