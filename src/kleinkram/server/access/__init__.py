"""Access: the actor of a request, their permissions, and the selects of visible objects that all queries start from."""
