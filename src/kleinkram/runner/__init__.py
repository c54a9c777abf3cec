"""Runs actions: takes a run, gives it its inputs, starts and watches it, and carries home what it left.

Speaks HTTPS to the API, and holds no credential of a database or a store.
"""
