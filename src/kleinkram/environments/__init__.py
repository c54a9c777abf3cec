"""Environments of scripts: their dependencies, locked with hashes and installed from wheels in a folder.

The server makes locks; runners and `klein action run-local` install them. No code of a package runs for either: only
wheels are used, which are unpacked. All network access is that of `uv`.
"""
