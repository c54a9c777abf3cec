"""Shares: links for people without an account. What one shows is decided in `access`."""
