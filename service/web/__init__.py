"""Serve pages rendered on the server. Everything they load comes from this package; there is no build step."""
