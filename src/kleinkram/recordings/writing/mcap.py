"""Writes a recording of any format as one MCAP.

Memory: the messages that are being merged, and what `McapWriter` holds.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

import lz4.frame
import zstandard

from kleinkram import __version__
from kleinkram.recordings.chunk_reader import ChunkedMember
from kleinkram.recordings.errors import CannotWrite, Malformed
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.messages import Channel, Properties, RawMessage, Schema
from kleinkram.recordings.model import Content, RecordingFormat
from kleinkram.recordings.streams import open_range
from kleinkram.recordings.writing.chunked_writer import COMPRESSION_THREADS
from kleinkram.recordings.writing.losses import LostPlace, MemberLoss, find_losses
from kleinkram.recordings.writing.mcap_writer import McapWriter
from kleinkram.recordings.writing.message_copy import (
    LeftOut,
    MessageCopy,
    Route,
    channels_of,
    re_encoding_of,
    share_reporter,
    with_definition,
)
from kleinkram.recordings.writing.new_file import new_file

if TYPE_CHECKING:
    from kleinkram.recordings.recording import OnProgress, Recording, Topics

MADE_FROM = "kleinkram:made_from"
"""Name of the metadata record that says what a file was made from."""

_PROFILES = {"ros1": "ros1", "cdr": "ros2"}
_FOREVER = "sec: 9223372036\n    nsec: 854775807\n"
_LATCHED_QOS = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"
    f"  deadline:\n    {_FOREVER}  lifespan:\n    {_FOREVER}  liveliness: 1\n"
    f"  liveliness_lease_duration:\n    {_FOREVER}  avoid_ros_namespace_conventions: false"
)


class ChunkCompression(str, Enum):
    """Compression of chunks."""

    zstd = "zstd"
    lz4 = "lz4"
    none = "none"


class Ros1Messages(str, Enum):
    """What becomes of ROS 1 messages: they stay as they are, or become those of ROS 2 (CDR)."""

    keep = "keep"
    reencode = "reencode"


LEVELS = {ChunkCompression.zstd: range(1, 23), ChunkCompression.lz4: range(17), ChunkCompression.none: range(1)}
_DEFAULT_LEVELS = {ChunkCompression.zstd: 3, ChunkCompression.lz4: 0, ChunkCompression.none: 0}


@dataclass(frozen=True)
class McapOptions:
    """How an MCAP is written.

    Attributes:
        compression: of chunks.
        level: 1 to 22 for zstd (default 3), 0 to 16 for lz4 (default 0); higher is smaller and slower.
        chunk_bytes: uncompressed bytes of messages after which a chunk ends.
        ros1: what becomes of ROS 1 messages.
    """

    compression: ChunkCompression = ChunkCompression.zstd
    level: int | None = None
    chunk_bytes: int = 2**20
    ros1: Ros1Messages = Ros1Messages.keep

    def __post_init__(self) -> None:
        levels = LEVELS[self.compression]
        if self.level is not None and self.level not in levels:
            raise ValueError(f"{self.compression.value} has levels {levels[0]} to {levels[-1]}, not {self.level}")
        if self.chunk_bytes < 1:
            raise ValueError(f"chunks of {self.chunk_bytes} bytes cannot be written")


@dataclass(frozen=True)
class McapResult:
    """A written MCAP.

    Attributes:
        losses: what of the recording could not be read; empty if nothing was lost.
        left_out: ROS 1 messages that could not be re-encoded.
    """

    path: Path
    message_count: int
    size_bytes: int
    losses: tuple[MemberLoss, ...]
    left_out: tuple[LeftOut, ...] = ()


def is_whole_mcap(recording: Recording, compression: ChunkCompression) -> bool:
    """Return whether a recording is one MCAP, indexed, undamaged and with this compression. Reads all of it.

    Raises:
        SourceError: the bytes cannot be read.
    """
    if len(recording.members) != 1 or recording.members[0].summary is not None:
        return False  # it was scanned to be opened, so its index is not usable
    (summary,) = recording.scan_files()
    has_good_index = not any(problem.code in ("index-damaged", "counts-disagree") for problem in summary.problems)
    is_whole = (summary.format, summary.content) == (RecordingFormat.mcap, Content.indexed) and summary.lost is None
    return is_whole and has_good_index and set(summary.compression) <= {compression.value}


def write_mcap(
    recording: Recording,
    path: Path,
    topics: Topics | None,
    options: McapOptions,
    sha256: Mapping[str, str],
    on_progress: OnProgress | None,
) -> McapResult:
    """Write a recording as `Recording.to_mcap` describes."""
    selected = frozenset(topic.name for topic in recording.select_topics(topics))
    channels = channels_of(recording, selected)
    if any(channel.message_encoding == "ulog" for channel in channels):
        raise CannotWrite(recording.name, "it is a ULog, whose messages have no encoding that MCAP knows")
    with new_file(path) as stream:
        writer = McapWriter(
            stream,
            profile=_profile_of(recording, channels, options.ros1),
            library=f"kleinkram {__version__}",
            compression="" if options.compression is ChunkCompression.none else options.compression.value,
            compress=_compressor(options),
            chunk_bytes=options.chunk_bytes,
            workers=COMPRESSION_THREADS,
        )
        with closing(writer):
            copy = MessageCopy(_Channels(writer, options.ros1).define, _adder(writer))
            copy.copy(recording.raw_messages(topics), share_reporter(recording, on_progress))
            copy.define_silent(channels)
            losses = find_losses(recording, _copy_other_records(recording, writer))
            made_from = _made_from(recording, None if topics is None else selected, sha256, losses, copy.left_out)
            writer.add_metadata(MADE_FROM, made_from.items())
            writer.finish()
        size_bytes = stream.tell()
    return McapResult(path, copy.message_count, size_bytes, losses, copy.left_out)


def _adder(writer: McapWriter) -> Callable[[int, RawMessage, bytes], None]:
    add_message = writer.add_message

    def add(number: int, message: RawMessage, data: bytes) -> None:
        _topic, log_ns, publish_ns, sequence, _data, _channel = message
        add_message(number, log_ns, data, publish_time_ns=publish_ns, sequence=sequence)

    return add


def _compressor(options: McapOptions) -> Callable[[bytes], bytes]:
    """Return what compresses chunks, in several threads at once."""
    level = _DEFAULT_LEVELS[options.compression] if options.level is None else options.level
    if options.compression is ChunkCompression.zstd:
        return _ThreadsZstd(level).compress
    if options.compression is ChunkCompression.lz4:
        return lambda raw: bytes(lz4.frame.compress(raw, compression_level=level))
    return bytes


class _ThreadsZstd(threading.local):
    """A zstd compressor for each thread: one cannot be used by two at once."""

    def __init__(self, level: int) -> None:
        self._compressor = zstandard.ZstdCompressor(level=level)

    def compress(self, raw: bytes) -> bytes:
        return self._compressor.compress(raw)


def _profile_of(recording: Recording, channels: list[Channel], ros1: Ros1Messages) -> str:
    """Return the profile of the source; where it has none, or messages are re-encoded, that of the messages."""
    encodings = {channel.message_encoding for channel in channels}
    if ros1 is Ros1Messages.reencode and "ros1" in encodings:
        return "ros2" if encodings <= {"ros1", "cdr"} else ""
    profiles = {member.contents.profile for member in recording.members}
    if profiles == {""}:
        profiles = {_PROFILES.get(encoding, "") for encoding in encodings}
    return profiles.pop() if len(profiles) == 1 else ""


class _Channels:
    """The channels of the output. Equal channels of several files become one."""

    def __init__(self, writer: McapWriter, ros1: Ros1Messages) -> None:
        self._writer, self._ros1 = writer, ros1
        self._routes: dict[tuple[str, str, Schema, Properties], Route] = {}

    def define(self, channel: Channel, data: bytes) -> Route:
        """Return the channel of the output; `data`: the first message."""
        key = channel.topic, channel.message_encoding, channel.schema, channel.properties
        if key not in self._routes:
            self._routes[key] = self._new(channel, data)
        return self._routes[key]

    def _new(self, channel: Channel, data: bytes) -> Route:
        if channel.message_encoding == "ros1" and self._ros1 is Ros1Messages.reencode:
            made = re_encoding_of(channel, channel.schema)
            schema = Schema(made.name, "ros2msg", made.definition.encode())
            properties = _ros2_properties(channel.properties)
            return Route(self._add(channel.topic, "cdr", schema, properties), made.transcode)
        schema = with_definition(channel.schema, channel.message_encoding, data)
        return Route(self._add(channel.topic, channel.message_encoding, schema, channel.properties))

    def _add(self, topic: str, message_encoding: str, schema: Schema, properties: Properties) -> int:
        is_empty = schema == Schema("", "", b"")
        schema_id = 0 if is_empty else self._writer.add_schema(schema.name, schema.encoding, schema.data)
        return self._writer.add_channel(topic, schema_id, message_encoding, properties)


def _ros2_properties(properties: Properties) -> Properties:
    """Return the properties of a ROS 1 channel as ROS 2 has them: a latched topic is transient local."""
    kept = tuple((name, value) for name, value in properties if name not in ("latching", "md5sum"))
    return (*kept, ("offered_qos_profiles", _LATCHED_QOS)) if dict(properties).get("latching") == "1" else kept


def _copy_other_records(recording: Recording, writer: McapWriter) -> list[LostPlace]:
    """Copy attachments and metadata records; return those that are damaged."""
    damaged: list[LostPlace] = []
    for member in recording.members:
        if not isinstance(member, ChunkedMember):
            continue
        for record in member.format.find_other_records(member.source, member.table):
            if isinstance(record, Malformed):
                damaged.append(LostPlace(record.where, record.message))
                continue
            stream = open_range(member.source, record.start, record.start + record.length, window=WINDOW)
            writer.copy_record(record, iter(lambda: stream.take_some(WINDOW), b""))  # noqa: B023  # used up here
    return damaged


def _made_from(
    recording: Recording,
    topics: frozenset[str] | None,
    sha256: Mapping[str, str],
    losses: tuple[MemberLoss, ...],
    left_out: tuple[LeftOut, ...],
) -> dict[str, str]:
    files = [{"name": name, "sha256": sha256[name]} if name in sha256 else {"name": name} for name in recording.files]
    entries = {"version": __version__, "files": json.dumps(files)}
    if topics is not None:
        entries["topics"] = json.dumps(sorted(topics))
    if losses:
        entries["losses"] = json.dumps([asdict(loss) for loss in losses])
    if left_out:
        entries["left_out"] = json.dumps([asdict(part) for part in left_out])
    return entries
