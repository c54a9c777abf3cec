"""Tokens: creating, listing and revoking them. Their permissions are checked in `access`."""
