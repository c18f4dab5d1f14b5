"""Recordings in and out: upload, look into, take as windows; stored windows as a session or a table."""
