"""Blobs, the stored bytes of files: summaries, verification, scrubs, and garbage collection."""
