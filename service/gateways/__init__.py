"""Connect the service to other protocols: processes of their own that reach it over HTTP, as any client does."""
