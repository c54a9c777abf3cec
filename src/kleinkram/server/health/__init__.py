"""Health: liveness and readiness, checks of the installation, and metrics."""
