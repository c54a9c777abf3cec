"""Formats of recordings, each behind the interface in `base`."""
