"""Files: names in a mission for bytes in a store."""
