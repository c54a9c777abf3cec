"""Backups of a site: its database as of one moment, and every object that this names, each kept once among all backups.

Run by whoever runs the server, on its machine, never by a request: `docs/decisions/0021-backup.md` says why it is so.
"""
