"""The PX4 flight log format (ULog): one pass finds topics, counts, times and the offsets of messages.

Times are those of the autopilot's clock, which starts at boot: nanoseconds since then. A log begins with the latest
message of each topic, published before; its log time is that of the beginning. A topic is the name of a message format;
instances of it other than the first are told apart by their number, as in `sensor_accel#1`. A file has no index and no
checksum: behind damage, reading continues at the next sync message.

Source: docs.px4.io, ULog File Format (version 1).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import lru_cache, partial
from typing import NamedTuple

from kleinkram.recordings.chunk_reader import ChunkedMember, ChunkFormat
from kleinkram.recordings.chunk_table import ChunkTableBuilder
from kleinkram.recordings.compression import Buffer
from kleinkram.recordings.damage_report import DamageReport
from kleinkram.recordings.errors import Cut, Malformed
from kleinkram.recordings.file_summary import TopicType, build_summary, pending
from kleinkram.recordings.formats.base import Format, MemberContents, OpenContext, RecordingFile
from kleinkram.recordings.limits import MAX_DEFINITIONS, MAX_NAME, MAX_TOPICS, WINDOW
from kleinkram.recordings.messages import Block, Channel, RawMessage, Schema, Selection
from kleinkram.recordings.model import Content, Depth, Fact, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.scanned_messages import Batch, LocationKind, MessageCounter, MessageLocation
from kleinkram.recordings.sources import SequentialReader, Source, SourceReader
from kleinkram.recordings.streams import LookaheadStream

MAGIC = b"ULog\x01\x12\x35"
SYNC_MAGIC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_FILE_HEADER = struct.Struct("<7sBQ")
_MESSAGE_HEADER = struct.Struct("<HB")
_FLAG_BITS = struct.Struct("<8s8s3Q")
_SYNC = struct.Struct("<HB8s").pack(len(SYNC_MAGIC), ord("S"), SYNC_MAGIC)
_U16 = struct.Struct("<H")
_U64 = struct.Struct("<Q")
_DATA_APPENDED = 0x01
_SEARCH_BYTES = 4 * 2**20
_MAX_MESSAGE = _MESSAGE_HEADER.size + 2**16 - 1
_MAX_NESTING = 20
_MAX_FORMAT_BYTES = 2**16
_LATEST_US = (2**63 - 1) // 1000
_INFORMATION = ("sys_name", "ver_hw", "ver_sw_release", "sys_uuid", "replay")
_FIELD = re.compile(r"(?P<type>\w+)(\[(?P<length>\d{1,5})\])? (?P<name>\w+)")
_SIZES = {"int8_t": 1, "uint8_t": 1, "bool": 1, "char": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4}
_SIZES |= {"float": 4, "int64_t": 8, "uint64_t": 8, "double": 8}
_ROS_TYPES = {"float": "float32", "double": "float64", "char": "uint8"}


class MessageType(IntEnum):
    """The type of a ULog message: its second header field."""

    add_logged = ord("A")
    flag_bits = ord("B")
    logged_string_tagged = ord("C")
    data = ord("D")
    format = ord("F")
    information = ord("I")
    logged_string = ord("L")
    information_multiple = ord("M")
    dropout = ord("O")
    parameter = ord("P")
    default_parameter = ord("Q")
    remove_logged = ord("R")
    sync = ord("S")


_MESSAGE_TYPES = frozenset(map(int, MessageType))


class Subscription(NamedTuple):
    """A topic by its message id. `stamp_at`: offset of the timestamp in the data; None: it has none."""

    topic: str
    message_type: str
    stamp_at: int | None


@dataclass
class UlogScan:
    """Result of one pass over a log."""

    version: int = 0
    start_us: int = 0
    formats: dict[str, str] = field(default_factory=dict)
    format_bytes: int = 0
    subscriptions: dict[int, Subscription] = field(default_factory=dict)
    counter: MessageCounter = field(default_factory=lambda: MessageCounter(with_publish_times=False))
    losses: DamageReport = field(default_factory=DamageReport)
    refused: str = ""
    is_cut: bool = False
    information: dict[str, str] = field(default_factory=dict)
    without_time: int = 0
    before_start: int = 0
    undefined: int = 0
    dropouts: int = 0
    dropped_ms: int = 0
    texts: int = 0
    parameters: int = 0

    def channels(self) -> dict[int, Channel]:
        """Return the topics with their formats, by message id."""
        return {
            number: Channel(one.topic, "ulog", Schema(one.message_type, "ulog", self._definition(one.message_type)))
            for number, one in self.subscriptions.items()
        }

    def _definition(self, name: str) -> bytes:
        """Return the format of a message and those that it nests, one a line, as the file has them."""
        needed = [name]
        for outer in needed:
            needed += [inner for inner, _, _ in parse_fields(self.formats.get(outer, "")) if inner not in needed]
        return "\n".join(f"{one}:{self.formats[one]}" for one in needed if one in self.formats).encode()


class UlogField(NamedTuple):
    """A field of a format. `length`: of an array; None: a single value."""

    type_name: str
    length: int | None
    name: str


def parse_fields(text: str) -> list[UlogField]:
    """Return the fields of a format, such as "uint64_t timestamp;float[3] xyz"; invalid ones are left out."""
    matches = (_FIELD.fullmatch(entry.strip()) for entry in text.split(";"))
    return [UlogField(m["type"], int(m["length"]) if m["length"] else None, m["name"]) for m in matches if m]


def _size_of(formats: Mapping[str, str], type_name: str, depth: int = 0) -> int:
    if type_name in _SIZES:
        return _SIZES[type_name]
    if depth == _MAX_NESTING:
        raise KeyError(type_name)
    fields = parse_fields(formats[type_name])
    return sum(_size_of(formats, one.type_name, depth + 1) * (one.length or 1) for one in fields)


@lru_cache(maxsize=1024)
def stamp_offset(name: str, definition: bytes) -> int | None:
    """Return the offset of the field `timestamp` in a message; None if unknown."""
    formats = _formats_of(definition)
    offset = 0
    for one in parse_fields(formats.get(name, "")):
        if one.name == "timestamp":
            return offset if (one.type_name, one.length) == ("uint64_t", None) else None
        try:
            offset += _size_of(formats, one.type_name) * (one.length or 1)
        except KeyError:
            return None
    return None


def _formats_of(definition: bytes) -> dict[str, str]:
    lines = (line.partition(":") for line in definition.decode("utf-8", "replace").splitlines())
    return {name: fields for name, _, fields in lines}


def as_ros1_definition(name: str, definition: bytes) -> bytes:
    """Return a format as a ROS 1 definition: messages are laid out alike, but for padding at the end."""
    formats = _formats_of(definition)
    texts = [_ros1_fields(formats.get(name, ""), is_top=True)]
    texts += [f"MSG: ulog/{nested}\n{_ros1_fields(fields)}" for nested, fields in formats.items() if nested != name]
    return f"\n{'=' * 80}\n".join(texts).encode()


def _ros1_fields(text: str, *, is_top: bool = False) -> str:
    fields = parse_fields(text)
    while is_top and fields and fields[-1].name.startswith("_padding"):
        fields.pop()
    lines = []
    for one in fields:
        is_basic = one.type_name in _SIZES
        kind = _ROS_TYPES.get(one.type_name, one.type_name.removesuffix("_t")) if is_basic else f"ulog/{one.type_name}"
        # ROS allows no name that begins with "_", as that of padding does.
        name = f"{one.name.lstrip('_')}_" if one.name.startswith("_") else one.name
        lines.append(f"{kind}{'' if one.length is None else f'[{one.length}]'} {name}")
    return "\n".join(lines)


class _UlogScanner:
    def __init__(self, reader: SequentialReader, builder: ChunkTableBuilder | None) -> None:
        self.scan = UlogScan()
        self._stream = LookaheadStream(reader, with_crc=False)
        self._builder = builder
        self._batch = Batch(self.scan.subscriptions)
        self._appended: list[int] = []

    def run(self) -> UlogScan:
        scan, stream = self.scan, self._stream
        if stream.left < _FILE_HEADER.size:
            self._note_cut()
            return scan
        _, scan.version, start_us = _FILE_HEADER.unpack(stream.read_up_to(_FILE_HEADER.size))
        scan.start_us = start_us if start_us <= _LATEST_US else 0
        while stream.left and not scan.refused:
            self._step()
        scan.undefined += scan.counter.finish()
        return scan

    def _step(self) -> None:
        """Pass over the messages in memory, or over damage."""
        stream = self._stream
        at_hand = stream.ahead(max(WINDOW // 4, _MAX_MESSAGE))
        end = stream.at + at_hand
        boundary = self._next_boundary()
        if boundary is not None:
            end = min(end, stream.at + boundary - stream.position)
        start = stream.at
        after, is_damaged = self._read_messages(start, end)
        self._flush(after - start)
        if is_damaged:
            self._resync()
        elif boundary is not None and stream.position + _MAX_MESSAGE > boundary and after < end:
            stream.advance(boundary - stream.position)  # data that were appended cut the last message before them
        elif stream.left and after == start:
            self._note_cut()

    def _next_boundary(self) -> int | None:
        position = self._stream.position
        return min((one for one in self._appended if position < one <= self._stream.size_bytes), default=None)

    def _read_messages(self, at: int, end: int) -> tuple[int, bool]:
        """Read whole messages of the window; return where they end, and whether invalid data follow."""
        window, head_bytes = self._stream.window, _MESSAGE_HEADER.size
        unpack, data_type = _MESSAGE_HEADER.unpack_from, MessageType.data
        while at + head_bytes <= end:
            size, kind = unpack(window, at)
            body_at, after = at + head_bytes, at + head_bytes + size
            if kind not in _MESSAGE_TYPES:
                return at, True
            if after > end:
                break
            if kind == data_type:
                self._read_data(window, body_at, size)
            else:
                self._read_other(kind, bytes(window[body_at:after]))
            at = after
            if kind == MessageType.flag_bits:
                break  # it may define where messages end
        return at, False

    def _read_data(self, window: memoryview, at: int, size: int) -> None:
        scan = self.scan
        number = _U16.unpack_from(window, at)[0] if size >= _U16.size else -1
        subscription = scan.subscriptions.get(number)
        if subscription is None:
            scan.undefined += 1
            return
        offset = subscription.stamp_at
        is_there = offset is not None and _U16.size + offset + _U64.size <= size
        stamp_us = _U64.unpack_from(window, at + _U16.size + (offset or 0))[0] if is_there else _LATEST_US + 1
        if stamp_us > _LATEST_US:
            scan.without_time += 1
            return
        scan.before_start += stamp_us < scan.start_us
        self._batch[number].extend((max(stamp_us, scan.start_us) * 1000, 0, _MESSAGE_HEADER.size + size))

    def _read_other(self, kind: int, body: bytes) -> None:
        scan = self.scan
        if kind == MessageType.add_logged and len(body) >= 3 and len(scan.subscriptions) < MAX_TOPICS:
            instance, (number,) = body[0], _U16.unpack_from(body, 1)
            name = body[3 : 3 + MAX_NAME].decode("utf-8", "replace")
            if number not in scan.subscriptions:  # the first one of a message id counts
                topic = f"{name}#{instance}" if instance else name
                scan.subscriptions[number] = Subscription(topic, name, stamp_offset(name, scan._definition(name)))
        elif kind == MessageType.format:
            name, _, fields = body[:_MAX_FORMAT_BYTES].decode("utf-8", "replace").partition(":")
            scan.format_bytes += len(body)
            if len(scan.formats) < MAX_TOPICS and scan.format_bytes <= MAX_DEFINITIONS:
                scan.formats.setdefault(name[:MAX_NAME], fields)
        elif kind == MessageType.information and body:
            # A key with its type, such as `char[4] sys_name`, and its value.
            key, value = body[1 : 1 + body[0]], body[1 + body[0] :]
            value_type, _, name = key.decode("utf-8", "replace").partition(" ")
            if value_type.startswith("char") and name in _INFORMATION:
                scan.information[name] = value[:MAX_NAME].decode("utf-8", "replace")
        elif kind == MessageType.flag_bits and len(body) >= _FLAG_BITS.size:
            _compatible, incompatible, *offsets = _FLAG_BITS.unpack_from(body)
            if incompatible[0] & ~_DATA_APPENDED or any(incompatible[1:]):
                scan.refused = "the log uses features of a later version of ULog, which are not read"
            elif incompatible[0] & _DATA_APPENDED:
                self._appended = [offset for offset in offsets if offset]
        elif kind == MessageType.dropout and len(body) >= _U16.size:
            scan.dropouts += 1
            scan.dropped_ms += _U16.unpack_from(body)[0]
        scan.texts += kind in (MessageType.logged_string, MessageType.logged_string_tagged)
        scan.parameters += kind == MessageType.parameter

    def _flush(self, length: int) -> None:
        """Count what was read of the next `length` bytes, and pass over them."""
        scan, stream = self.scan, self._stream
        scan.counter.learn(scan.subscriptions)
        if self._builder is not None and self._batch:
            self._builder.add(MessageLocation(LocationKind.records, stream.position, length, length), self._batch)
        scan.counter.add(self._batch)
        self._batch = Batch(scan.subscriptions)
        stream.advance(length)

    def _resync(self) -> None:
        """Pass over damage, up to the next sync message or data that were appended."""
        stream, start = self._stream, self._stream.position
        self.scan.losses.note(Malformed(f"byte {start}", "invalid data instead of a message"))
        boundary = self._next_boundary()
        stop = stream.size_bytes if boundary is None else boundary
        while stream.position < stop:
            at_hand = min(stream.ahead(_SEARCH_BYTES), stop - stream.position)
            sync_at = bytes(stream.window[stream.at : stream.at + at_hand]).find(_SYNC)
            if sync_at >= 0:
                stream.advance(sync_at)
                break
            is_last = stream.position + at_hand == stop
            stream.advance(at_hand if is_last else at_hand - len(_SYNC) + 1)
        self.scan.losses.bytes += stream.position - start

    def _note_cut(self) -> None:
        stream = self._stream
        self.scan.is_cut = True
        self.scan.losses.note(Cut(f"byte {stream.position}", "the log was cut"))
        self.scan.losses.bytes += stream.left
        stream.advance(stream.left)


def scan_ulog(reader: SequentialReader) -> RecordingSummary:
    """Read a whole flight log."""
    return summarise_scan(_UlogScanner(reader, None).run())


def summarise_ulog(source: Source, max_bytes: int) -> RecordingSummary:
    """Scan a log of at most `max_bytes`; a larger one stays pending."""
    if source.size_bytes > max_bytes:
        return pending(RecordingFormat.ulog, source.size_bytes, "a flight log (ULog) has no index")
    return scan_ulog(SourceReader(source))


def summarise_scan(scan: UlogScan) -> RecordingSummary:
    """Return the summary of a log that was scanned."""
    types = {one.topic: [TopicType(one.message_type, "ulog", "ulog")] for one in scan.subscriptions.values()}
    timeline = scan.counter.timeline
    for name in [name for name, times in timeline.topics.items() if not times.count]:
        del timeline.topics[name]  # the autopilot announces all topics: those count that have messages
    summary = build_summary(RecordingFormat.ulog, timeline, types, [*scan.losses.problems(), *_problems(scan)])
    reason, content = scan.refused or None, Content.opaque if scan.refused else Content.indexed
    if scan.losses.damage and not scan.refused:
        first = scan.losses.damage[0]
        what = first.message if isinstance(first, Cut) or scan.is_cut else f"{first.message}, at {first.where}"
        reason = f"{what}; {counted(summary.message_count or 0, 'message')} can be read"
        content = Content.recovered if summary.topics else Content.broken
    return replace(
        summary,
        content=content,
        reason=reason,
        compression=("none",),
        depth=Depth.scan,
        lost=scan.losses.total(claimed=None, readable=0) if scan.losses.damage else None,
        facts=(
            Fact("version", scan.version),
            Fact("start_since_boot", scan.start_us / 1e6, "s"),
            Fact("logged_texts", scan.texts),
            Fact("parameters", scan.parameters),
            Fact("dropouts", scan.dropouts),
            *(Fact(name, value) for name, value in scan.information.items()),
            Fact("topics_without_message", len(types) - len(summary.topics)),
        ),
    )


def _problems(scan: UlogScan) -> Iterator[Problem]:
    if scan.dropouts:
        message = f"the logger lost messages {counted(scan.dropouts, 'time')}, {scan.dropped_ms} ms in all"
        yield Problem("dropouts", "file", message)
    if scan.without_time:
        without = counted(scan.without_time, "message has", "messages have")
        yield Problem("rows-unusable", "file", f"{without} no timestamp that can be read; left out")
    if scan.before_start:
        early = counted(scan.before_start, "message is", "messages are")
        message = f"{early} stamped before the log's start; the log time is that of the start"
        yield Problem("stamps-before-start", "file", message)
    if scan.undefined:
        undefined = counted(scan.undefined, "message belongs", "messages belong")
        yield Problem("topic-undefined", "file", f"{undefined} to no topic that the log defines; left out")


def open_ulog(file: RecordingFile, context: OpenContext) -> ChunkedMember:
    """Open a flight log, by one pass over it; `TooCostly` if it has more bytes than may be read."""
    source, problem_log = file.source, context.problem_log
    context.check_cost(source, "a flight log (ULog) has no index")
    builder = ChunkTableBuilder(problem_log)
    scan = _UlogScanner(SourceReader(source), builder).run()
    builder.close()
    channels = {number: one for number, one in scan.channels().items() if number in builder.counts}
    contents = MemberContents(channels, builder.counts, scan.counter.messages, *builder.table.span())
    ulog = ChunkFormat(partial(_parse_messages, start_us=scan.start_us))
    return ChunkedMember(source, ulog, builder.table, contents, problem_log, summary=summarise_scan(scan))


def _parse_messages(content: Buffer, channels: Mapping[int, Channel], selection: Selection, *, start_us: int) -> Block:
    """Return the selected messages of whole ULog messages, in file order."""
    view = bytes(content)
    messages: Block = []
    at = 0
    while at + _MESSAGE_HEADER.size <= len(view):
        size, kind = _MESSAGE_HEADER.unpack_from(view, at)
        body_at, at = at + _MESSAGE_HEADER.size, at + _MESSAGE_HEADER.size + size
        if kind != MessageType.data or size < _U16.size:
            continue
        channel = channels.get(_U16.unpack_from(view, body_at)[0])
        if channel is None:
            continue
        data = view[body_at + _U16.size : at]
        offset = stamp_offset(channel.schema.name, channel.schema.data)
        if offset is None or offset + _U64.size > len(data):
            continue
        stamp_us = _U64.unpack_from(data, offset)[0]
        log_ns = max(stamp_us, start_us) * 1000
        if stamp_us <= _LATEST_US and selection.start_ns <= log_ns < selection.end_ns:
            messages.append(RawMessage(channel.topic, log_ns, log_ns, 0, data, channel))
    return messages


ULOG = Format(
    RecordingFormat.ulog,
    lambda head: head.data.startswith(MAGIC),
    "a flight log (ULog)",
    extensions=(".ulg",),
    scan=scan_ulog,
    summarise=summarise_ulog,
    open=open_ulog,
)
