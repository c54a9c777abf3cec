"""Search: what a filter means, and what is asked across missions and files: topics and statistics."""
