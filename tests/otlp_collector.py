"""A collector of OpenTelemetry for tests: keeps the spans that processes export to it by OTLP over HTTP."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.common.v1.common_pb2 import KeyValue
from opentelemetry.proto.trace.v1.trace_pb2 import Status

from tests.http_server import QuietHandler, serving


class CollectedSpan(NamedTuple):
    """A span that was exported. Ids are hexadecimal; `parent_id` is empty for a root."""

    service: str
    name: str
    trace_id: str
    span_id: str
    parent_id: str
    attributes: dict[str, str | int | float | bool]
    is_error: bool
    started_ns: int


class OtlpCollector:
    """What was exported: the spans, and the bytes of each request."""

    def __init__(self) -> None:
        self.spans: list[CollectedSpan] = []
        self.bodies: list[bytes] = []
        self.url = ""

    def edges(self) -> set[tuple[str, str]]:
        """Return the names of each span's parent and of the span; the parent of a root is empty."""
        names = {span.span_id: span.name for span in self.spans}
        return {(names.get(span.parent_id, ""), span.name) for span in self.spans}

    def named(self, name: str) -> list[CollectedSpan]:
        """Return the spans of a name, in the order of their beginnings."""
        return sorted((span for span in self.spans if span.name == name), key=lambda span: span.started_ns)

    def receive(self, body: bytes) -> None:
        """Keep one request."""
        self.bodies.append(body)
        for of_resource in ExportTraceServiceRequest.FromString(body).resource_spans:
            service = str(_attributes(of_resource.resource.attributes).get("service.name", ""))
            for of_scope in of_resource.scope_spans:
                self.spans += [
                    CollectedSpan(
                        service,
                        span.name,
                        span.trace_id.hex(),
                        span.span_id.hex(),
                        span.parent_span_id.hex(),
                        _attributes(span.attributes),
                        span.status.code == Status.STATUS_CODE_ERROR,
                        span.start_time_unix_nano,
                    )
                    for span in of_scope.spans
                ]


def _attributes(pairs: Iterator[KeyValue]) -> dict[str, str | int | float | bool]:
    values = {}
    for pair in pairs:
        kind = pair.value.WhichOneof("value")
        values[pair.key] = getattr(pair.value, kind) if kind else ""
    return values


@contextmanager
def collecting() -> Iterator[OtlpCollector]:
    """Run a collector on this machine."""
    collector = OtlpCollector()

    class Handler(QuietHandler):
        def do_POST(self) -> None:
            body = self.body()
            collector.receive(gzip.decompress(body) if self.headers["Content-Encoding"] == "gzip" else body)
            self.send(200, headers={"Content-Type": "application/x-protobuf"})

    with serving(Handler) as port:
        collector.url = f"http://127.0.0.1:{port}"
        yield collector
