"""Mission events."""
