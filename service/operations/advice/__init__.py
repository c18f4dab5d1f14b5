"""Say what to check next: causes, effects, checks, tools and times, from one table that a file can add to."""
