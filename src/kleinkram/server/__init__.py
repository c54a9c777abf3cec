"""The server: HTTP API and background jobs. Bytes of recordings go directly between clients and the object store."""
