"""Serves one file by HTTP ranges, as a store does: `python -m benchmarks.range_server PATH [RATE]` prints its port.

A process of its own, so that it takes no time from the side that reads. With a rate (bytes/s),
it sends no faster, all connections together: a store behind a network link.
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

_PIECE_BYTES = 2**18


@contextmanager
def serving(path: Path, bytes_per_s: int | None = None) -> Iterator[str]:
    """Serve a file for the duration of a `with`; yields its URL."""
    rate = [] if bytes_per_s is None else [str(bytes_per_s)]
    command = [sys.executable, "-m", "benchmarks.range_server", str(path), *rate]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            if process.stdout is None:
                raise SystemExit("the server has no output")
            yield f"http://127.0.0.1:{process.stdout.readline().strip()}/"
        finally:
            process.kill()


class _Link:
    """A network link that all connections share."""

    def __init__(self, bytes_per_s: float) -> None:
        self._bytes_per_s = bytes_per_s
        self._lock = threading.Lock()
        self._free_at = 0.0

    def wait(self, size: int) -> None:
        """Wait for as long as the link takes for these bytes, behind those of others."""
        with self._lock:
            self._free_at = max(self._free_at, time.monotonic()) + size / self._bytes_per_s
            until = self._free_at
        time.sleep(max(0.0, until - time.monotonic()))


def main(path: str, bytes_per_s: str = "inf") -> None:
    """Serve until killed."""
    size, descriptor = Path(path).stat().st_size, os.open(path, os.O_RDONLY)
    link = _Link(float(bytes_per_s))

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        disable_nagle_algorithm = True
        wbufsize = 65536

        def do_GET(self) -> None:
            first, last = map(int, self.headers["Range"].removeprefix("bytes=").split("-"))
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {first}-{last}/{size}")
            self.send_header("Content-Length", str(last - first + 1))
            self.end_headers()
            self.wfile.flush()
            while first <= last:
                length = min(_PIECE_BYTES, last + 1 - first)
                link.wait(length)
                first += os.sendfile(self.connection.fileno(), descriptor, first, length)

        def log_message(self, *_: object) -> None:
            """Log nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    sys.stdout.write(f"{server.server_port}\n")
    sys.stdout.flush()
    server.serve_forever()


if __name__ == "__main__":
    main(*sys.argv[1:])
