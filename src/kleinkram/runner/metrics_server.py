"""Serves the Prometheus metrics of a runner. Needs prometheus-client, which the extra `metrics` installs."""

import contextlib
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from prometheus_client import CollectorRegistry, Metric, ProcessCollector, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

import kleinkram
from kleinkram import metric_definitions as definitions
from kleinkram.client.errors import InvalidInput
from kleinkram.metric_definitions import MetricDefinition, MetricKind, MetricSource
from kleinkram.runner.loop import Runner


@contextlib.contextmanager
def serve_metrics(runner: Runner, directory: Path, address: str, port: int) -> Iterator[int]:
    """Serve the metrics of a runner from a thread; yields the port. `directory` is that of its data.

    Raises:
        InvalidInput: the port cannot be opened.
    """
    registry = CollectorRegistry()
    ProcessCollector(registry=registry)
    registry.register(_RunnerCollector(runner, directory))
    try:
        server, thread = start_http_server(port, address, registry)
    except OSError as error:
        reason = f"metrics cannot be served on {address}:{port} ({error.strerror or error})"
        raise InvalidInput(what="The option --metrics-port", reason=reason) from None
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


_RESOURCES = {
    definitions.RUNNER_CORES: "cores",
    definitions.RUNNER_MEMORY_BYTES: "memory_bytes",
    definitions.RUNNER_DISK_BYTES: "disk_bytes",
    definitions.RUNNER_GPUS: "gpus",
}


class _RunnerCollector(Collector):
    """Reads the state of a runner when it is scraped."""

    def __init__(self, runner: Runner, directory: Path) -> None:
        self._runner = runner
        self._directory = directory

    def collect(self) -> Iterator[Metric]:
        statistics, capacity, reserved = self._runner.statistics, self._runner.capacity, self._runner.reserved()
        info = definitions.BUILD_INFO
        build = GaugeMetricFamily(info.name, info.meaning, labels=info.labels)
        build.add_metric([kleinkram.__version__, MetricSource.runner.name], 1)
        yield build
        yield _metric(definitions.RUNNER_RUNS, {"": self._runner.active_count})
        yield _metric(definitions.RUNNER_RUNS_ENDED, statistics.ends())
        yield _metric(definitions.RUNNER_SERVER_ERRORS, statistics.errors())
        yield _metric(definitions.RUNNER_INPUT_BYTES, statistics.input_bytes())
        yield _metric(definitions.RUNNER_LAST_CONTACT, {"": statistics.last_contact_s})
        yield _metric(definitions.RUNNER_FREE_BYTES, {"": shutil.disk_usage(self._directory).free})
        for definition, field in _RESOURCES.items():
            amounts = {"capacity": getattr(capacity, field), "reserved": getattr(reserved, field)}
            yield _metric(definition, amounts)


def _metric(definition: MetricDefinition, values: Mapping[str, float]) -> Metric:
    """Return a metric without labels (its value is that of an empty string), or with one label, 0 where missing."""
    make = CounterMetricFamily if definition.kind is MetricKind.counter else GaugeMetricFamily
    metric = make(definition.name, definition.meaning, labels=definition.labels)
    for label_value, value in {**dict.fromkeys(definition.values, 0), **values}.items():
        metric.add_metric([label_value] if definition.labels else [], value)
    return metric
