"""Runs: an action on a mission, from the queue to what it left."""
