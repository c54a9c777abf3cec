"""Traces: spans of OpenTelemetry, exported by OTLP over HTTP if the environment names an endpoint.

Otherwise nothing of OpenTelemetry is imported, and hot paths test `is_on` once. Attributes are ids, counts, names of
operations and paths without queries: never a signed URL, a header, a body, or the text of an error, which may hold one.

Source: OpenTelemetry specification, "Environment Variable Specification"; W3C Trace Context.
"""

import enum
import importlib.util
import logging
import os
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from kleinkram.opentelemetry_spans import Tracer

_log = logging.getLogger("kleinkram.traces")
_NOT_INSTALLED = "the packages of OpenTelemetry are not installed (pip install 'open-kleinkram[otel]')"
_PACKAGES = ("opentelemetry.sdk.trace", "opentelemetry.exporter.otlp.proto.http")
# A collector that is away must not keep a command, or a process that stops, from ending.
_STOP_TIMEOUT_S = 3.0

Attributes = Mapping[str, str | int | float | bool]
_NONE: Attributes = {}


class Kind(enum.Enum):
    """The role of a span, as in OpenTelemetry."""

    internal = "INTERNAL"
    server = "SERVER"
    client = "CLIENT"
    consumer = "CONSUMER"


class Span(Protocol):
    """A span that has begun."""

    @property
    def traceparent(self) -> str | None:
        """The header `traceparent` for what is done under this span; None without traces."""

    def set(self, attributes: Attributes) -> None:
        """Set attributes."""

    def rename(self, name: str) -> None:
        """Set the name."""

    def fail(self, error_type: str) -> None:
        """Mark the span as failed; `error_type` has few values: the name of an error, or a status."""


class _NoSpan:
    """The span of a process without traces."""

    traceparent = None

    def set(self, attributes: Attributes) -> None:
        """Do nothing."""

    def rename(self, name: str) -> None:
        """Do nothing."""

    def fail(self, error_type: str) -> None:
        """Do nothing."""


_NO_SPAN = _NoSpan()
_tracer: "Tracer | None" = None


def endpoint() -> str | None:
    """Return the URL that the environment names for spans; None if it asks for no traces."""
    if os.environ.get("OTEL_SDK_DISABLED", "").strip().lower() == "true":
        return None
    if os.environ.get("OTEL_TRACES_EXPORTER", "").strip().lower() == "none":
        return None
    if own := os.environ.get("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "").strip():
        return own
    shared = os.environ.get("OTEL_EXPORTER_OTLP_ENDPOINT", "").strip()
    return f"{shared.rstrip('/')}/v1/traces" if shared else None


def misconfiguration() -> str | None:
    """Return why the traces that the environment asks for cannot be exported, or None."""
    url = endpoint()
    if url is None:
        return None
    if not url.startswith(("http://", "https://")):
        return "the address of the collector does not begin with http:// or https://"
    for name in ("OTEL_EXPORTER_OTLP_TRACES_PROTOCOL", "OTEL_EXPORTER_OTLP_PROTOCOL"):
        protocol = os.environ.get(name, "").strip()
        if protocol not in {"", "http/protobuf"}:
            return f"{name} is {protocol!r}, but Kleinkram exports by http/protobuf (usually port 4318)"
    return None if all(_is_installed(name) for name in _PACKAGES) else _NOT_INSTALLED


def _is_installed(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:  # of the package that it is in
        return False


def start(service: str) -> None:
    """Begin to export spans of this process as those of `service`, if the environment asks for traces.

    `OTEL_SERVICE_NAME` overrides the name. In a program that has set a tracer provider, spans go to that one in any
    case.
    """
    global _tracer
    if _tracer is not None or (endpoint() is None and not _has_provider()):
        return
    if not _has_provider() and (reason := misconfiguration()) is not None:
        _log.warning("no traces: %s", reason)
        return
    try:
        from kleinkram.opentelemetry_spans import Tracer
    except ImportError as error:  # installed in part
        _log.warning("no traces: %s; %s", error, _NOT_INSTALLED)
        return
    _tracer = Tracer(service)


def _has_provider() -> bool:
    """Whether the program has set a tracer provider of the SDK: then it has imported the SDK."""
    if "opentelemetry.sdk.trace" not in sys.modules:
        return False
    from opentelemetry import trace
    from opentelemetry.sdk.trace import TracerProvider

    return isinstance(trace.get_tracer_provider(), TracerProvider)


def stop() -> None:
    """Export what is left, for some seconds at most, and end the traces of this process."""
    global _tracer
    tracer, _tracer = _tracer, None
    if tracer is not None:
        thread = threading.Thread(target=tracer.close, name="last spans", daemon=True)
        thread.start()
        thread.join(_STOP_TIMEOUT_S)


def is_on() -> bool:
    """Whether this process exports spans."""
    return _tracer is not None


def is_active() -> bool:
    """Whether a span that is exported is under way here."""
    tracer = _tracer
    return tracer is not None and tracer.is_active()


@contextmanager
def span(
    name: str, attributes: Attributes = _NONE, *, kind: Kind = Kind.internal, parent: str | None = None
) -> Iterator[Span]:
    """Run a block as a span: what the block does belongs to it. No effect without traces.

    `parent` is a `traceparent`, possibly of a stranger; without one, the parent is the span under way here. An error
    that leaves the block marks the span as failed.
    """
    tracer = _tracer  # another thread may stop the traces
    if tracer is None:
        yield _NO_SPAN
        return
    with tracer.span(name, attributes, kind, parent) as started:
        yield started


@contextmanager
def leaf_span(name: str, attributes: Attributes = _NONE) -> Iterator[Span]:
    """Run a block as a span of kind client without children; the block may be in a generator.

    No effect outside of another span: details of nothing are no trace.
    """
    tracer = _tracer
    if tracer is None or not tracer.is_active():
        yield _NO_SPAN
        return
    with tracer.leaf_span(name, attributes, Kind.client) as started:
        yield started


def traceparent() -> str | None:
    """Return the header `traceparent` of the span under way here; None without one."""
    tracer = _tracer
    return None if tracer is None else tracer.traceparent()


def trace_id() -> str | None:
    """Return the id of the trace under way here, in hexadecimal; None without one."""
    header = traceparent()
    return None if header is None else header.split("-")[1]
