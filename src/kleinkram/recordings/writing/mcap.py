"""Writes a recording of any format, several recordings, or a slice of them as one MCAP.

Memory: the messages that are being merged, and what `McapWriter` holds.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from enum import Enum
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import BinaryIO, Protocol

import lz4.frame
import zstandard

from kleinkram import __version__
from kleinkram.recordings.chunk_reader import MAX_AHEAD, ChunkedMember
from kleinkram.recordings.errors import EmptyRange, Malformed, NotConvertible, OutsideRecording
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.messages import END_OF_TIME_NS, Channel, Properties, RawMessage, Schema, Selection, Time
from kleinkram.recordings.model import Content, RecordingFormat
from kleinkram.recordings.recording import OnProgress, Recording, Topics, merged_blocks, select_names
from kleinkram.recordings.streams import open_range
from kleinkram.recordings.time_range import resolve_range, utc_text
from kleinkram.recordings.writing.chunked_writer import COMPRESSION_THREADS
from kleinkram.recordings.writing.latched import latched_before, publisher_count
from kleinkram.recordings.writing.losses import LostPlace, MemberLoss, find_losses, losses_met
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
        attachments: whether attachments are copied.
        metadata: whether metadata records are copied.
        latched: whether a slice begins with the valid messages of latched topics from before its start.
        ros1: what becomes of ROS 1 messages.
    """

    compression: ChunkCompression = ChunkCompression.zstd
    level: int | None = None
    chunk_bytes: int = 2**20
    attachments: bool = True
    metadata: bool = True
    latched: bool = True
    ros1: Ros1Messages = Ros1Messages.keep

    def __post_init__(self) -> None:
        levels = LEVELS[self.compression]
        if self.level is not None and self.level not in levels:
            raise ValueError(f"{self.compression.value} has levels {levels[0]} to {levels[-1]}, not {self.level}")
        if self.chunk_bytes < 1:
            raise ValueError(f"chunks of {self.chunk_bytes} bytes cannot be written")


@dataclass(frozen=True)
class WrittenMcap:
    """What was written.

    Attributes:
        losses: what of the recordings could not be read; empty if nothing was lost.
        latched_count: messages of latched topics from before the start of a slice, among `message_count`.
        left_out: ROS 1 messages that could not be re-encoded.
    """

    message_count: int
    size_bytes: int
    losses: tuple[MemberLoss, ...]
    latched_count: int
    left_out: tuple[LeftOut, ...]


@dataclass(frozen=True)
class McapResult(WrittenMcap):
    """A written MCAP, and its path."""

    path: Path


def is_whole_mcap(recording: Recording, compression: ChunkCompression) -> bool:
    """Return whether a recording is one MCAP, indexed, undamaged and with this compression. Reads all of it.

    Raises:
        SourceError: the bytes cannot be read.
    """
    return is_whole(recording, RecordingFormat.mcap, compression.value)


def is_whole(recording: Recording, file_format: RecordingFormat, compression: str) -> bool:
    """Return whether a recording is one file of this format, indexed, undamaged, and compressed so. Reads all of it.

    Raises:
        SourceError: the bytes cannot be read.
    """
    if len(recording.members) != 1 or recording.members[0].summary is not None:
        return False  # it was scanned to be opened, so its index is not usable
    (summary,) = recording.scan_files()
    has_good_index = not any(problem.code in ("index-damaged", "counts-disagree") for problem in summary.problems)
    is_whole = (summary.format, summary.content) == (file_format, Content.indexed) and summary.lost is None
    return is_whole and has_good_index and set(summary.compression) <= {compression}


def merge_to_mcap(
    recordings: Sequence[Recording],
    path: str | PathLike[str],
    topics: Topics | None = None,
    *,
    start: Time | None = None,
    end: Time | None = None,
    options: McapOptions | None = None,
    sha256: Sequence[Mapping[str, str]] | None = None,
    on_progress: OnProgress | None = None,
) -> McapResult:
    """Write several recordings, or a slice of them, as one MCAP in log time order, as `Recording.to_mcap` does one.

    They may overlap in time. Messages of equal log times have the order of the recordings. Channels with the same
    topic, encodings, schema and properties become one; others stay apart, also those of one topic. Recordings
    without messages in the time range are left out. `sha256`: one mapping for each recording.

    Times such as `10:00` and `+20s` refer to the earliest start of the recordings. Errors are those of
    `Recording.to_mcap`; a topic must be in at least one of them.
    """
    options = options or McapOptions()
    selection = select_slice(recordings, topics, start, end)
    hashes = [recording.sha256 for recording in recordings] if sha256 is None else sha256
    sources = [SliceSource(*pair) for pair in zip(recordings, hashes, strict=True)]
    path = Path(path)
    with new_file(path) as stream:
        written = write_slice(stream, sources, selection, options, on_progress)
    return McapResult(**vars(written), path=path)


