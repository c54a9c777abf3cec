"""Backups of a whole instance: its database at one moment, and every object that the database names.

Run by whoever operates the server, on its machine, never by a request. Decision 0021 explains the design.
"""
