"""Types of summaries: formats, topics, problems, losses and facts of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class RecordingFormat(str, Enum):
    """A file format."""

    mcap = "mcap"
    rosbag1 = "rosbag1"
    rosbag1_old = "rosbag1-old"
    rosbag2_db3 = "db3"
    rosbag2_metadata = "rosbag2-metadata"
    zstd = "zstd"
    ulog = "ulog"
    svo2 = "svo2"
    tum = "tum"
    kitti = "kitti"
    yaml = "yaml"
    csv = "csv"
    json = "json"
    empty = "empty"
    unknown = "unknown"


class Content(str, Enum):
    """Completeness of the known content of a file.

    pending: a recording that was not read yet. indexed: known. recovered: known as far as it can be read. broken:
    damaged, at the position in the reason. opaque: not a supported recording. error: reading failed, and is retried.
    """

    pending = "pending"
    indexed = "indexed"
    recovered = "recovered"
    broken = "broken"
    opaque = "opaque"
    error = "error"


class Depth(str, Enum):
    """Depth of reading: by the index (`summary`), or the whole file (`scan`)."""

    summary = "summary"
    scan = "scan"


@dataclass(frozen=True)
class Lost:
    """Unreadable part of a damaged file.

    Attributes:
        bytes: of the file (of what is inside, where it is compressed as a whole), that belong to nothing readable.
        chunks: begun or indexed, of which nothing or not everything could be read.
        messages: how many are lost; None if unknown.
    """

    bytes: int
    chunks: int
    messages: int | None


@dataclass(frozen=True)
class Fact:
    """A fact from a file, such as the number of poses of a trajectory. `name`: stable; `unit`: of a number."""

    name: str
    value: str | int | float
    unit: str = ""


@dataclass(frozen=True)
class Problem:
    """A warning about a readable file. `code`: stable; `where`: topic, position or file; `message`: a sentence."""

    code: str
    where: str
    message: str


@dataclass(frozen=True)
class MessageDensity:
    """The number of messages in bins over time (see `density`).

    Attributes:
        start_ns: where the first bin begins, a multiple of `bin_ns`.
        bin_ns: how wide bins are, a power of two.
        counts: messages of each bin, from its beginning on, that inclusive, up to the next; neither the first nor the
            last is 0. Suspect stamps are in none.
    """

    start_ns: int
    bin_ns: int
    counts: tuple[int, ...]


@dataclass(frozen=True)
class TopicSummary:
    """One topic. Times are integer nanoseconds of the log clock; None: unknown or undefined.

    Attributes:
        count: messages, suspect ones included.
        first_ns: earliest log time that is not suspect.
        last_ns: latest log time that is not suspect.
        rate_hz: (count - 1) / (last - first) of the messages that are not suspect; None below two of them.
        longest_gap_ns: longest silence between two messages that follow each other in time. Never smaller than the
            truth; larger only where the problem "gaps-upper-bound" says so.
        head_gap_ns: silence between the start of the recording and the first message.
        tail_gap_ns: silence between the last message and the end of the recording.
        out_of_order_count: messages whose log time is smaller than the largest before them on this topic, in the
            order in which they are in the file (by chunk, then by offset in the chunk).
        stored_bytes: share of the stored (compressed) chunks, by the uncompressed bytes of its message records.
        suspect_count: messages whose log time cannot be true (see `timeline`).
        density: of the messages that are not suspect; None where times are not known, or there are none.
    """

    name: str
    message_type: str
    schema_name: str
    schema_encoding: str
    message_encoding: str
    count: int | None
    first_ns: int | None = None
    last_ns: int | None = None
    rate_hz: float | None = None
    longest_gap_ns: int | None = None
    head_gap_ns: int | None = None
    tail_gap_ns: int | None = None
    out_of_order_count: int | None = None
    stored_bytes: int | None = None
    suspect_count: int = 0
    density: MessageDensity | None = None


@dataclass(frozen=True)
class RecordingSummary:
    """The content of one file, or of all files of a recording (`combine`).

    Attributes:
        reason: why `content` is not `indexed`, as a sentence.
        message_count: None where it is not known; for a broken file, the messages found before the damage.
        start_ns: earliest log time, inclusive, suspect ones left out.
        end_ns: latest log time, inclusive, suspect ones left out.
        compression: the kinds of compression of the chunks, sorted: "none", "lz4", "zstd", "bz2".
        topics: sorted by name.
        library: what wrote the file, as it states.
        profile: the MCAP profile, such as "ros2".
        bytes_read: what this summary cost.
        depth: whether every byte was read.
        lost: what of a damaged file could not be read: always there if `content` is `recovered`, and three zeros where
            something is wrong and nothing is lost; None for a whole file, or where it was not measured.
        facts: other contents, such as names of attachments and metadata, and key figures of files that are not
            recordings.
    """

    format: RecordingFormat
    content: Content
    reason: str | None = None
    message_count: int | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    compression: tuple[str, ...] = ()
    topics: tuple[TopicSummary, ...] = ()
    problems: tuple[Problem, ...] = ()
    library: str = ""
    profile: str = ""
    attachments: int = 0
    metadata_records: int = 0
    bytes_read: int = 0
    depth: Depth = Depth.summary
    lost: Lost | None = None
    facts: tuple[Fact, ...] = ()


def span_text(span_ns: int, sign: str = "") -> str:
    """Return a span as text: in seconds, from 100 hours on in days, then in years; `sign` "+" shows both signs."""
    seconds = span_ns / 1e9
    if abs(seconds) >= 365.25 * 86_400:
        return f"{seconds / (365.25 * 86_400):{sign}.1f} years"
    if abs(seconds) >= 100 * 3600:
        return f"{seconds / 86_400:{sign}.1f} days"
    return f"{seconds:{sign}.1f} s"


def counted(number: int, one: str, several: str = "") -> str:
    """Return `1 message`, `2 messages`; `several`: the plural, if it is not `one` and an s."""
    return f"{number} {one if number == 1 else several or f'{one}s'}"
