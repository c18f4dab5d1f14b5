"""Serve what every route shares: bodies, limits, error documents, the description of the API."""
