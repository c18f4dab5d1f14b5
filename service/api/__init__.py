"""HTTP resources: one file each, router and wire models together. Routers never touch SQL."""
