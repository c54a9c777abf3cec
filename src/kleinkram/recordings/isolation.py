"""Reads untrusted files in a child process without credentials, bounded in memory and time.

`summarise_isolated` waits for it. A server that must not wait starts `CHILD_COMMAND` with `CHILD_ENVIRONMENT` itself,
writes `request_bytes(...)` and a newline to its stdin, and passes the line that comes back to `read_answer` (for a
`MetadataRequest` to `read_metadata_answer`, for a `PreviewRequest` to `read_preview_answer`); then the child takes the
next request. If the child ends instead, its exit code and stderr are the answer.

The child is this module run as a program: a line of JSON on stdin for each request, a line on stdout, nothing else.
Behind the line of a `StreamRequest` follow its bytes; all of them are taken before the answer. The child bounds itself
before it looks at a byte: address space, processor time, no core file.
"""

from __future__ import annotations

import base64
import json
import math
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, TypeVar

from kleinkram.recordings import model
from kleinkram.recordings.decoding.types import ReadingExtraMissing
from kleinkram.recordings.errors import FailureKind, RecordingError, SourceError, SummaryFailed, TooCostly
from kleinkram.recordings.formats.rosbag2 import metadata as rosbag2
from kleinkram.recordings.formats.rosbag2.metadata import Rosbag2Metadata
from kleinkram.recordings.geo_position import GeoPosition, usable_position
from kleinkram.recordings.limits import MAX_SCAN_BYTES, WINDOW
from kleinkram.recordings.model import Depth, RecordingSummary
from kleinkram.recordings.sources import FileSource, PipeReader, Source, SourceReader

CHILD_COMMAND: tuple[str, ...] = (sys.executable, "-I", "-m", "kleinkram.recordings.isolation")
"""`-I`: the child takes no module from the working directory, and nothing from the environment."""

CHILD_ENVIRONMENT: dict[str, str] = {"LC_ALL": "C.UTF-8", "MALLOC_ARENA_MAX": "1", "OPENBLAS_NUM_THREADS": "1"}
"""One malloc arena, and one thread of numpy: each thread's own would reserve 64 MB of the address space."""

DEFAULT_MEMORY_BYTES = 512 * 2**20
DEFAULT_TIMEOUT_S = 120
STACK_BYTES = 512 * 1024
_SENTENCES = {
    FailureKind.memory: "it needs more memory to be read than is allowed",
    FailureKind.time: "it takes longer to be read than is allowed",
    FailureKind.crash: "reading it failed",
    FailureKind.source: "its bytes cannot be read",
}
# What Python writes, and the dynamic loader, where a library no longer fits.
_OUT_OF_MEMORY = (b"MemoryError", b"failed to map segment")
T = TypeVar("T")


@dataclass(frozen=True)
class FileRequest:
    """Read a local file."""

    path: str


