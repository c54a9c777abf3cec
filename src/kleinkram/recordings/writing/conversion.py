"""Converts recordings to MCAPs or ROS 1 bags, each to a file of its own.

A recording that already is what it would become stays as it is; to be sure, all of it is read.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from kleinkram.recordings.errors import NotConvertible
from kleinkram.recordings.formats.base import Segment
from kleinkram.recordings.model import Content, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.writing.bag import BagOptions, BagResult, bag_compressor
from kleinkram.recordings.writing.mcap import McapOptions, McapResult, Ros1Messages, is_whole, mcap_compressor

if TYPE_CHECKING:
    from kleinkram.recordings.recording import OnProgress, Recording, Topics

_EXTENSIONS = (".active", ".zst", ".zstd", ".bag", ".mcap", ".db3", ".ulg")
_INDEX_PROBLEMS = frozenset(("index-damaged", "counts-disagree"))
_SAMPLED_SEGMENTS = 8
_TIMES = struct.Struct("<QQ")
_NAMES = {RecordingFormat.mcap: "an MCAP", RecordingFormat.rosbag1: "a bag"}

ConversionOptions = McapOptions | BagOptions
ConversionResult = McapResult | BagResult


@dataclass(frozen=True)
class ConversionPlan:
    """What a conversion would do.

    Attributes:
        reasons: what changes; empty if nothing does.
        size_bytes: of the files of the recording.
        estimated_bytes: of the output, by compressing some parts of the recording.
    """

    reasons: tuple[str, ...]
    size_bytes: int
    estimated_bytes: int


def plan_conversion(recording: Recording, options: ConversionOptions) -> ConversionPlan:
    """Return what a conversion would do. Reads the index and a few parts of the recording.

    Raises:
        NotConvertible: it is a ULog.
        SourceError: the bytes cannot be read.
    """
    if any(topic.message_encoding == "ulog" for topic in recording.topics):
        raise NotConvertible(recording.name, "it is a ULog, whose messages neither MCAPs nor bags can hold")
    reasons = tuple(_reasons(recording, options))
    estimated_bytes = _estimate(recording, options) if reasons else recording.size_bytes
    return ConversionPlan(reasons, recording.size_bytes, estimated_bytes)


def is_as_wanted(recording: Recording, options: ConversionOptions) -> bool:
    """Return whether a conversion would change nothing. Reads all of the recording, unless the index says no.

    Raises:
        SourceError: the bytes cannot be read.
    """
    has_reasons = any(True for _ in _reasons(recording, options))
    return not has_reasons and is_whole(recording, _format_of(options), options.compression.value)


def convert_recording(
    recording: Recording,
    path: Path,
    options: ConversionOptions,
    topics: Topics | None = None,
    *,
    sha256: Mapping[str, str] | None = None,
    on_progress: OnProgress | None = None,
) -> ConversionResult:
    """Write a recording as one MCAP or bag. Errors are those of `Recording.to_mcap` and `Recording.to_bag`.

    Raises:
        NotConvertible: nothing of the recording can be read.
        CannotWrite: the file cannot be written.
    """
    result: ConversionResult
    if isinstance(options, McapOptions):
        result = recording.to_mcap(path, topics, options=options, sha256=sha256, on_progress=on_progress)
    else:
        result = recording.to_bag(path, topics, options=options, on_progress=on_progress)
    if result.losses and not result.message_count:
        path.unlink()
        raise NotConvertible(PurePosixPath(recording.name).name, "nothing of it can be read")
    return result


def target_names(names: Sequence[str]) -> Iterator[str]:
    """Yield a relative path without extension for each recording.

    Where one is taken, the extension of the recording follows behind a hyphen, and a number if need be.
    """
    taken: set[str] = set()
    for name in names:
        target = stem = without_extensions(name) if name != "." else "recording"
        if target in taken:
            target = stem = f"{stem}-{name.removeprefix(stem).strip('.').replace('.', '-')}"
        number = 1
        while target in taken:
            number += 1
            target = f"{stem}-{number}"
        taken.add(target)
        yield target


def without_extensions(name: str) -> str:
    """Return the name of a recording without the extensions of formats and compression."""
    path = PurePosixPath(name)
    while path.suffix.lower() in _EXTENSIONS and path.stem:
        path = path.with_suffix("")
    return str(path)


def _format_of(options: ConversionOptions) -> RecordingFormat:
    return RecordingFormat.mcap if isinstance(options, McapOptions) else RecordingFormat.rosbag1


def _reasons(recording: Recording, options: ConversionOptions) -> Iterator[str]:
    """Yield what a conversion changes, by the index of the recording."""
    summary, target = recording.summarise(), _format_of(options)
    if summary.format is not target:
        yield f"{summary.format.value} becomes {_NAMES[target]}"
    if len(recording.files) > 1:
        yield f"{counted(len(recording.files), 'file')} become one"
    encodings = {topic.message_encoding for topic in recording.topics}
    if isinstance(options, BagOptions):
        if "cdr" in encodings:
            yield "ROS 2 messages become ROS 1 messages"
    elif options.ros1 is Ros1Messages.reencode and "ros1" in encodings:
        yield "ROS 1 messages become ROS 2 messages"
    yield from _repairs(recording, summary)
    yield from _recompressions(summary, options, is_same_format=summary.format is target)


def _repairs(recording: Recording, summary: RecordingSummary) -> Iterator[str]:
    if summary.content is not Content.indexed:
        yield f"it is repaired: {summary.reason or 'it is damaged'}"
    elif any(problem.code in _INDEX_PROBLEMS for problem in summary.problems):
        yield "it gets a new index, because its own is damaged"
    elif any(member.summary is not None for member in recording.members):
        yield "it gets an index"  # without one, it was read from end to end to be opened


def _recompressions(summary: RecordingSummary, options: ConversionOptions, *, is_same_format: bool) -> Iterator[str]:
    others = sorted(set(summary.compression) - {options.compression.value})
    if is_same_format and others:
        yield f"compression changes from {' and '.join(others)} to {options.compression.value}"
    elif is_same_format and isinstance(options, McapOptions) and options.level is not None:
        yield f"it is compressed with level {options.level}"


def _estimate(recording: Recording, options: ConversionOptions) -> int:
    """Return about how many bytes the output will have, by up to 8 parts of the recording."""
    segments = recording.segments()
    if not segments:
        return 0
    sample = segments[:: -(-len(segments) // _SAMPLED_SEGMENTS)]
    compress = mcap_compressor(options) if isinstance(options, McapOptions) else bag_compressor(options)
    made = sum(_compressed_bytes(recording, segment, compress) for segment in sample)
    read = sum(segment.size_bytes for segment in sample)
    return round(made / max(1, read) * sum(segment.size_bytes for segment in segments))


def _compressed_bytes(recording: Recording, segment: Segment, compress: Callable[[bytes], bytes]) -> int:
    """Return what the messages of a part take, with their times, and their entries in the index."""
    messages = [message for block in recording.segment_messages(segment) for message in block]
    raw = b"".join(
        _TIMES.pack(message.log_time_ns % 2**64, message.publish_time_ns % 2**64) + message.data for message in messages
    )
    return len(compress(raw)) + _TIMES.size * len(messages)
