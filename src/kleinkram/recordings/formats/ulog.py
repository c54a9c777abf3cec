"""PX4 flight logs (ULog): topics, counts, times, by one pass over the message heads.

Times are those of the autopilot's clock, which starts at boot: nanoseconds since then. A log begins with the latest
message of each topic, published before; its log time is that of the beginning. The autopilot announces everything that
may speak: topics are those that did.

Source: docs.px4.io, ULog File Format (version 1).
"""

from __future__ import annotations

import struct
from array import array
from collections import defaultdict
from dataclasses import dataclass, field

from kleinkram.recordings.errors import Cut, Malformed
from kleinkram.recordings.limits import MAX_NAME, MAX_TOPICS, WINDOW
from kleinkram.recordings.model import Content, Depth, Fact, Lost, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import Forward
from kleinkram.recordings.streams import ForwardStream
from kleinkram.recordings.timeline import Timeline
from kleinkram.recordings.topic_statistics import TopicType, bounded, measure

_FILE_HEAD = struct.Struct("<7sBQ")
_HEAD = struct.Struct("<HB")
_U16 = struct.Struct("<H")
_U64 = struct.Struct("<Q")
_KNOWN = frozenset(b"ABCDFILMOPQRS")
_SIZES = {"int8_t": 1, "uint8_t": 1, "bool": 1, "char": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4}
_SIZES |= {"float": 4, "int64_t": 8, "uint64_t": 8, "double": 8}
_TOLD = ("sys_name", "ver_hw", "ver_sw_release", "sys_uuid", "replay")
_FLUSH_AT = 100_000
_LATEST_US = (2**63 - 1) // 1000


@dataclass
class _Log:
    version: int = 0
    start_us: int = 0
    stamp_places: dict[str, int | None] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)
    types: dict[str, list[TopicType]] = field(default_factory=dict)
    stamps: dict[str, array[int]] = field(default_factory=lambda: defaultdict(lambda: array("Q")))
    sizes: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    told: dict[str, str] = field(default_factory=dict)
    waiting: int = 0
    without_time: int = 0
    before_start: int = 0
    undefined: int = 0
    dropouts: int = 0
    dropped_ms: int = 0
    texts: int = 0
    parameters: int = 0


def describe_ulog(forward: Forward) -> RecordingSummary:
    """Read a whole flight log; one that breaks off is `recovered` up to there.

    Raises:
        SourceError: as `Forward.read`.
    """
    log, timeline = _Log(), Timeline()
    stream = ForwardStream(lambda: forward.read(WINDOW))
    ended: Malformed | None = None
    try:
        _, log.version, start_us = _FILE_HEAD.unpack(stream.take(_FILE_HEAD.size))
        log.start_us = start_us if start_us <= _LATEST_US else 0
        while not stream.at_end():
            _read_message(log, stream)
            if log.waiting >= _FLUSH_AT:
                _flush(log, timeline)
    except Malformed as error:
        ended = error
    _flush(log, timeline)
    timeline.settle(None)
    return _summary(log, timeline, ended, forward.size_bytes - stream.position)


def _read_message(log: _Log, stream: ForwardStream) -> None:
    start = stream.position
    length, kind = _HEAD.unpack(stream.take(_HEAD.size))
    if kind not in _KNOWN:
        raise Malformed(f"byte {start}", "something that is no message")
    body = stream.take(length)
    if kind == ord("D"):
        _read_data(log, body)
    elif kind == ord("A"):
        _read_subscription(log, body)
    elif kind == ord("F"):
        name, _, fields = body.decode("utf-8", "replace").partition(":")
        if len(log.stamp_places) < MAX_TOPICS:
            log.stamp_places[name[:MAX_NAME]] = _place_of_stamp(fields)
    elif kind == ord("I"):
        _read_information(log, body)
    elif kind == ord("O") and length >= _U16.size:
        log.dropouts += 1
        log.dropped_ms += _U16.unpack_from(body)[0]
    log.texts += kind in b"LC"
    log.parameters += kind == ord("P")