@dataclass(frozen=True)
class UrlRequest:
    """Read the bytes behind a URL that answers ranges. `name` is the file's own, for messages and extension.

    `logs`: URL and size of what lies beside a database whose recorder was killed, by suffix ("-wal", "-journal"). Then
    the database is read whole, at any depth and size.
    """

    url: str
    size_bytes: int
    name: str
    logs: Mapping[str, tuple[str, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class StreamRequest:
    """Scan exactly `stream_bytes` bytes, which follow on stdin. `name` is the file's own."""

    stream_bytes: int
    name: str


@dataclass(frozen=True)
class MetadataRequest:
    """Parse the text of a metadata.yaml."""

    metadata: str


@dataclass(frozen=True)
class PreviewRequest:
    """Make the preview of the recording behind a URL that answers ranges. `name`, `logs`: as of `UrlRequest`."""

    preview_url: str
    size_bytes: int
    name: str
    logs: Mapping[str, tuple[str, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class PreviewAnswer:
    """The file of a preview, with what lists show of it: a picture as JPEG, and where it was first.

    Neither file nor picture is parsed; the position is a usable one.
    """

    data: bytes
    thumbnail: bytes | None
    position: GeoPosition | None


SummaryRequest = FileRequest | UrlRequest


def request_bytes(
    request: SummaryRequest | StreamRequest | MetadataRequest | PreviewRequest,
    *,
    depth: Depth = Depth.summary,
    max_bytes: int = MAX_SCAN_BYTES,
    memory_bytes: int = DEFAULT_MEMORY_BYTES,
    timeout_s: int = DEFAULT_TIMEOUT_S,
) -> bytes:
    """Return the line that the child reads from stdin, without its newline.

    `max_bytes`: as in `summarise`. `depth` and `max_bytes` apply to files and URLs.
    """
    options = {"depth": depth.value, "max_bytes": max_bytes, "memory_bytes": memory_bytes, "cpu_s": timeout_s}
    return json.dumps({**vars(request), **options}).encode()


def read_answer(stdout: bytes, stderr: bytes, returncode: int) -> RecordingSummary:
    """Return the summary in the child's answer; `SummaryFailed` if it has none."""
    return _read_answer("summary", from_dict, stdout, stderr, returncode)


def read_metadata_answer(stdout: bytes, stderr: bytes, returncode: int) -> Rosbag2Metadata | None:
    """Return the metadata in the child's answer; `SummaryFailed` if it has none."""
    return _read_answer("metadata", lambda plain: plain and metadata_from_dict(plain), stdout, stderr, returncode)


def read_preview_answer(stdout: bytes, stderr: bytes, returncode: int) -> PreviewAnswer:
    """Return the preview in the child's answer; `SummaryFailed` if it has none."""

    def parse(plain: dict[str, Any]) -> PreviewAnswer:
        thumbnail = plain["thumbnail"]
        jpeg = None if thumbnail is None else base64.b64decode(thumbnail)
        position = plain["position"]
        place = None if position is None else usable_position(*position)
        return PreviewAnswer(base64.b64decode(plain["data"]), jpeg, place)

    return _read_answer("preview", parse, stdout, stderr, returncode)


def _read_answer(key: str, parse: Callable[[Any], T], stdout: bytes, stderr: bytes, returncode: int) -> T:
    if returncode == -signal.SIGXCPU:
        raise _failure(FailureKind.time, "", signal.SIGXCPU)
    if returncode < 0:
        raise _failure(FailureKind.crash, f"the process was ended by signal {-returncode}", -returncode)
    if returncode != 0:
        kind = FailureKind.memory if any(sign in stderr for sign in _OUT_OF_MEMORY) else FailureKind.crash
        lines = stderr.decode("utf-8", "replace").strip().splitlines()
        raise _failure(kind, lines[-1] if lines else f"exit code {returncode}")
    try:
        answer: dict[str, Any] = json.loads(stdout)
        if "failed" in answer:
            raise _failure(FailureKind(answer["failed"]), answer.get("message", ""))
        return parse(answer[key])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise _failure(FailureKind.crash, "its answer cannot be understood") from error


def timed_out() -> SummaryFailed:
    """Return the error for a child that was stopped after its time limit."""
    return _failure(FailureKind.time, "")


def summarise_isolated(
    request: SummaryRequest,
    *,
    depth: Depth = Depth.summary,
    memory_bytes: int = DEFAULT_MEMORY_BYTES,
    timeout_s: int = DEFAULT_TIMEOUT_S,
) -> RecordingSummary:
    """Summarise or scan in a child process, and wait for it.

    Raises:
        SummaryFailed: out of memory or time, crashed, or the bytes could not be read.
    """
    try:
        done = subprocess.run(
            CHILD_COMMAND,
            input=request_bytes(request, depth=depth, memory_bytes=memory_bytes, timeout_s=timeout_s),
            capture_output=True,
            timeout=timeout_s,
            env=CHILD_ENVIRONMENT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise timed_out() from None
    return read_answer(done.stdout, done.stderr, done.returncode)


def _failure(kind: FailureKind, detail: str, ended_by: int | None = None) -> SummaryFailed:
    sentence = _SENTENCES[kind]
    return SummaryFailed(f"{sentence}: {detail}" if detail else sentence, kind=kind, signal=ended_by)


def to_dict(summary: RecordingSummary) -> dict[str, Any]:
    """Return a summary as what `json.dumps` takes; enums as their values, times as integers."""
    plain = asdict(summary)
    plain["format"] = summary.format.value
    plain["content"] = summary.content.value
    plain["depth"] = summary.depth.value
    for name in ("compression", "topics", "problems", "facts"):
        plain[name] = list(plain[name])
    return plain


def from_dict(plain: Mapping[str, Any]) -> RecordingSummary:
    """Return the summary that `to_dict` was given; `KeyError`, `TypeError` or `ValueError` if it is invalid."""
    topics = []
    for topic in plain["topics"]:
        density = topic["density"]
        if density is not None:
            density = model.MessageDensity(**{**density, "counts": tuple(density["counts"])})
        topics.append(model.TopicSummary(**{**topic, "density": density}))
    parsed = {
        "format": model.RecordingFormat(plain["format"]),
        "content": model.Content(plain["content"]),
        "compression": tuple(plain["compression"]),
        "topics": tuple(topics),
        "problems": tuple(model.Problem(**problem) for problem in plain["problems"]),
        "depth": Depth(plain["depth"]),
        "lost": model.Lost(**plain["lost"]) if plain["lost"] is not None else None,
        "facts": tuple(model.Fact(**fact) for fact in plain["facts"]),
    }
    return RecordingSummary(**{**plain, **parsed})


def metadata_from_dict(plain: Mapping[str, Any]) -> Rosbag2Metadata:
    """Return what `dataclasses.asdict` was given, after JSON; `KeyError` or `TypeError` if it is invalid."""
    values = dict(plain)
    values["files"] = tuple(values["files"])
    values["topics"] = tuple(rosbag2.MetadataTopic(**topic) for topic in values["topics"])
    values["file_entries"] = tuple(rosbag2.MetadataFile(**entry) for entry in values["file_entries"])
    return Rosbag2Metadata(**values)


def main() -> int:
    """Answer each request on stdin; 0 if each had an answer, also where the answer is a failure."""
    import kleinkram.recordings.summary  # noqa: F401  # all readers, before the memory is bounded

    for line in sys.stdin.buffer:
        request = json.loads(line)
        limit_this_process(memory_bytes=request["memory_bytes"], cpu_s=request["cpu_s"])
        sys.stdout.write(json.dumps(_answer(request)) + "\n")
        sys.stdout.flush()
    return 0


def limit_this_process(*, memory_bytes: int, cpu_s: int) -> None:
    """Limit the address space and, from now on, the processor time of this process; no core file."""
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    _, max_s = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(time.process_time()) + cpu_s, max_s))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # The stack of a thread counts as address space from its start.
    threading.stack_size(STACK_BYTES)


def _answer(request: dict[str, Any]) -> dict[str, object]:
    try:
        if "metadata" in request:
            metadata = rosbag2.parse_rosbag2_metadata(request["metadata"])
            return {"metadata": metadata and asdict(metadata)}
        if "preview_url" in request:
            return {"preview": _preview_to_dict(_make_preview(request))}
        return {"summary": to_dict(_summarise(request))}
    except SourceError as error:
        return {"failed": "source", "message": str(error)}
    except TooCostly as error:
        limit = f"all its {error.size_bytes:,} bytes must be read, and at most {request['max_bytes']:,} are"
        return {"failed": "crash", "message": f"{error.why}; to make a preview, {limit}"}
    except RecordingError as error:  # a preview, of what cannot be opened
        return {"failed": "crash", "message": str(error)}
    except MemoryError:
        return {"failed": "memory"}


def _summarise(request: dict[str, Any]) -> RecordingSummary:
    from kleinkram.recordings.summary import scan, scan_with_logs, summarise  # only in the child

    if "stream_bytes" in request:
        reader = PipeReader(sys.stdin.buffer, request["stream_bytes"], request["name"])
        try:
            return scan(reader)
        finally:
            while reader.read(WINDOW):
                pass
    if "path" in request:
        source: Source = FileSource(request["path"])
    else:
        from kleinkram.recordings.http_source import HttpSource

        name = request["name"]
        source = HttpSource(request["url"], size_bytes=request["size_bytes"], name=name)
        if logs := _logs(request):
            return scan_with_logs(source, logs)
    if request["depth"] == Depth.scan.value:
        return scan(SourceReader(source))
    return summarise(source, max_bytes=request["max_bytes"])


def _logs(request: dict[str, Any]) -> dict[str, Source]:
    from kleinkram.recordings.http_source import HttpSource  # only in the child

    return {
        suffix: HttpSource(url, size_bytes=size_bytes, name=f"{request['name']}{suffix}")
        for suffix, (url, size_bytes) in request["logs"].items()
    }


def _make_preview(request: dict[str, Any]) -> PreviewAnswer:
    started_s = time.monotonic()
    from kleinkram.recordings.http_source import HttpSource  # only in the child
    from kleinkram.recordings.recording import Recording

    try:
        from kleinkram.recordings.previews import PreviewLimits, first_position, make_preview, representative_thumbnail
    except ImportError as error:
        raise ReadingExtraMissing(error.name or "numpy") from None

    source = HttpSource(request["preview_url"], size_bytes=request["size_bytes"], name=request["name"])
    with Recording.open([source, *_logs(request).values()], max_bytes=request["max_bytes"]) as recording:
        # Half of what is left: pictures and numbers that were read must be encoded, and the answer be sent.
        left_s = max(0.0, request["cpu_s"] - (time.monotonic() - started_s)) / 2
        data = make_preview(recording, PreviewLimits(cpu_s=left_s, wall_s=left_s))
    thumbnail = representative_thumbnail(data)
    return PreviewAnswer(data, None if thumbnail is None else thumbnail.jpeg, first_position(data))


def _preview_to_dict(preview: PreviewAnswer) -> dict[str, object]:
    thumbnail, position = preview.thumbnail, preview.position
    return {
        "data": base64.b64encode(preview.data).decode(),
        "thumbnail": thumbnail and base64.b64encode(thumbnail).decode(),
        "position": position and (position.latitude, position.longitude),
    }


if __name__ == "__main__":
    sys.exit(main())
