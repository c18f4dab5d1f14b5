"""Read what commands take: sessions, modal tables, drive models."""
