"""Home: what somebody finds when they come."""
