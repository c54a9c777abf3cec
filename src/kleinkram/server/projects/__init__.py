"""Projects, and the metadata fields that they declare."""
