"""Runs jobs as Jobs of a Kubernetes cluster."""
