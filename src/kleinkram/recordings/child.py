"""The process that reads one untrusted file: a request on stdin, one JSON line on stdout, nothing else.

It bounds itself before it looks at a byte: address space, processor time, no core file. It is started with an empty
environment, so that there is no credential in it.
"""

from __future__ import annotations

import json
import resource
import sys
import threading

from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.serialise import to_dict
from kleinkram.recordings.sources import FileSource, Source
from kleinkram.recordings.summary import summarise

STACK_BYTES = 512 * 1024


def main() -> int:
    """Answer the request; 0 if there is an answer, also where the answer is a failure."""
    request = json.loads(sys.stdin.buffer.read())
    _bound(request["memory_bytes"], request["cpu_s"])
    try:
        answer: dict[str, object] = {"summary": to_dict(summarise(_open(request)))}
    except SourceError as error:
        answer = {"failed": "source", "message": str(error)}
    except MemoryError:
        answer = {"failed": "memory"}
    sys.stdout.write(json.dumps(answer) + "\n")
    return 0


def _bound(memory_bytes: int, cpu_s: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # The stack of a thread counts as address space from its start.
    threading.stack_size(STACK_BYTES)


def _open(request: dict[str, str | int]) -> Source:
    if "path" in request:
        return FileSource(str(request["path"]))
    from kleinkram.recordings.http_source import HttpSource  # urllib3 only where it is needed

    return HttpSource(str(request["url"]), size_bytes=int(request["size_bytes"]), name=str(request["name"]))


if __name__ == "__main__":
    sys.exit(main())
