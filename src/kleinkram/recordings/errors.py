"""Errors of reading recordings.

The content of a file never raises an error to a caller: it becomes `content` and `reason` of a summary. These errors
mean that the bytes could not be read, that an argument was wrong, or that the child process failed.
"""

from __future__ import annotations

from enum import Enum


class RecordingError(Exception):
    """Base class: reading a recording failed."""


class SourceError(RecordingError):
    """The bytes of a recording could not be read (disk, network, store). Not the file's fault; retry."""


class FailureKind(str, Enum):
    """Why a child process gave no summary."""

    memory = "memory"
    time = "time"
    crash = "crash"
    source = "source"


class SummaryFailed(RecordingError):
    """The child process gave no summary. `signal`: the signal that ended it, or None."""

    def __init__(self, message: str, *, kind: FailureKind, signal: int | None = None) -> None:
        super().__init__(message)
        self.kind = kind
        self.signal = signal


class Malformed(RecordingError):
    """The bytes contradict their format at a known position. Whatever parses bytes may raise it, internally.

    `where`: such as "byte 4117". `certain`: the file is damaged, rather than of a kind that is not read.
    """

    def __init__(self, where: str, message: str, *, certain: bool = True) -> None:
        super().__init__(f"{message} ({where})")
        self.where = where
        self.message = message
        self.certain = certain


class Cut(Malformed):
    """The bytes end too early."""


class NotIndexed(RecordingError):
    """The file has no usable index, so it must be read whole. Internal to `recordings`."""

    def __init__(self, code: str, message: str, *, is_problem: bool) -> None:
        super().__init__(message)
        self.code = code
        self.is_problem = is_problem


def _shown(names: list[str]) -> str:
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")


class NotARecording(RecordingError):
    """A file or folder without messages, or of a format without a reader."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name = name


class SeveralRecordings(RecordingError):
    """A folder holds several recordings, `names`; open one of them."""

    def __init__(self, folder: str, names: list[str]) -> None:
        super().__init__(f"{folder} holds {len(names)} recordings; open one of them: {_shown(names)}")
        self.names = names


class TooCostly(RecordingError):
    """A file without a usable index would have to be read whole, and is larger than allowed."""

    def __init__(self, name: str, size_bytes: int, why: str) -> None:
        super().__init__(
            f"{name}: {why}; to open it, all its {size_bytes} bytes must be read first: "
            f"allow that with max_bytes={size_bytes}, or download the file and open it from there"
        )
        self.name = name
        self.size_bytes = size_bytes
        self.why = why


class NoSuchTopic(RecordingError):
    """The recording, which has `topics`, has no topic of that name."""

    def __init__(self, topic: str, topics: list[str]) -> None:
        super().__init__(f"there is no topic {topic}; the recording has {_shown(topics) or 'none'}")
        self.topic = topic
        self.topics = topics


class TooDisordered(RecordingError):
    """Too many parts of the recording overlap in time to be merged in bounded memory."""


class CannotWrite(RecordingError):
    """An output cannot be written: its `name`, and why."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name = name
        self.reason = reason


class NotConvertible(CannotWrite):
    """An output format cannot hold the messages of a recording: its `name`, and why."""


class EmptyRange(RecordingError):
    """The end of a time range, exclusive, is not after its start. Both in nanoseconds since 1970."""

    def __init__(self, message: str, *, start_ns: int, end_ns: int) -> None:
        super().__init__(message)
        self.start_ns = start_ns
        self.end_ns = end_ns


class OutsideRecording(RecordingError):
    """Nothing was recorded in a time range: the recordings span `first_ns` to `last_ns`, or hold no messages."""

    def __init__(self, message: str, *, first_ns: int | None, last_ns: int | None) -> None:
        super().__init__(message)
        self.first_ns = first_ns
        self.last_ns = last_ns


class TrajectoryRefused(RecordingError):
    """A trajectory cannot be used: the `name` of its file, topic or transforms, and why."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name = name
        self.reason = reason
