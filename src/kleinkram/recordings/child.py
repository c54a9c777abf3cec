"""The process that reads untrusted files: a line of JSON on stdin for each, a line on stdout, nothing else.

Behind a request's line its bytes may follow. Then all of them are taken before the answer is given, so that the caller
writes them need not know when the reader has seen enough.

It bounds itself before it looks at a byte: address space, processor time, no core file. It is started with an empty
environment, so that there is no credential in it.
"""

from __future__ import annotations

import json
import math
import resource
import sys
import threading
import time
from dataclasses import asdict
from typing import Any

from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.formats.rosbag2.metadata import parse_rosbag2_metadata
from kleinkram.recordings.isolation import to_dict
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.model import Depth, RecordingSummary
from kleinkram.recordings.sources import FileSource, Source, pipe_reader, source_reader
from kleinkram.recordings.summary import scan, scan_with_logs, summarise

STACK_BYTES = 512 * 1024


def main() -> int:
    """Answer each request; 0 if each had an answer, also where the answer is a failure."""
    for line in sys.stdin.buffer:
        request = json.loads(line)
        _bound(request["memory_bytes"], request["cpu_s"])
        sys.stdout.write(json.dumps(_answer(request)) + "\n")
        sys.stdout.flush()
    return 0


def _answer(request: dict[str, Any]) -> dict[str, object]:
    try:
        if "metadata" in request:
            metadata = parse_rosbag2_metadata(request["metadata"])
            return {"metadata": metadata and asdict(metadata)}
        return {"summary": to_dict(_read(request))}
    except SourceError as error:
        return {"failed": "source", "message": str(error)}
    except MemoryError:
        return {"failed": "memory"}


def _read(request: dict[str, Any]) -> RecordingSummary:
    if "stream_bytes" in request:
        reader = pipe_reader(sys.stdin.buffer, request["stream_bytes"], request["name"])
        try:
            return scan(reader)
        finally:
            while reader.read(WINDOW):
                pass
    source = _open(request)
    if request.get("logs"):
        return scan_with_logs(source, _open_logs(request))
    if request["depth"] == Depth.scan.value:
        return scan(source_reader(source))
    return summarise(source, most_bytes=request["most_bytes"])


def _bound(memory_bytes: int, cpu_s: int) -> None:
    """Bound this request: the whole process's memory, and processor time from here on."""
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(time.process_time()) + cpu_s, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # The stack of a thread counts as address space from its start.
    threading.stack_size(STACK_BYTES)


def _open(request: dict[str, Any]) -> Source:
    if "path" in request:
        return FileSource(request["path"])
    from kleinkram.recordings.http_source import HttpSource  # urllib3 only where it is needed

    return HttpSource(request["url"], size_bytes=request["size_bytes"], name=request["name"])


def _open_logs(request: dict[str, Any]) -> dict[str, Source]:
    from kleinkram.recordings.http_source import HttpSource

    return {
        suffix: HttpSource(url, size_bytes=size_bytes, name=f"{request['name']}{suffix}")
        for suffix, (url, size_bytes) in request["logs"].items()
    }


if __name__ == "__main__":
    sys.exit(main())
