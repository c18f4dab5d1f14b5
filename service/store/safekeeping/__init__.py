"""Keep what is stored safe: the database's own file, one process at a time, and copies that can be trusted."""
