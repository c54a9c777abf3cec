"""Admin: the whole server, for its admins."""
