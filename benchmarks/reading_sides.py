"""Sides that read messages as bytes, each run as a process of its own (see `side`)."""

import os
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from small_mcap import read_message

from benchmarks.side import Facts, main
from kleinkram.recordings import Recording
from kleinkram.recordings.http_source import HttpSource


def raw_ours(path: str) -> Facts:
    """Read every message as bytes, in the order of log time, with every checksum."""
    started = time.perf_counter()
    with Recording.open(path) as recording:
        size = sum(len(message.data) for message in recording.raw_messages())
    return {"seconds": time.perf_counter() - started, "bytes": size}


def raw_small_mcap(path: str) -> Facts:
    """The same with small-mcap, without checksums."""
    started = time.perf_counter()
    with Path(path).open("rb") as stream:
        size = sum(len(message.data) for _, _, message in read_message(stream))
    return {"seconds": time.perf_counter() - started, "bytes": size}


def remote_span(path: str, topic: str, start_ns: str, end_ns: str) -> Facts:
    """Open a recording over HTTP ranges, and read one topic of a span."""
    size = Path(path).stat().st_size
    descriptor = os.open(path, os.O_RDONLY)

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        disable_nagle_algorithm = True
        wbufsize = 65536

        def do_GET(self) -> None:
            first, last = map(int, self.headers["Range"].removeprefix("bytes=").split("-"))
            body = os.pread(descriptor, last - first + 1, first)
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {first}-{last}/{size}")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            """Log nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    started = time.perf_counter()
    source = HttpSource(f"http://127.0.0.1:{server.server_port}/", size_bytes=size, name="large.mcap")
    with Recording.open(source) as recording:
        count = sum(1 for _ in recording.raw_messages(topic, start=int(start_ns), end=int(end_ns)))
    taken = time.perf_counter() - started
    server.shutdown()
    return {"seconds": taken, "messages": count, "bytes": source.bytes_read}


if __name__ == "__main__":
    main((raw_ours, raw_small_mcap, remote_span))
