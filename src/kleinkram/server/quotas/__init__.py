"""Quotas: how much a project may hold, seen to before anything comes into it."""
