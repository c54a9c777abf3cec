"""Backups of a whole instance: its database at one moment, and every object that the database names.

Run by the operator on the server's machine, never by a request. Decision 0021 explains the design.
"""
