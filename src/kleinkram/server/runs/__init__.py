"""Runs: executions of actions on missions."""
