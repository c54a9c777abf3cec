"""Writes a recording of any format as one MCAP.

Memory: the messages that are being merged, and what `McapWriter` holds.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

import lz4.frame
import zstandard

from kleinkram import __version__
from kleinkram.recordings.chunk_reader import ChunkedMember
from kleinkram.recordings.decoding import DecodeError, Decoder, decoder_for
from kleinkram.recordings.decoding.msg_definitions import well_known_definitions
from kleinkram.recordings.errors import CannotWrite, Malformed
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.messages import Channel, Properties, Schema
from kleinkram.recordings.model import Content, RecordingFormat
from kleinkram.recordings.streams import open_range
from kleinkram.recordings.writing.losses import LostPlace, MemberLoss, find_losses
from kleinkram.recordings.writing.mcap_writer import McapWriter
from kleinkram.recordings.writing.new_file import new_file

if TYPE_CHECKING:
    from kleinkram.recordings.recording import OnProgress, Recording, Topics

MADE_FROM = "kleinkram:made_from"
"""Name of the metadata record that says what a file was made from."""

_PROGRESS_MESSAGES = 1000
_PROFILES = {"ros1": "ros1", "cdr": "ros2"}
_SEPARATOR = "=" * 80


class ChunkCompression(str, Enum):
    """Compression of chunks."""

    zstd = "zstd"
    lz4 = "lz4"
    none = "none"


LEVELS = {ChunkCompression.zstd: range(1, 23), ChunkCompression.lz4: range(17), ChunkCompression.none: range(1)}
_DEFAULT_LEVELS = {ChunkCompression.zstd: 3, ChunkCompression.lz4: 0, ChunkCompression.none: 0}


@dataclass(frozen=True)
class McapOptions:
    """How an MCAP is written.

    Attributes:
        compression: of chunks.
        level: 1 to 22 for zstd (default 3), 0 to 16 for lz4 (default 0); higher is smaller and slower.
        chunk_bytes: uncompressed bytes of messages after which a chunk ends.
    """

    compression: ChunkCompression = ChunkCompression.zstd
    level: int | None = None
    chunk_bytes: int = 2**20

    def __post_init__(self) -> None:
        levels = LEVELS[self.compression]
        if self.level is not None and self.level not in levels:
            raise ValueError(f"{self.compression.value} has levels {levels[0]} to {levels[-1]}, not {self.level}")
        if self.chunk_bytes < 1:
            raise ValueError(f"chunks of {self.chunk_bytes} bytes cannot be written")


@dataclass(frozen=True)
class McapResult:
    """A written MCAP. `losses`: what of the recording could not be read; empty if nothing was lost."""

    path: Path
    message_count: int
    size_bytes: int
    losses: tuple[MemberLoss, ...]


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
    channels = [channel for channel in _channels_of(recording) if channel.topic in selected]
    if any(channel.message_encoding == "ulog" for channel in channels):
        raise CannotWrite(recording.name, "it is a ULog, whose messages have no encoding that MCAP knows")
    with new_file(path) as stream:
        writer = McapWriter(
            stream,
            profile=_profile_of(recording, channels),
            library=f"kleinkram {__version__}",
            compression="" if options.compression is ChunkCompression.none else options.compression.value,
            compress=_compressor(options),
            chunk_bytes=options.chunk_bytes,
        )
        message_count = _copy_messages(recording, topics, _Channels(writer, channels), on_progress)
        losses = find_losses(recording, _copy_other_records(recording, writer))
        writer.add_metadata(
            MADE_FROM, _made_from(recording, None if topics is None else selected, sha256, losses).items()
        )
        writer.finish()
        size_bytes = stream.tell()
    return McapResult(path, message_count, size_bytes, losses)


def _compressor(options: McapOptions) -> Callable[[bytes], bytes]:
    level = _DEFAULT_LEVELS[options.compression] if options.level is None else options.level
    if options.compression is ChunkCompression.zstd:
        return zstandard.ZstdCompressor(level=level).compress
    if options.compression is ChunkCompression.lz4:
        return lambda raw: bytes(lz4.frame.compress(raw, compression_level=level))
    return bytes


def _channels_of(recording: Recording) -> Iterator[Channel]:
    for member in recording.members:
        yield from member.contents.channels.values()


def _profile_of(recording: Recording, channels: list[Channel]) -> str:
    """Return the profile of the source; where it has none, that of its messages."""
    profiles = {member.contents.profile for member in recording.members}
    if profiles == {""}:
        profiles = {_PROFILES.get(channel.message_encoding, "") for channel in channels}
    return profiles.pop() if len(profiles) == 1 else ""


class _Channels:
    """The channels of the output. Equal channels of several files become one."""

    def __init__(self, writer: McapWriter, channels: list[Channel]) -> None:
        self.writer = writer
        self._channels = channels
        self._numbers: dict[tuple[str, str, Schema, Properties], int] = {}

    def number_of(self, channel: Channel, data: bytes) -> int:
        """Return the number of a channel; `data`: its first message."""
        key = channel.topic, channel.message_encoding, channel.schema, channel.properties
        if key not in self._numbers:
            schema = _with_definition(channel.schema, channel.message_encoding, data)
            is_empty = schema == Schema("", "", b"")
            schema_id = 0 if is_empty else self.writer.add_schema(schema.name, schema.encoding, schema.data)
            self._numbers[key] = self.writer.add_channel(
                channel.topic, schema_id, channel.message_encoding, channel.properties
            )
        return self._numbers[key]

    def define_silent(self) -> None:
        """Define the channels without messages."""
        for channel in self._channels:
            self.number_of(channel, b"")


def _with_definition(schema: Schema, message_encoding: str, data: bytes) -> Schema:
    """Return the schema with the definition of its type, where the recording has none and the type is well known."""
    if schema.encoding or schema.data.strip() or message_encoding != "cdr":
        return schema
    texts = [text.replace("===\n", f"{_SEPARATOR}\n") for text in well_known_definitions(schema.name)]
    fitting = [text for text in texts if data and _is_readable(schema.name, text, data)]
    return Schema(schema.name, "ros2msg", (fitting or texts)[0].encode()) if texts else schema


def _is_readable(type_name: str, definition: str, data: bytes) -> bool:
    decoder = decoder_for("cdr", type_name, "ros2msg", definition.encode())
    try:
        return isinstance(decoder, Decoder) and decoder.decode(data) is not None
    except DecodeError:
        return False


def _copy_messages(
    recording: Recording, topics: Topics | None, channels: _Channels, on_progress: OnProgress | None
) -> int:
    add, numbers = channels.writer.add_message, dict[int, int]()
    start_ns = recording.start_ns or 0
    span_ns = max(1, (recording.end_ns or 0) - start_ns)
    count = 0
    for count, (_topic, log_ns, publish_ns, sequence, data, channel) in enumerate(recording.raw_messages(topics), 1):
        number = numbers.get(id(channel))
        if number is None:
            number = numbers[id(channel)] = channels.number_of(channel, data)
        add(number, log_ns, data, publish_time_ns=publish_ns, sequence=sequence)
        if on_progress is not None and count % _PROGRESS_MESSAGES == 0:
            on_progress(min(1.0, max(0.0, (log_ns - start_ns) / span_ns)))
    channels.define_silent()
    return count


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
    recording: Recording, topics: frozenset[str] | None, sha256: Mapping[str, str], losses: tuple[MemberLoss, ...]
) -> dict[str, str]:
    files = [{"name": name, "sha256": sha256[name]} if name in sha256 else {"name": name} for name in recording.files]
    entries = {"version": __version__, "files": json.dumps(files)}
    if topics is not None:
        entries["topics"] = json.dumps(sorted(topics))
    if losses:
        entries["losses"] = json.dumps([asdict(loss) for loss in losses])
    return entries