def _read_data(log: _Log, body: bytes) -> None:
    name = log.topics.get(_U16.unpack_from(body)[0]) if len(body) >= _U16.size else None
    if name is None:
        log.undefined += 1
        return
    place = log.stamp_places.get(log.types[name][0].message_type)
    at = _U16.size + (place or 0)
    if place is None or at + _U64.size > len(body) or (stamp := _U64.unpack_from(body, at)[0]) > _LATEST_US:
        log.without_time += 1
        return
    log.before_start += stamp < log.start_us
    log.stamps[name].append(max(stamp, log.start_us) * 1000)
    log.sizes[name] += _HEAD.size + len(body)
    log.waiting += 1


def _read_subscription(log: _Log, body: bytes) -> None:
    if len(body) < 3 or len(log.topics) >= MAX_TOPICS:
        return
    kind = body[3 : 3 + MAX_NAME].decode("utf-8", "replace")
    name = f"{kind}#{body[0]}" if body[0] else kind
    log.topics[_U16.unpack_from(body, 1)[0]] = name
    log.types[name] = [TopicType(kind, "ulog", "ulog")]


def _read_information(log: _Log, body: bytes) -> None:
    """Keep what tells which vehicle it was: a key such as `char[4] sys_name`, and its text."""
    key_bytes = body[0] if body else 0
    key, value = body[1 : 1 + key_bytes], body[1 + key_bytes :]
    kind, _, name = key.decode("utf-8", "replace").partition(" ")
    if kind.startswith("char") and name in _TOLD:
        log.told[name] = value[:MAX_NAME].decode("utf-8", "replace")


def _place_of_stamp(fields: str) -> int | None:
    """Return where `timestamp` stands in a message: the first field, if it comes from PX4. None: nowhere known."""
    place = 0
    for entry in fields.split(";"):
        kind, _, name = entry.strip().partition(" ")
        if name == "timestamp":
            return place if kind == "uint64_t" else None
        base, _, count = kind.rstrip("]").partition("[")
        if base not in _SIZES or (count and not count.isdecimal()):
            return None
        place += _SIZES[base] * (int(count[:6]) if count else 1)
    return None


def _flush(log: _Log, timeline: Timeline) -> None:
    for name, stamps in log.stamps.items():
        timeline.add(name, stamps, log.sizes[name])
    log.stamps.clear()
    log.sizes.clear()
    log.waiting = 0
    timeline.settle(0)


def _summary(log: _Log, timeline: Timeline, ended: Malformed | None, left: int) -> RecordingSummary:
    measured = measure(timeline, log.types)
    reason, content = None, Content.indexed
    if ended is not None:
        what = "the log was cut" if isinstance(ended, Cut) else f"{ended.message}, at {ended.where}"
        reason = f"{what}; {counted(measured.message_count, 'message')} before it can be read"
        content = Content.recovered if measured.topics else Content.broken
    return RecordingSummary(
        format=RecordingFormat.ulog,
        content=content,
        reason=reason,
        message_count=measured.message_count,
        start_ns=measured.start_ns,
        end_ns=measured.end_ns,
        compression=("none",),
        topics=measured.topics,
        problems=bounded([*_problems(log), *measured.problems]),
        depth=Depth.scan,
        lost=Lost(max(left, 0), 0, None) if ended is not None else None,
        facts=(*_facts(log), Fact("topics_without_message", len(log.types) - len(measured.topics))),
    )


def _problems(log: _Log) -> list[Problem]:
    problems: list[Problem] = []
    if log.dropouts:
        message = f"the logger lost messages {counted(log.dropouts, 'time')}, {log.dropped_ms} ms in all"
        problems.append(Problem("dropouts", "file", message))
    if log.without_time:
        message = f"{counted(log.without_time, 'message has', 'messages have')} no timestamp that can be read; left out"
        problems.append(Problem("rows-unusable", "file", message))
    if log.before_start:
        early = counted(log.before_start, "message is", "messages are")
        message = f"{early} stamped before the log's start; the log time is that of the start"
        problems.append(Problem("stamps-before-start", "file", message))
    if log.undefined:
        message = (
            f"{counted(log.undefined, 'message belongs', 'messages belong')} to no topic that the log defines; left out"
        )
        problems.append(Problem("topic-undefined", "file", message))
    return problems


def _facts(log: _Log) -> list[Fact]:
    return [
        Fact("version", log.version),
        Fact("start_since_boot", log.start_us / 1e6, "s"),
        Fact("logged_texts", log.texts),
        Fact("parameters", log.parameters),
        Fact("dropouts", log.dropouts),
        *(Fact(name, value) for name, value in log.told.items()),
    ]
