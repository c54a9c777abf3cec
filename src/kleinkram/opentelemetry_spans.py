"""The spans of `traces`, by the SDK of OpenTelemetry. Only imported by processes that export traces."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager

from opentelemetry import context, trace
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import OTELResourceDetector, Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.trace import SpanKind, StatusCode
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

import kleinkram
from kleinkram.traces import Attributes, Kind, Span

_HEADER = "traceparent"
_PROPAGATOR = TraceContextTextMapPropagator()


class OtelSpan:
    """A span of OpenTelemetry that has begun."""

    def __init__(self, started: trace.Span) -> None:
        self._span = started
        self.has_failed = False

    @property
    def traceparent(self) -> str | None:
        """The header `traceparent` for what is done under this span."""
        return _header(self._span)

    def set(self, attributes: Attributes) -> None:
        """Set attributes."""
        self._span.set_attributes(attributes)

    def rename(self, name: str) -> None:
        """Set the name."""
        self._span.update_name(name)

    def fail(self, error_type: str) -> None:
        """Mark the span as failed."""
        self.has_failed = True
        self._span.set_attribute("error.type", error_type)
        self._span.set_status(StatusCode.ERROR)


class Tracer:
    """Begins spans and exports them, as the environment says."""

    def __init__(self, service: str) -> None:
        self._own_provider: TracerProvider | None = None
        provider = trace.get_tracer_provider()
        if not isinstance(provider, TracerProvider):
            # It does not become the global one: FastAPI and other packages would export spans with complete URLs.
            provider = self._own_provider = TracerProvider(resource=_resource(service), shutdown_on_exit=False)
            provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
        self._tracer = provider.get_tracer("kleinkram", kleinkram.__version__)

    def close(self) -> None:
        """Export what is left."""
        if self._own_provider is not None:
            self._own_provider.shutdown()

    def is_active(self) -> bool:
        """Whether a span that is exported is under way here."""
        return trace.get_current_span().is_recording()

    def traceparent(self) -> str | None:
        """Return the header of the span under way here."""
        return _header(trace.get_current_span())

    @contextmanager
    def span(self, name: str, attributes: Attributes, kind: Kind, parent: str | None) -> Iterator[Span]:
        """Run a block as a span, which is the parent of others that begin in the block."""
        # With an invalid header, the span has no parent.
        remote = None if parent is None else _PROPAGATOR.extract({_HEADER: parent}, context.Context())
        started = self._start(name, attributes, kind, remote)
        token = context.attach(trace.set_span_in_context(started, remote))
        try:
            with _ended(started) as wrapped:
                yield wrapped
        finally:
            context.detach(token)

    @contextmanager
    def leaf_span(self, name: str, attributes: Attributes, kind: Kind) -> Iterator[Span]:
        """Run a block as a span that is no parent of others."""
        with _ended(self._start(name, attributes, kind, None)) as wrapped:
            yield wrapped

    def _start(self, name: str, attributes: Attributes, kind: Kind, parent: context.Context | None) -> trace.Span:
        return self._tracer.start_span(name, parent, SpanKind[kind.value], attributes)


@contextmanager
def _ended(started: trace.Span) -> Iterator[OtelSpan]:
    """End a span with the block. Of an error, only the class is recorded: its text may hold a signed URL."""
    wrapped = OtelSpan(started)
    try:
        yield wrapped
    except Exception as error:
        if not wrapped.has_failed:
            wrapped.fail(type(error).__name__)
        raise
    finally:
        started.end()


def _header(span: trace.Span) -> str | None:
    it = span.get_span_context()
    return f"00-{it.trace_id:032x}-{it.span_id:016x}-{it.trace_flags:02x}" if it.is_valid else None


def _resource(service: str) -> Resource:
    own = {"service.name": service, "service.version": kleinkram.__version__, "host.name": socket.gethostname()}
    # `OTEL_SERVICE_NAME` and `OTEL_RESOURCE_ATTRIBUTES` override them.
    return Resource.create(own).merge(OTELResourceDetector().detect())
