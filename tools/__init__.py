"""Chores of this repository that no library does."""
