"""Recordings: which files of a mission make one capture, and what that capture spans."""
