"""Prometheus metrics of this process: counters, gauges and histograms by their definitions, and one registry a source.

A counter whose only label has known values starts at zero for each of them.
"""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, disable_created_metrics

from kleinkram import metric_definitions as definitions
from kleinkram.metric_definitions import MetricDefinition, MetricSource

disable_created_metrics()  # type: ignore[no-untyped-call]  # untyped; the _created series double the number of series
# An API process does not export the metrics of workers, nor a worker those of the API.
REGISTRIES = {source: CollectorRegistry() for source in MetricSource}
ProcessCollector(registry=REGISTRIES[MetricSource.process])


def _counter(definition: MetricDefinition) -> Counter:
    counter = Counter(definition.name, definition.meaning, definition.labels, registry=REGISTRIES[definition.source])
    if len(definition.labels) == 1:
        for value in definition.values:
            counter.labels(value)
    return counter


def _gauge(definition: MetricDefinition) -> Gauge:
    return Gauge(definition.name, definition.meaning, definition.labels, registry=REGISTRIES[definition.source])


def _histogram(definition: MetricDefinition) -> Histogram:
    return Histogram(
        definition.name,
        definition.meaning,
        definition.labels,
        buckets=definition.buckets,
        registry=REGISTRIES[definition.source],
    )


BUILD_INFO = _gauge(definitions.BUILD_INFO)

REQUESTS = _counter(definitions.REQUESTS)
REQUEST_SECONDS = _histogram(definitions.REQUEST_SECONDS)
PROBLEMS = _counter(definitions.PROBLEMS)
SIGN_IN_REFUSALS = _counter(definitions.SIGN_IN_REFUSALS)
RATE_LIMITED = _counter(definitions.RATE_LIMITED)
EVENT_STREAMS = _gauge(definitions.EVENT_STREAMS)
LONG_POLLS = _gauge(definitions.LONG_POLLS)
EVENTS = _counter(definitions.EVENTS)
EVENT_LISTENER_UP = _gauge(definitions.EVENT_LISTENER_UP)

DATABASE_CONNECTIONS = _gauge(definitions.DATABASE_CONNECTIONS)
DATABASE_CONNECTIONS_MAX = _gauge(definitions.DATABASE_CONNECTIONS_MAX)
DATABASE_CONNECTIONS_WAITING = _gauge(definitions.DATABASE_CONNECTIONS_WAITING)
DATABASE_CONNECTION_WAIT_SECONDS = _histogram(definitions.DATABASE_CONNECTION_WAIT_SECONDS)
STORE_REQUESTS = _counter(definitions.STORE_REQUESTS)
STORE_REQUEST_SECONDS = _histogram(definitions.STORE_REQUEST_SECONDS)
STORE_READ_BYTES = _counter(definitions.STORE_READ_BYTES)
STORE_CLOCK_OFFSET_SECONDS = _gauge(definitions.STORE_CLOCK_OFFSET_SECONDS)
UPLOAD_FILES = _counter(definitions.UPLOAD_FILES)
UPLOAD_BYTES = _counter(definitions.UPLOAD_BYTES)
DOWNLOAD_FILES = _counter(definitions.DOWNLOAD_FILES)
DOWNLOAD_BYTES = _counter(definitions.DOWNLOAD_BYTES)

JOB_ATTEMPTS = _counter(definitions.JOB_ATTEMPTS)
JOB_SECONDS = _histogram(definitions.JOB_SECONDS)
JOBS_IN_PROGRESS = _gauge(definitions.JOBS_IN_PROGRESS)
RUN_WAIT_SECONDS = _histogram(definitions.RUN_WAIT_SECONDS)
RUN_SECONDS = _histogram(definitions.RUN_SECONDS)
RUNS_ENDED = _counter(definitions.RUNS_ENDED)


def count_uploads(result: str, *, files: int, size_bytes: int) -> None:
    """Count files that arrived, `stored` or `linked`."""
    UPLOAD_FILES.labels(result).inc(files)
    UPLOAD_BYTES.labels(result).inc(size_bytes)


def count_downloads(*, files: int, size_bytes: int) -> None:
    """Count files whose URL a client got."""
    DOWNLOAD_FILES.inc(files)
    DOWNLOAD_BYTES.inc(size_bytes)
