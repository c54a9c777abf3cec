"""Kleinkram keeps every recording a robotics lab makes: organised, proven intact, findable down to the topic."""

__version__ = "0.1.0"
