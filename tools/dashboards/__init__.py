"""The Grafana dashboards of `deploy/observability`, as code."""
