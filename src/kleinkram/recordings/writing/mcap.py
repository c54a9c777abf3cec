"""Writes a recording of any format, several recordings, or a slice of them as one MCAP.

Memory: the messages that are being merged, and what `McapWriter` holds.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard

from kleinkram import __version__
from kleinkram.recordings.chunk_reader import MAX_AHEAD, ChunkedMember
from kleinkram.recordings.decoding import DecodeError, Decoder, decoder_for
from kleinkram.recordings.decoding.msg_definitions import well_known_definitions
from kleinkram.recordings.errors import CannotWrite, EmptyRange, Malformed, OutsideRecording
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.messages import END_OF_TIME_NS, Channel, Properties, RawMessage, Schema, Selection, Time
from kleinkram.recordings.model import Content, RecordingFormat
from kleinkram.recordings.recording import OnProgress, Recording, Topics, merged_blocks, select_names
from kleinkram.recordings.streams import open_range
from kleinkram.recordings.time_range import resolve_range, utc_text
from kleinkram.recordings.writing.latched import latched_before
from kleinkram.recordings.writing.losses import LostPlace, MemberLoss, find_losses, losses_met
from kleinkram.recordings.writing.mcap_writer import McapWriter
from kleinkram.recordings.writing.new_file import new_file

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
        attachments: whether attachments are copied.
        metadata: whether metadata records are copied.
        latched: whether a slice begins with the valid messages of latched topics from before its start.
    """

    compression: ChunkCompression = ChunkCompression.zstd
    level: int | None = None
    chunk_bytes: int = 2**20
    attachments: bool = True
    metadata: bool = True
    latched: bool = True

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
    """

    message_count: int
    size_bytes: int
    losses: tuple[MemberLoss, ...]
    latched_count: int


@dataclass(frozen=True)
class McapResult(WrittenMcap):
    """A written MCAP, and its path."""

    path: Path


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
    return Selection(select_names(topics, names), *_time_range(recordings, start, end))


def _time_range(recordings: Sequence[Recording], start: Time | None, end: Time | None) -> tuple[int, int]:
    """Return the log times of a range.

    Raises:
        EmptyRange: the end is not after the start.
        OutsideRecording: nothing was recorded in it.
    """
    first_ns = min((one.start_ns for one in recordings if one.start_ns is not None), default=None)
    last_ns = max((one.end_ns for one in recordings if one.end_ns is not None), default=None)
    start_ns, end_ns = resolve_range(start, end, first_ns, last_ns)
    if end_ns <= start_ns:
        message = f"the time range is empty: its end, {utc_text(end_ns)}, is not after its start, {utc_text(start_ns)}"
        raise EmptyRange(message, start_ns=start_ns, end_ns=end_ns)
    selection = Selection(None, start_ns, end_ns)
    if selection.has_range and not any(_overlaps(recording, selection) for recording in recordings):
        raise OutsideRecording(
            _why_outside(recordings, selection, first_ns, last_ns), first_ns=first_ns, last_ns=last_ns
        )
    return start_ns, end_ns


def _why_outside(
    recordings: Sequence[Recording], selection: Selection, first_ns: int | None, last_ns: int | None
) -> str:
    name = recordings[0].name if len(recordings) == 1 else f"the {len(recordings)} recordings"
    after = f"from {utc_text(selection.start_ns)}" if selection.start_ns else ""
    before = "" if selection.end_ns == END_OF_TIME_NS else f"before {utc_text(selection.end_ns)}"
    nothing = f"nothing was recorded {' and '.join(filter(None, (after, before)))}"
    if first_ns is None or last_ns is None:
        return f"{name}: {nothing}: there are no messages"
    return f"{name}: {nothing}: the messages are from {utc_text(first_ns)} to {utc_text(last_ns)}"


def _overlaps(recording: Recording, selection: Selection) -> bool:
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
    sources = [source for source in sources if _overlaps(source.recording, selection)]
    recordings = [source.recording for source in sources]
    channels = [channel for channel in _channels_of(recordings) if selection.has_topic(channel.topic)]
    for recording in recordings:
        if any(channel.message_encoding == "ulog" for channel in _channels_of([recording])):
            raise CannotWrite(recording.name, "it is a ULog, whose messages have no encoding that MCAP knows")
    _share_read_ahead(recordings)
    writer = McapWriter(
        stream,
        profile=_profile_of(recordings, channels),
        library=f"kleinkram {__version__}",
        compression="" if options.compression is ChunkCompression.none else options.compression.value,
        compress=_compressor(options),
        chunk_bytes=options.chunk_bytes,
    )
    latched = _latched(recordings, selection) if options.latched else []
    message_count = _copy_messages(recordings, selection, latched, _Channels(writer, channels), on_progress)
    find = losses_met if _is_partly_read(recordings, selection) else find_losses
    copied = [(recording, _copy_other_records(recording, writer, options)) for recording in recordings]
    losses = tuple(loss for recording, damaged in copied for loss in find(recording, damaged))
    writer.add_metadata(MADE_FROM, _made_from(sources, selection, latched, losses).items())
    writer.finish()
    for recording in recordings:
        recording.check_unchanged()
    return WrittenMcap(message_count, writer.bytes_written, losses, len(latched))


def _is_partly_read(recordings: Sequence[Recording], selection: Selection) -> bool:
    """Return whether to measure losses would take far more bytes than the slice."""
    sources = [member.source for one in recordings for member in one.members if isinstance(member, ChunkedMember)]
    is_remote = any(getattr(source, "parallel_reads", 1) > 1 for source in sources)
    return selection.has_range or (selection.topics is not None and is_remote)


def _share_read_ahead(recordings: Sequence[Recording]) -> None:
    """Divide the memory for reading ahead between the recordings that are read at the same time."""
    at_once = _most_at_once(recordings)
    if at_once > 1:
        for recording in recordings:
            for member in recording.members:
                if isinstance(member, ChunkedMember):
                    member.max_ahead = min(member.max_ahead, MAX_AHEAD // at_once)


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


def _compressor(options: McapOptions) -> Callable[[bytes], bytes]:
    level = _DEFAULT_LEVELS[options.compression] if options.level is None else options.level
    if options.compression is ChunkCompression.zstd:
        return zstandard.ZstdCompressor(level=level).compress
    if options.compression is ChunkCompression.lz4:
        return lambda raw: bytes(lz4.frame.compress(raw, compression_level=level))
    return bytes


def _channels_of(recordings: Iterable[Recording]) -> Iterator[Channel]:
    for recording in recordings:
        for member in recording.members:
            yield from member.contents.channels.values()


def _profile_of(recordings: Iterable[Recording], channels: list[Channel]) -> str:
    """Return the profile of the sources; where they have none, that of their messages."""
    profiles = {member.contents.profile for recording in recordings for member in recording.members}
    if profiles == {""}:
        profiles = {_PROFILES.get(channel.message_encoding, "") for channel in channels}
    return profiles.pop() if len(profiles) == 1 else ""


class _Channels:
    """The channels of the output. Equal channels of several files or recordings become one."""

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
    recordings: Sequence[Recording],
    selection: Selection,
    latched: Iterable[RawMessage],
    channels: _Channels,
    on_progress: OnProgress | None,
) -> int:
    add, numbers = channels.writer.add_message, dict[int, int]()
    start_ns = max(selection.start_ns, min((one.start_ns or 0 for one in recordings), default=0))
    end_ns = min(selection.end_ns, max((one.end_ns or 0 for one in recordings), default=0))
    span_ns = max(1, end_ns - start_ns)
    first = (message._replace(log_time_ns=selection.start_ns) for message in latched)
    blocks = merged_blocks(recordings, selection) if recordings else iter(())
    count = 0
    messages = chain(first, chain.from_iterable(blocks))
    for count, (_topic, log_ns, publish_ns, sequence, data, channel) in enumerate(messages, 1):
        number = numbers.get(id(channel))
        if number is None:
            number = numbers[id(channel)] = channels.number_of(channel, data)
        add(number, log_ns, data, publish_time_ns=publish_ns, sequence=sequence)
        if on_progress is not None and count % _PROGRESS_MESSAGES == 0:
            on_progress(min(1.0, max(0.0, (log_ns - start_ns) / span_ns)))
    channels.define_silent()
    return count


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
