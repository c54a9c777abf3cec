"""The trash: deleted projects, missions and files, until they are purged."""
