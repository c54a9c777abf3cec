"""What is installed, pinned; and whether it has known holes."""