def select_slice(
    recordings: Sequence[Recording], topics: Topics | None, start: Time | None, end: Time | None
) -> Selection:
    """Return the topics and log times of a slice of recordings; errors are those of `merge_to_mcap`."""
    names = sorted({topic.name for recording in recordings for topic in recording.topics})
    name = recordings[0].name if len(recordings) == 1 else f"the {len(recordings)} recordings"
    return Selection(select_names(topics, names), *select_range(recordings, start, end, name=name))


class RecordedTime(Protocol):
    """A recording, opened or as the server knows it. None: unknown, or no messages."""

    @property
    def start_ns(self) -> int | None:
        """Earliest log time."""

    @property
    def end_ns(self) -> int | None:
        """Latest log time, inclusive."""

    @property
    def message_count(self) -> int | None:
        """The number of its messages."""


def select_range(
    recordings: Sequence[RecordedTime], start: Time | None, end: Time | None, *, name: str
) -> tuple[int, int]:
    """Return the log times of a range; `name`: of the recordings, for messages.

    Raises:
        EmptyRange: the end is not after the start.
        OutsideRecording: nothing was recorded in it.
        ValueError: a text is no time.
    """
    first_ns = min((one.start_ns for one in recordings if one.start_ns is not None), default=None)
    last_ns = max((one.end_ns for one in recordings if one.end_ns is not None), default=None)
    start_ns, end_ns = resolve_range(start, end, first_ns, last_ns)
    if end_ns <= start_ns:
        message = f"the end, {utc_text(end_ns)}, is not after the start, {utc_text(start_ns)}"
        raise EmptyRange(message, start_ns=start_ns, end_ns=end_ns)
    selection = Selection(None, start_ns, end_ns)
    if selection.has_range and not any(may_overlap(recording, selection) for recording in recordings):
        raise OutsideRecording(
            f"{name}: {_why_outside(selection, first_ns, last_ns)}", first_ns=first_ns, last_ns=last_ns
        )
    return start_ns, end_ns


def _why_outside(selection: Selection, first_ns: int | None, last_ns: int | None) -> str:
    after = f"from {utc_text(selection.start_ns)}" if selection.start_ns else ""
    before = "" if selection.end_ns == END_OF_TIME_NS else f"before {utc_text(selection.end_ns)}"
    nothing = f"nothing was recorded {' and '.join(filter(None, (after, before)))}"
    if first_ns is None or last_ns is None:
        return f"{nothing}: there are no messages"
    return f"{nothing}: the messages are from {utc_text(first_ns)} to {utc_text(last_ns)}"


def may_overlap(recording: RecordedTime, selection: Selection) -> bool:
    """Return whether a recording may have messages in a time range, by its index."""
    if not selection.has_range:
        return True
    if recording.start_ns is None or recording.end_ns is None:
        return recording.message_count != 0  # a database without an index of times says neither
    return recording.start_ns < selection.end_ns and recording.end_ns >= selection.start_ns


@dataclass(frozen=True)
class SliceSource:
    """A recording, and the SHA-256 of its files by name, as far as they are known."""

    recording: Recording
    sha256: Mapping[str, str]


