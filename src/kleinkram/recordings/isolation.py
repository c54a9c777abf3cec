"""Reads untrusted files in a child process without credentials, bounded in memory and time.

`summarise_isolated` waits for it. A server that must not wait starts `CHILD_COMMAND` with `CHILD_ENVIRONMENT` itself,
writes `request_bytes(...)` and a newline to its stdin, and hands the line that comes back to `read_answer` (after a
`metadata_request_bytes(...)` to `read_metadata_answer`); then the child takes the next request. Its end, rather than a
line, is an answer too.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from kleinkram.recordings.errors import FailureKind, SummaryFailed
from kleinkram.recordings.formats.rosbag2.metadata import Rosbag2Metadata, StatedFile, StatedTopic
from kleinkram.recordings.limits import MAX_SCAN_BYTES
from kleinkram.recordings.model import (
    Content,
    Depth,
    Fact,
    Lost,
    MessageDensity,
    Problem,
    RecordingFormat,
    RecordingSummary,
    TopicSummary,
)

CHILD_COMMAND: tuple[str, ...] = (sys.executable, "-I", "-m", "kleinkram.recordings.child")
"""`-I`: the child takes no module from the working directory, and nothing from the environment."""

CHILD_ENVIRONMENT: dict[str, str] = {"LC_ALL": "C.UTF-8", "MALLOC_ARENA_MAX": "1"}
"""One malloc arena: each thread's own would reserve 64 MB of the address space that the child may use."""

DEFAULT_MEMORY_BYTES = 512 * 2**20
DEFAULT_TIMEOUT_S = 120
_SENTENCES = {
    FailureKind.memory: "it needs more memory to be read than is allowed",
    FailureKind.time: "it takes longer to be read than is allowed",
    FailureKind.crash: "reading it failed",
    FailureKind.source: "its bytes cannot be read",
}


@dataclass(frozen=True)
class FileRequest:
    """Read a local file."""

    path: str


@dataclass(frozen=True)
class UrlRequest:
    """Read the bytes behind a URL that answers ranges. `name` is the file's own, for messages and extension.

    `logs`: of a database whose recorder was killed, URL and size of what lies beside it, by suffix ("-wal",
    "-journal"). Then the database is read whole, whatever depth and size were asked for.
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


SummaryRequest = FileRequest | UrlRequest


def request_bytes(
    request: SummaryRequest,
    *,
    depth: Depth = Depth.summary,
    most_bytes: int = MAX_SCAN_BYTES,
    memory_bytes: int = DEFAULT_MEMORY_BYTES,
    timeout_s: int = DEFAULT_TIMEOUT_S,
) -> bytes:
    """Return the line that the child reads from stdin, without its newline. `most_bytes`: as `summarise`."""
    options = {"depth": depth.value, "most_bytes": most_bytes, "memory_bytes": memory_bytes, "cpu_s": timeout_s}
    return json.dumps({**vars(request), **options}).encode()


def stream_request_bytes(
    request: StreamRequest, *, memory_bytes: int = DEFAULT_MEMORY_BYTES, timeout_s: int = DEFAULT_TIMEOUT_S
) -> bytes:
    """Return the line that the child reads from stdin, without its newline, ahead of the bytes themselves."""
    return json.dumps({**vars(request), "memory_bytes": memory_bytes, "cpu_s": timeout_s}).encode()


def metadata_request_bytes(
    text: str, *, memory_bytes: int = DEFAULT_MEMORY_BYTES, timeout_s: int = DEFAULT_TIMEOUT_S
) -> bytes:
    """Return the line by which the child reads the text of a metadata.yaml, without its newline."""
    return json.dumps({"metadata": text, "memory_bytes": memory_bytes, "cpu_s": timeout_s}).encode()


def read_answer(stdout: bytes, stderr: bytes, returncode: int) -> RecordingSummary:
    """Return the summary in the child's answer.

    Raises:
        SummaryFailed: there is none; says why.
    """
    answer = _answer(stdout, stderr, returncode)
    try:
        return from_dict(answer["summary"])
    except (ValueError, KeyError, TypeError) as error:
        raise _not_understood() from error


def read_metadata_answer(stdout: bytes, stderr: bytes, returncode: int) -> Rosbag2Metadata | None:
    """Return the metadata in the child's answer.

    Raises:
        SummaryFailed: it was not read; says why.
    """
    answer = _answer(stdout, stderr, returncode)
    try:
        return None if answer["metadata"] is None else metadata_from_dict(answer["metadata"])
    except (ValueError, KeyError, TypeError) as error:
        raise _not_understood() from error


def _answer(stdout: bytes, stderr: bytes, returncode: int) -> dict[str, Any]:
    if returncode == -signal.SIGXCPU:
        raise _failure(FailureKind.time, "", signal.SIGXCPU)
    if returncode < 0:
        raise _failure(FailureKind.crash, f"the process was ended by signal {-returncode}", -returncode)
    if returncode != 0:
        kind = FailureKind.memory if b"MemoryError" in stderr else FailureKind.crash
        lines = stderr.decode("utf-8", "replace").strip().splitlines()
        raise _failure(kind, lines[-1] if lines else f"exit code {returncode}")
    try:
        answer: dict[str, Any] = json.loads(stdout)
        if "failed" in answer:
            raise _failure(FailureKind(answer["failed"]), answer.get("message", ""))
    except (ValueError, TypeError, AttributeError) as error:
        raise _not_understood() from error
    return answer


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


def _not_understood() -> SummaryFailed:
    return _failure(FailureKind.crash, "its answer cannot be understood")


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
    """Return the summary that `to_dict` was given.

    Raises:
        KeyError, TypeError, ValueError: it is not one.
    """
    values = dict(plain)
    values["format"] = RecordingFormat(values["format"])
    values["content"] = Content(values["content"])
    values["compression"] = tuple(values["compression"])
    values["topics"] = tuple(_topic(topic) for topic in values["topics"])
    values["problems"] = tuple(Problem(**problem) for problem in values["problems"])
    values["depth"] = Depth(values["depth"])
    values["lost"] = Lost(**values["lost"]) if values["lost"] is not None else None
    values["facts"] = tuple(Fact(**fact) for fact in values["facts"])
    return RecordingSummary(**values)


def _topic(plain: Mapping[str, Any]) -> TopicSummary:
    density = plain["density"]
    counted = MessageDensity(**{**density, "counts": tuple(density["counts"])}) if density is not None else None
    return TopicSummary(**{**plain, "density": counted})


def metadata_from_dict(plain: Mapping[str, Any]) -> Rosbag2Metadata:
    """Return what `dataclasses.asdict` was given, after a round trip through JSON.

    Raises:
        KeyError, TypeError: it is none.
    """
    values = dict(plain)
    values["files"] = tuple(values["files"])
    values["topics"] = tuple(StatedTopic(**topic) for topic in values["topics"])
    values["file_entries"] = tuple(StatedFile(**entry) for entry in values["file_entries"])
    return Rosbag2Metadata(**values)
