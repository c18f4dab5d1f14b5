"""What commands read: sessions, modal tables, drive models."""
