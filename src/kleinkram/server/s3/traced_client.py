"""The S3 client of a process that exports traces: a span for each request that is part of a trace.

Source: OpenTelemetry semantic conventions for object stores (S3). Spans have no URL, since it would be signed.
"""

from collections.abc import AsyncGenerator
from contextlib import aclosing

from kleinkram import traces
from kleinkram.server.s3.client import S3Client, S3Error, S3Request, S3Response


class TracedS3Client(S3Client):
    """An S3 client whose requests are spans."""

    async def request(self, request: S3Request) -> S3Response:
        """Send a request and read the whole answer. Raises as `S3Client.request`."""
        with traces.leaf_span(f"S3/{request.operation}", _attributes(request)) as span:
            try:
                return await super().request(request)
            except S3Error as error:
                span.set({"http.response.status_code": error.status})
                span.fail(error.code)
                raise

    async def stream(self, request: S3Request, *, attempts: int = 3) -> AsyncGenerator[bytes, None]:
        """Yield the answer's body. Raises as `S3Client.stream`."""
        with traces.leaf_span(f"S3/{request.operation}", _attributes(request)) as span:
            size_bytes = 0
            try:
                async with aclosing(super().stream(request, attempts=attempts)) as chunks:
                    async for chunk in chunks:
                        size_bytes += len(chunk)
                        yield chunk
            finally:
                span.set({"http.response.body.size": size_bytes})


def _attributes(request: S3Request) -> traces.Attributes:
    attributes = {"rpc.system": "aws-api", "rpc.service": "S3", "rpc.method": request.operation}
    return {**attributes, "aws.s3.key": request.key} if request.key else attributes
