"""Writes a slice of an untrusted recording as MCAP to stdout, in a child process without credentials.

The caller starts `SLICE_COMMAND` with `CHILD_ENVIRONMENT` and writes one line, `slice_request_bytes(...)`, to stdin.
The child answers with a line of JSON: `{}`, and the bytes of the MCAP follow, or what `read_refusal` reads. The bytes
are whole only if the exit code is 0. The first megabyte is complete before the child answers, so what can be refused
is refused instead of cut off.

Like that of `isolation`, the child bounds itself before it looks at a byte, and reads the recording by a URL.
"""

from __future__ import annotations

import enum
import io
import json
import os
import resource
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

from typing_extensions import Buffer

from kleinkram.recordings.errors import EmptyRange, NoSuchTopic, OutsideRecording, RecordingError, SourceError
from kleinkram.recordings.isolation import limit_this_process

SLICE_COMMAND: tuple[str, ...] = (sys.executable, "-I", "-m", "kleinkram.recordings.slice_process")
_BUFFERED_BYTES = 2**20
_STDOUT = 1


class RefusalKind(str, enum.Enum):
    """Why there is no slice."""

    topic = "topic"  # there is no such topic
    range = "range"  # nothing was recorded between start and end
    source = "source"  # the bytes cannot be read now
    memory = "memory"
    recording = "recording"  # the recording cannot be sliced


_KINDS: dict[type[Exception], RefusalKind] = {
    NoSuchTopic: RefusalKind.topic,
    SourceError: RefusalKind.source,
    OutsideRecording: RefusalKind.range,
    EmptyRange: RefusalKind.range,
}


@dataclass(frozen=True)
class SliceRequest:
    """A slice of the file behind a URL that answers ranges.

    Attributes:
        name: of the file, for messages, its extension and the metadata record of the slice.
        sha256: of the file, for the metadata record; None: unknown.
        topics: names or globs; None: all.
        start_ns: earliest log time, inclusive; None: the first.
        end_ns: latest log time, exclusive; None: behind the last.
        max_scan_bytes: a file without a usable index is read whole if it has at most so many bytes.
        memory_bytes: address space of the child.
        cpu_s: processor time of the child.
    """

    url: str
    size_bytes: int
    name: str
    sha256: str | None
    topics: Sequence[str] | None
    start_ns: int | None
    end_ns: int | None
    max_scan_bytes: int
    memory_bytes: int
    cpu_s: int


@dataclass(frozen=True)
class SliceRefusal:
    """Why there is no slice: its kind, and a sentence."""

    kind: RefusalKind
    message: str


def slice_request_bytes(request: SliceRequest) -> bytes:
    """Return the line that the child reads from stdin, without its newline."""
    return json.dumps(asdict(request)).encode()


def read_refusal(line: bytes) -> SliceRefusal | None:
    """Return why there is no slice; None if its bytes follow. `ValueError` if the line is none of the child's."""
    answer = json.loads(line)
    if answer == {}:
        return None
    try:
        return SliceRefusal(RefusalKind(answer["kind"]), str(answer["message"]))
    except (KeyError, TypeError) as error:
        raise ValueError("its answer cannot be understood") from error


class _Answer(io.RawIOBase):
    """Stdout, with the line that announces a slice before its first bytes."""

    has_begun = False
    _is_discarded = False

    def writable(self) -> bool:
        return True

    def write(self, data: Buffer, /) -> int:
        if self._is_discarded:
            return len(memoryview(data))
        if not self.has_begun:
            self.has_begun = True
            _write_line({})
        return os.write(_STDOUT, data)

    def discard(self) -> None:
        """Ignore what is written from now on: a buffer before this stream is flushed whenever it is freed."""
        self._is_discarded = True


def main() -> int:
    """Answer the request on stdin; 0 if the slice is whole, or was refused."""
    import kleinkram.recordings.writing.mcap  # noqa: F401  # all modules, before the memory is bounded

    request = SliceRequest(**json.loads(sys.stdin.buffer.readline()))
    limit_this_process(memory_bytes=request.memory_bytes, cpu_s=request.cpu_s)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # what would have to be unpacked to the disk first is refused
    answer = _Answer()
    try:
        _write_slice(request, answer)
    except (RecordingError, MemoryError, OSError) as error:
        if answer.has_begun:
            raise
        _write_line(asdict(_refusal_of(error)))
    return 0


def _write_slice(request: SliceRequest, answer: _Answer) -> None:
    from kleinkram.recordings.http_source import HttpSource  # only in the child
    from kleinkram.recordings.recording import Recording
    from kleinkram.recordings.writing.mcap import McapOptions, SliceSource, select_slice, write_slice

    source = HttpSource(request.url, size_bytes=request.size_bytes, name=request.name, sha256=request.sha256)
    buffered = io.BufferedWriter(answer, _BUFFERED_BYTES)
    try:
        with Recording.open(source, max_bytes=request.max_scan_bytes) as recording:
            selection = select_slice([recording], request.topics, request.start_ns, request.end_ns)
            if selection.topics is not None and not selection.topics:
                raise NoSuchTopic(", ".join(request.topics or ()), [topic.name for topic in recording.topics])
            write_slice(buffered, [SliceSource(recording, recording.sha256)], selection, McapOptions())
        buffered.flush()
    except BaseException:
        answer.discard()
        raise


def _refusal_of(error: Exception) -> SliceRefusal:
    if isinstance(error, MemoryError):
        return SliceRefusal(RefusalKind.memory, "it needs more memory to be read than is allowed")
    return SliceRefusal(_KINDS.get(type(error), RefusalKind.recording), str(error))


def _write_line(answer: Mapping[str, object]) -> None:
    data = json.dumps(answer).encode() + b"\n"
    while data:
        data = data[os.write(_STDOUT, data) :]


if __name__ == "__main__":
    sys.exit(main())
