"""Sides that read messages as bytes, each run as a process of its own (see `sides`)."""

import json
import os
import resource
import sys
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from small_mcap import read_message

from kleinkram.recordings.http_source import HttpSource
from kleinkram.recordings.reading import Recording

_NS = 10**9


def raw_ours(path: str) -> dict[str, float]:
    """Read every message as bytes, in the order of log time, with every checksum."""
    started = time.perf_counter()
    with Recording.open(path) as recording:
        size = sum(len(message.data) for message in recording.raw_messages())
    return {"seconds": time.perf_counter() - started, "bytes": size}


def raw_small_mcap(path: str) -> dict[str, float]:
    """The same with small-mcap, without checksums, as it comes."""
    started = time.perf_counter()
    with Path(path).open("rb") as stream:
        size = sum(len(message.data) for _, _, message in read_message(stream))
    return {"seconds": time.perf_counter() - started, "bytes": size}


def remote_span(path: str, topic: str, seconds: str) -> dict[str, float]:
    """Open a recording over HTTP ranges, and read one topic of a span in its middle."""
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
            """Keep quiet."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    started = time.perf_counter()
    source = HttpSource(f"http://127.0.0.1:{server.server_port}/", size_bytes=size, name="large.mcap")
    with Recording.open(source) as recording:
        middle = ((recording.start_ns or 0) + (recording.end_ns or 0)) // 2
        found = sum(1 for _ in recording.raw_messages(topic, start=middle, end=middle + int(seconds) * _NS))
    taken = time.perf_counter() - started
    server.shutdown()
    return {"seconds": taken, "messages": found, "bytes": source.bytes_read}


_SIDES: dict[str, Callable[..., dict[str, float]]] = {
    side.__name__: side for side in (raw_ours, raw_small_mcap, remote_span)
}


def main() -> None:
    """Run one side and print its facts."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    account = _SIDES[sys.argv[1]](*sys.argv[2:])
    account["import_cpu_s"] = usage.ru_utime + usage.ru_stime
    sys.stdout.write(json.dumps(account))


if __name__ == "__main__":
    main()
