"""Tokens: making, listing and revoking them. What one may do is decided in `access`."""
