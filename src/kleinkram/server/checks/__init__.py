"""Checks of missions: the `checks.yaml` of projects, its evaluation from the index, and verdicts."""
