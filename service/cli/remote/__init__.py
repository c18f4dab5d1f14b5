"""A service to talk to: a client over HTTP, and one inside this process."""
