"""Reach a service: through a client over HTTP, or inside this process."""
