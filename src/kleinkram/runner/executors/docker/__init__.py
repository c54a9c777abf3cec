"""Runs jobs as containers of an engine with the Docker Engine API: Docker or Podman."""
