"""Files: paths in a mission for blobs in the store."""
