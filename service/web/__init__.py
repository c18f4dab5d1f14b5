"""Server-rendered pages. Everything they load comes from this package; there is no build step."""
