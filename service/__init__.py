"""The service around the core: HTTP, storage, jobs, command line, pages. It knows no physics."""
