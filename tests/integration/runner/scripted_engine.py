"""A scripted container engine: it answers requests as a test defines."""

from __future__ import annotations

import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler
from pathlib import Path

from kleinkram.runner.executors.docker.client import DockerClient
from kleinkram.runner.executors.docker.executor import DockerExecutor


@contextmanager
def with_engine(answering: type[BaseHTTPRequestHandler], folder: Path) -> Iterator[DockerExecutor]:
    """Yield an executor whose engine is a handler of requests at a socket in a folder."""
    with socketserver.ThreadingUnixStreamServer(str(folder / "socket"), answering) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield DockerExecutor(DockerClient(folder / "socket"))
        finally:
            server.shutdown()
            thread.join()
