"""Missions and projects at a glance: files on one axis of time, topics of all recordings together, statistics."""
