"""Runs as containers of an engine that speaks Docker's API: Docker, or Podman.

A warden process per run has the container made and started, follows its log, bounds it and writes down how it ended.
It outlives the runner; killed itself, it is replaced, and the container goes on.
"""
