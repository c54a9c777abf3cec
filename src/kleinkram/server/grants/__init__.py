"""Grants: who may do what with a project or a mission, and what follows from that for people."""