def write_slice(
    stream: BinaryIO,
    sources: Sequence[SliceSource],
    selection: Selection,
    options: McapOptions,
    on_progress: OnProgress | None = None,
) -> WrittenMcap:
    """Write a slice of recordings to a stream, which need not be seekable, as `merge_to_mcap` does to a file."""
    sources = [source for source in sources if may_overlap(source.recording, selection)]
    recordings = [source.recording for source in sources]
    channels = [channel for channel in channels_of(recordings) if selection.has_topic(channel.topic)]
    for recording in recordings:
        if any(channel.message_encoding == "ulog" for channel in channels_of([recording])):
            raise NotConvertible(recording.name, "it is a ULog, whose messages have no encoding that MCAP knows")
    share_read_ahead(recordings)
    writer = McapWriter(
        stream,
        profile=_profile_of(recordings, channels, options.ros1),
        library=f"kleinkram {__version__}",
        compression="" if options.compression is ChunkCompression.none else options.compression.value,
        compress=mcap_compressor(options),
        chunk_bytes=options.chunk_bytes,
        workers=COMPRESSION_THREADS,
    )
    with closing(writer):
        latched = _latched(recordings, selection) if options.latched else []
        copy = MessageCopy(_Channels(writer, options.ros1).define, _adder(writer))
        copy.copy(_messages(recordings, selection, latched), _progress_of(recordings, selection, on_progress))
        copy.define_silent(channels)
        copy.check_any(", ".join(recording.name for recording in recordings), "no message can be re-encoded")
        find = losses_met if _is_partly_read(recordings, selection) else find_losses
        copied = [(recording, _copy_other_records(recording, writer, options)) for recording in recordings]
        losses = tuple(loss for recording, damaged in copied for loss in find(recording, damaged))
        writer.add_metadata(MADE_FROM, _made_from(sources, selection, latched, losses, copy.left_out).items())
        writer.finish()
    for recording in recordings:
        recording.check_unchanged()
    return WrittenMcap(copy.message_count, writer.bytes_written, losses, len(latched), copy.left_out)


def _is_partly_read(recordings: Sequence[Recording], selection: Selection) -> bool:
    """Return whether to measure losses would take far more bytes than the slice."""
    sources = [member.source for one in recordings for member in one.members if isinstance(member, ChunkedMember)]
    is_remote = any(getattr(source, "parallel_reads", 1) > 1 for source in sources)
    return selection.has_range or (selection.topics is not None and is_remote)


def share_read_ahead(recordings: Sequence[Recording], *, with_gaps: bool = False) -> None:
    """Use all memory for reading ahead, divided between the recordings that are read at the same time.

    `with_gaps`: the reader leaves out parts of what it selects, so each read starts with little.
    """
    share = MAX_AHEAD // max(1, _most_at_once(recordings))
    for recording in recordings:
        for member in recording.members:
            if isinstance(member, ChunkedMember):
                member.max_ahead = min(member.max_ahead, share)
                member.first_ahead = 0 if with_gaps else member.max_ahead


def _most_at_once(recordings: Sequence[Recording]) -> int:
    """Return how many recordings overlap in time, at most; those of unknown times overlap all."""
    spans = [(recording.start_ns, recording.end_ns) for recording in recordings]
    known = [(first_ns, last_ns) for first_ns, last_ns in spans if first_ns is not None and last_ns is not None]
    overlaps = (sum(first_ns <= at_ns <= last_ns for first_ns, last_ns in known) for at_ns, _ in known)
    return max(overlaps, default=0) + len(spans) - len(known)


def _latched(recordings: Sequence[Recording], selection: Selection) -> list[RawMessage]:
    """Return the messages of latched topics that are valid at the start of a slice, by their original log times."""
    if not selection.start_ns:
        return []
    parts = (latched_before(recording, selection.topics, selection.start_ns) for recording in recordings)
    return sorted((message for part in parts for message in part), key=lambda message: message.log_time_ns)


def _adder(writer: McapWriter) -> Callable[[int, RawMessage, bytes], None]:
    add_message = writer.add_message

    def add(number: int, message: RawMessage, data: bytes) -> None:
        _topic, log_ns, publish_ns, sequence, _data, _channel = message
        add_message(number, log_ns, data, publish_time_ns=publish_ns, sequence=sequence)

    return add


def mcap_compressor(options: McapOptions) -> Callable[[bytes], bytes]:
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


def _profile_of(recordings: Iterable[Recording], channels: list[Channel], ros1: Ros1Messages) -> str:
    """Return the profile of the sources; where they have none, or messages are re-encoded, that of the messages."""
    encodings = {channel.message_encoding for channel in channels}
    if ros1 is Ros1Messages.reencode and "ros1" in encodings:
        return "ros2" if encodings <= {"ros1", "cdr"} else ""
    profiles = {member.contents.profile for recording in recordings for member in recording.members}
    if profiles == {""}:
        profiles = {_PROFILES.get(encoding, "") for encoding in encodings}
    return profiles.pop() if len(profiles) == 1 else ""


