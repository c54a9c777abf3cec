"""Events: what changed is told to whoever listens and may see it."""
