"""Missions, and the metadata that their project requires of them."""
