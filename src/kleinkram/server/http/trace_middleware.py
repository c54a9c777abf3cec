"""A span for each request to the API, as the child of the client's or the proxy's. Only installed if traces are on.

Not FastAPI's own spans: they have the query of each request, which may hold a code that signs somebody in.

Source: OpenTelemetry semantic conventions for HTTP spans.
"""

import itertools
import re

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from kleinkram import traces
from kleinkram.server.http.middleware import actor_fields, printed_path, route_of

# Long polls, heartbeats and event streams are no work of their own, and come every few seconds.
_TRACED = re.compile(r"/api/v1/(?!events$|runners/[^/]+/(claims|heartbeats)$)")
# Of reads that belong to no trace, such as those of a browser, one in so many: a span costs 80 us of CPU time, most of
# it for the export, which is 4 % of a read.
_READS_PER_SPAN = 10


class TraceMiddleware:
    """ASGI middleware around the one that gives requests their ids."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._reads = itertools.count()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http" or not _TRACED.match(scope["path"]):
            await self._app(scope, receive, send)
            return
        method, parent = scope["method"], _parent_of(scope)
        if parent is None and method in {"GET", "HEAD"} and next(self._reads) % _READS_PER_SPAN:
            await self._app(scope, receive, send)
            return
        attributes: traces.Attributes = {
            "http.request.method": method,
            "url.path": printed_path(scope),
            "url.scheme": scope.get("scheme", "http"),
        }
        with traces.span(method, attributes, kind=traces.Kind.server, parent=parent) as span:

            async def send_traced(message: Message) -> None:
                if message["type"] == "http.response.start":
                    if span.traceparent is not None:
                        header = (b"traceresponse", span.traceparent.encode())
                        message["headers"] = [*message["headers"], header]
                    _describe(span, scope, message["status"])
                await send(message)

            await self._app(scope, receive, send_traced)


def _parent_of(scope: Scope) -> str | None:
    for name, value in scope["headers"]:
        if name == b"traceparent":
            return str(value, "latin-1")
    return None


def _describe(span: traces.Span, scope: Scope, status: int) -> None:
    route, actor = route_of(scope), actor_fields(scope)
    span.rename(f"{scope['method']} {route}")
    attributes: traces.Attributes = {
        "http.route": route,
        "http.response.status_code": status,
        "kleinkram.request_id": scope["state"]["request_id"],
        **{f"kleinkram.{name}": value for name, value in actor.items()},
    }
    span.set(attributes)
    if status >= 500:
        span.fail(str(status))
