"""Prometheus metrics of this process: the registry, and the counters of requests and jobs."""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, disable_created_metrics

import kleinkram

disable_created_metrics()  # type: ignore[no-untyped-call]  # untyped; the _created series double the number of series
REGISTRY = CollectorRegistry()
ProcessCollector(registry=REGISTRY)
Gauge("kleinkram_build_info", "The version of this process.", ["version"], registry=REGISTRY).labels(
    kleinkram.__version__
).set(1)
REQUESTS = Counter("kleinkram_requests", "Requests answered.", ["method", "route", "status"], registry=REGISTRY)
REQUEST_SECONDS = Histogram(
    "kleinkram_request_duration_seconds",
    "Time to answer a request.",
    ["method", "route"],
    buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 10),
    registry=REGISTRY,
)
JOB_ATTEMPTS = Counter(
    "kleinkram_job_attempts",
    "Attempts at jobs: succeeded, failed (it is tried again), given_up or aborted.",
    ["task", "outcome"],
    registry=REGISTRY,
)
JOB_SECONDS = Histogram(
    "kleinkram_job_duration_seconds",
    "How long an attempt at a job took.",
    ["task"],
    buckets=(0.1, 0.5, 1, 5, 10, 60, 300, 1800, 7200),
    registry=REGISTRY,
)
