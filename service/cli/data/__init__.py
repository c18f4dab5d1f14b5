"""Commands that look after the data of a service."""
