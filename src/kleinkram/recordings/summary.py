"""`summarise` and `scan`: any file -> what is in it. Whatever the bytes are, the answer is a summary, no exception."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from kleinkram.recordings.formats.base import HEAD_BYTES, LONG_HEAD_BYTES, Format
from kleinkram.recordings.formats.registry import format_of, format_of_head, misleading_extension
from kleinkram.recordings.formats.rosbag2.database import is_database
from kleinkram.recordings.formats.rosbag2.db3 import scan_copy, scan_db3
from kleinkram.recordings.limits import MAX_DESCRIBED_BYTES, MAX_SCAN_BYTES
from kleinkram.recordings.model import Content, Depth, RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import CountingSource, Forward, Source, SourceForward, from_source, peek
from kleinkram.recordings.temporary_files import TooLarge, temporary_database
from kleinkram.recordings.topic_statistics import bounded


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
    found = format_of(counting)
    most = source.size_bytes if most_bytes is None else most_bytes
    if found.summarise is not None:
        summary = found.summarise(counting, most_bytes=most)
    elif found.scan is None:
        summary = RecordingSummary(found.kind, Content.opaque, found.description)
    elif source.size_bytes <= min(most, MAX_DESCRIBED_BYTES):
        summary = found.scan(from_source(counting))
    else:
        cost = f"it must be read whole ({source.size_bytes} bytes) to say more"
        summary = RecordingSummary(found.kind, Content.opaque, f"{found.description}; {cost}")
    bytes_read = max(counting.bytes_read, summary.bytes_read)
    return replace(_with_extension_problem(summary, source.name, found), bytes_read=bytes_read)


def scan(forward: Forward) -> RecordingSummary:
    """Say what is in a file by reading all of it, once: every chunk is decompressed, every checksum checked, and of a
    damaged file everything readable is counted and the loss measured. Memory does not follow the file's size.

    Raises:
        SourceError: the bytes cannot be read.
    """
    head, forward = peek(forward, LONG_HEAD_BYTES)
    found = format_of_head(head, path=forward.path)
    if found.scan is None:
        summary, bytes_read = RecordingSummary(found.kind, Content.opaque, found.description), len(head)
    else:
        summary, bytes_read = found.scan(forward), forward.size_bytes
    summary = replace(_with_extension_problem(summary, forward.name, found), depth=Depth.scan)
    return replace(summary, bytes_read=max(summary.bytes_read, bytes_read))


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


def _with_extension_problem(summary: RecordingSummary, name: str, found: Format) -> RecordingSummary:
    problem = misleading_extension(name, found)
    return replace(summary, problems=bounded([problem, *summary.problems])) if problem else summary