class _Channels:
    """The channels of the output. Equal channels of several files or recordings become one."""

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
            properties = _ros2_properties(channel)
            return Route(self._add(channel.topic, "cdr", schema, properties), made.transcode)
        schema = with_definition(channel.schema, channel.message_encoding, data)
        return Route(self._add(channel.topic, channel.message_encoding, schema, channel.properties))

    def _add(self, topic: str, message_encoding: str, schema: Schema, properties: Properties) -> int:
        is_empty = schema == Schema("", "", b"")
        schema_id = 0 if is_empty else self._writer.add_schema(schema.name, schema.encoding, schema.data)
        return self._writer.add_channel(topic, schema_id, message_encoding, properties)


def _ros2_properties(channel: Channel) -> Properties:
    """Return the properties of a ROS 1 channel as ROS 2 has them: a latched topic is transient local."""
    others = tuple((name, value) for name, value in channel.properties if name not in ("latching", "md5sum"))
    return (*others, ("offered_qos_profiles", _LATCHED_QOS)) if publisher_count(channel) else others


def _messages(
    recordings: Sequence[Recording], selection: Selection, latched: Iterable[RawMessage]
) -> Iterator[RawMessage]:
    """Yield the messages of a slice, those of latched topics first, with its start as log time."""
    first = (message._replace(log_time_ns=selection.start_ns) for message in latched)
    blocks = merged_blocks(recordings, selection) if recordings else iter(())
    return chain(first, chain.from_iterable(blocks))


def _progress_of(
    recordings: Sequence[Recording], selection: Selection, on_progress: OnProgress | None
) -> Callable[[int], None]:
    start_ns = max(selection.start_ns, min((one.start_ns or 0 for one in recordings), default=0))
    end_ns = min(selection.end_ns, max((one.end_ns or 0 for one in recordings), default=0))
    return share_reporter(start_ns, end_ns, on_progress)


def _copy_other_records(recording: Recording, writer: McapWriter, options: McapOptions) -> list[LostPlace]:
    """Copy attachments and metadata records; return those that are damaged."""
    damaged: list[LostPlace] = []
    opcodes = {Opcode.ATTACHMENT: options.attachments, Opcode.METADATA: options.metadata}
    selected = frozenset(opcode for opcode, is_selected in opcodes.items() if is_selected)
    for member in recording.members:
        if not isinstance(member, ChunkedMember) or not selected:
            continue
        for record in member.format.find_other_records(member.source, member.table, selected):
            if isinstance(record, Malformed):
                damaged.append(LostPlace(record.where, record.message))
                continue
            stream = open_range(member.source, record.start, record.start + record.length, window=WINDOW)
            writer.copy_record(record, iter(lambda: stream.take_some(WINDOW), b""))  # noqa: B023  # used up here
    return damaged


def _made_from(
    sources: Sequence[SliceSource],
    selection: Selection,
    latched: Iterable[RawMessage],
    losses: tuple[MemberLoss, ...],
    left_out: tuple[LeftOut, ...],
) -> dict[str, str]:
    entries = {"version": __version__, "files": json.dumps([*_files_of(sources)])}
    if selection.topics is not None:
        entries["topics"] = json.dumps(sorted(selection.topics))
    if selection.start_ns:
        entries["start_ns"] = str(selection.start_ns)
    if selection.end_ns != END_OF_TIME_NS:
        entries["end_ns"] = str(selection.end_ns)
    if log_times := _log_times(latched):
        entries["latched"] = json.dumps(log_times)
    if losses:
        entries["losses"] = json.dumps([asdict(loss) for loss in losses])
    if left_out:
        entries["left_out"] = json.dumps([asdict(part) for part in left_out])
    return entries


def _files_of(sources: Sequence[SliceSource]) -> Iterator[dict[str, str]]:
    """Yield name and SHA-256 of each file; among several recordings, also the number of its recording, from 0."""
    for number, source in enumerate(sources):
        recording = {"recording": str(number)} if len(sources) > 1 else {}
        for name in source.recording.files:
            known = {"sha256": source.sha256[name]} if name in source.sha256 else {}
            yield {"name": name, **known, **recording}


def _log_times(messages: Iterable[RawMessage]) -> dict[str, list[int]]:
    """Return the original log times by topic."""
    log_times: dict[str, list[int]] = {}
    for message in messages:
        log_times.setdefault(message.topic, []).append(message.log_time_ns)
    return log_times
