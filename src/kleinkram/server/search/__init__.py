"""Search across missions, files and topics, with facets and statistics."""
