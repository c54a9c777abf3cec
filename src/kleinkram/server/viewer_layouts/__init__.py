"""Layouts of the mission viewer: personal ones, and those that all readers of a project share."""
