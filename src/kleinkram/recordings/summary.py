"""`summarise` and `scan`: any file -> what is in it. Whatever the bytes are, the answer is a summary, no exception."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from kleinkram.recordings.formats.base import (
    HEAD_BYTES,
    LONG_HEAD_BYTES,
    RECORDINGS,
    extension_lies,
    is_database,
    sniff,
    sniff_head,
    sniff_inside_zstd,
)
from kleinkram.recordings.formats.describe import DESCRIBED, MAX_DESCRIBED_BYTES, describe
from kleinkram.recordings.formats.mcap.format import scan_mcap, summarise_mcap
from kleinkram.recordings.formats.rosbag1.format import scan_bag, summarise_bag
from kleinkram.recordings.formats.rosbag2.db3 import scan_copy, scan_db3
from kleinkram.recordings.formats.svo2 import as_svo2
from kleinkram.recordings.formats.zstd_file import scan_zstd_file
from kleinkram.recordings.limits import MAX_SCAN_BYTES
from kleinkram.recordings.model import Content, Depth, RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import CountingSource, FileSource, Forward, Source, SourceForward, from_source, peek
from kleinkram.recordings.temporary_files import TooLarge, temporary_database
from kleinkram.recordings.topic_statistics import bounded, pending


def summarise(source: Source, *, most_bytes: int | None = MAX_SCAN_BYTES) -> RecordingSummary:
    """Say what is in a file, by ranges: for an indexed MCAP or bag about its index bytes.

    A file without the index that this needs is scanned, if it has at most `most_bytes` (None: of whatever size);
    else it stays `pending`, and `reason` says what a scan would cost. Otherwise `content` is `indexed` for a whole
    recording, `recovered` or `broken` where the file itself is at fault, with the place in `reason`, and `opaque` for
    anything that is not a recording.

    Raises:
        SourceError: the bytes cannot be read.
    """
    counting = CountingSource(source)
    kind = sniff(counting)
    most = source.size_bytes if most_bytes is None else most_bytes
    if kind is RecordingFormat.mcap:
        summary = summarise_mcap(counting, most_bytes=most)
    elif kind is RecordingFormat.svo2:
        summary = as_svo2(summarise_mcap(counting, most_bytes=most))
    elif kind is RecordingFormat.rosbag1:
        summary = summarise_bag(counting, most_bytes=most)
    elif kind in _WITHOUT_INDEX:
        summary = _without_index(source, counting, kind, most)
    else:
        summary = describe(kind, from_source(counting), most_bytes=min(most, MAX_DESCRIBED_BYTES))
    return replace(_named(summary, source.name, kind), bytes_read=max(counting.bytes_read, summary.bytes_read))


def scan(forward: Forward) -> RecordingSummary:
    """Say what is in a file by reading all of it, once: every chunk is decompressed, every checksum checked, and of a
    damaged file everything readable is counted and the loss measured. Memory does not follow the file's size.

    Raises:
        SourceError: the bytes cannot be read.
    """
    head, forward = peek(forward, LONG_HEAD_BYTES)
    kind = sniff_head(head, path=forward.path) if head else RecordingFormat.empty
    summary = _SCANS[kind](forward) if kind in _SCANS else describe(kind, forward, most_bytes=None)
    summary = replace(_named(summary, forward.name, kind), depth=Depth.scan)
    is_read = kind in _SCANS or kind in DESCRIBED
    return replace(summary, bytes_read=max(summary.bytes_read, forward.size_bytes if is_read else len(head)))


def scan_with_logs(source: Source, logs: Mapping[str, Source]) -> RecordingSummary:
    """Scan a database of rosbag2 with its log and journal, by their suffixes, through temporary copies.

    Anything else is scanned without them.

    Raises:
        SourceError: the bytes cannot be read, or the copies cannot be written.
    """
    if not is_database(source.read(0, min(HEAD_BYTES, source.size_bytes))):
        return scan(from_source(source))
    reads = {suffix: from_source(log).read for suffix, log in logs.items()}
    try:
        with temporary_database(from_source(source).read, reads) as copy:
            summary = scan_copy(copy, source.name, lambda: scan_db3(SourceForward(source)))
    except TooLarge as error:
        return RecordingSummary(RecordingFormat.rosbag2_db3, Content.pending, str(error))
    return replace(summary, bytes_read=source.size_bytes + sum(log.size_bytes for log in logs.values()))


def _without_index(source: Source, counting: Source, kind: RecordingFormat, most_bytes: int) -> RecordingSummary:
    if source.size_bytes > most_bytes:
        if kind is RecordingFormat.zstd and (inside := sniff_inside_zstd(counting)) not in RECORDINGS:
            return RecordingSummary(kind, Content.opaque, f"compressed as a whole; inside is {inside.value}")
        return pending(kind, source.size_bytes, _WITHOUT_INDEX[kind])
    # A database that is a local file is read in place.
    forward = from_source(source if isinstance(source, FileSource) else counting)
    return scan_db3(forward, depth=Depth.summary) if kind is RecordingFormat.rosbag2_db3 else _unpack(forward)


def _unpack(forward: Forward) -> RecordingSummary:
    return scan_zstd_file(forward, scan)


def _scan_svo2(forward: Forward) -> RecordingSummary:
    return as_svo2(scan_mcap(forward))


def _named(summary: RecordingSummary, name: str, kind: RecordingFormat) -> RecordingSummary:
    """Add whether the file's name tells the truth."""
    lie = extension_lies(name, kind)
    return replace(summary, problems=bounded([lie, *summary.problems])) if lie else summary


_WITHOUT_INDEX = {
    RecordingFormat.rosbag2_db3: "a rosbag2 database (db3) has no index of its messages",
    RecordingFormat.zstd: "it is compressed as a whole",
}
_SCANS: dict[RecordingFormat, Callable[[Forward], RecordingSummary]] = {
    RecordingFormat.mcap: scan_mcap,
    RecordingFormat.svo2: _scan_svo2,
    RecordingFormat.rosbag1: scan_bag,
    RecordingFormat.rosbag2_db3: scan_db3,
    RecordingFormat.zstd: _unpack,
}
