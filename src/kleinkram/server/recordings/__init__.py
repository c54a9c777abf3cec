"""Recordings: the files of a mission that belong to one capture."""
