"""Who may do what: scopes and roles, passwords and keys, what slows guessing, and the log of every change."""
