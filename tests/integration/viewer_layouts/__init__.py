"""Layouts of the viewer through HTTP."""
