"""The server: HTTP API, jobs and the only door to the object store. Bytes of recordings never pass through it."""
