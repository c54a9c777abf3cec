"""Missions and their metadata."""
