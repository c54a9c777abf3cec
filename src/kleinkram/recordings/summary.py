"""Recognises the format of a file by its content, never by its name, and summarises it: `summarise` and `scan`.

Recognising reads at most 64 KB at the start of a file. A new format is one line in `FORMATS`. The content of a file
never raises an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

from kleinkram.recordings.file_summary import bounded
from kleinkram.recordings.formats.base import HEAD_BYTES, LONG_HEAD_BYTES, Format, Head
from kleinkram.recordings.formats.mcap.format import MCAP, SVO2
from kleinkram.recordings.formats.rosbag1.format import ROSBAG1, ROSBAG1_OLD
from kleinkram.recordings.formats.rosbag2.database import is_database
from kleinkram.recordings.formats.rosbag2.db3 import ROSBAG2_DB3, scan_copy, scan_db3
from kleinkram.recordings.formats.text_files import CSV, JSON, KITTI, ROSBAG2_METADATA, TUM, UNKNOWN, YAML
from kleinkram.recordings.formats.ulog import ULOG
from kleinkram.recordings.formats.zstd_file import ZSTD
from kleinkram.recordings.limits import MAX_DESCRIBED_BYTES, MAX_SCAN_BYTES
from kleinkram.recordings.model import Content, Depth, Problem, RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import CountingSource, SequentialReader, Source, SourceReader, peek
from kleinkram.recordings.temporary_files import TooLarge, temporary_database

_TEXT_EXTENSIONS = frozenset((".yaml", ".yml", ".csv", ".tum", ".txt", ".json"))


EMPTY = Format(
    RecordingFormat.empty,
    lambda head: not head.data,
    "empty",
    scan=lambda _: RecordingSummary(RecordingFormat.empty, Content.broken, "the file has 0 bytes"),
    refusal="it has 0 bytes",
)
FORMATS = (
    EMPTY,
    SVO2,
    MCAP,
    ROSBAG1,
    ROSBAG1_OLD,
    ROSBAG2_DB3,
    ULOG,
    ZSTD,
    JSON,
    ROSBAG2_METADATA,
    TUM,
    KITTI,
    CSV,
    YAML,
    UNKNOWN,
)


def format_of(source: Source) -> Format:
    """Return the format of a file."""
    head = source.read(0, min(HEAD_BYTES, source.size_bytes))
    if is_database(head):
        head = source.read(0, min(LONG_HEAD_BYTES, source.size_bytes))
    return format_of_head(head, path=getattr(source, "path", None))


def format_of_head(data: bytes, *, path: Path | None = None) -> Format:
    """Return a format by the first bytes of a file: up to `LONG_HEAD_BYTES` of a database, `HEAD_BYTES` of all else.

    `path`: of a local file, so that the log beside a database can be found.
    """
    head = Head(data, path)
    return next(one for one in FORMATS if one.matches(head))


def misleading_extension(name: str, file_format: Format) -> Problem | None:
    """Return a problem if the extension promises another format than the content has."""
    extension = PurePosixPath(name).suffix.lower()
    promised = [one for one in FORMATS if extension in one.extensions]
    is_right = file_format in promised if promised else file_format.is_text or extension not in _TEXT_EXTENSIONS
    if is_right or file_format is EMPTY:
        return None
    what = "of an unknown format" if file_format is UNKNOWN else f"that of {file_format.kind.value}"
    return Problem("extension-lies", name, f"it is named '{extension}', but its content is {what}")


def summarise(source: Source, *, max_bytes: int | None = MAX_SCAN_BYTES) -> RecordingSummary:
    """Return what is in a file, by reading ranges: for an indexed MCAP or bag about its index bytes.

    A file without the index that this needs is scanned, if it has at most `max_bytes` (None: of whatever size);
    else it stays `pending`, and `reason` says what a scan would cost. Otherwise `content` is `indexed` for a whole
    recording, `recovered` or `broken` where the file is at fault, with the position in `reason`, and `opaque` for
    anything that is not a recording.

    Raises:
        SourceError: the bytes cannot be read.
    """
    counting = CountingSource(source)
    file_format = format_of(counting)
    limit = source.size_bytes if max_bytes is None else max_bytes
    if file_format.summarise is not None:
        summary = file_format.summarise(counting, limit)
    elif file_format.scan is None:
        summary = RecordingSummary(file_format.kind, Content.opaque, file_format.description)
    elif source.size_bytes <= min(limit, MAX_DESCRIBED_BYTES):
        summary = file_format.scan(SourceReader(counting))
    else:
        cost = f"it must be read whole ({source.size_bytes} bytes) to say more"
        summary = RecordingSummary(file_format.kind, Content.opaque, f"{file_format.description}; {cost}")
    bytes_read = summary.bytes_read or counting.bytes_read
    return replace(_with_extension_problem(summary, source.name, file_format), bytes_read=bytes_read)


def scan(reader: SequentialReader) -> RecordingSummary:
    """Return what is in a file by reading all of it, once: every chunk is decompressed, every checksum checked, and of
    a damaged file everything readable is counted and the loss measured. Memory does not follow the file's size.

    Raises:
        SourceError: the bytes cannot be read.
    """
    head, reader = peek(reader, LONG_HEAD_BYTES)
    file_format = format_of_head(head, path=reader.path)
    if file_format.scan is None:
        summary, bytes_read = RecordingSummary(file_format.kind, Content.opaque, file_format.description), len(head)
    else:
        summary, bytes_read = file_format.scan(reader), reader.size_bytes
    summary = replace(_with_extension_problem(summary, reader.name, file_format), depth=Depth.scan)
    return replace(summary, bytes_read=max(summary.bytes_read, bytes_read))


def scan_with_logs(source: Source, logs: Mapping[str, Source]) -> RecordingSummary:
    """Scan a rosbag2 database with its log and journal, by suffix, through temporary copies; other files without."""
    if not is_database(source.read(0, min(HEAD_BYTES, source.size_bytes))):
        return scan(SourceReader(source))
    reads = {suffix: SourceReader(log).read for suffix, log in logs.items()}
    try:
        with temporary_database(SourceReader(source).read, reads) as copy:
            without_logs = SourceReader(source)
            without_logs.path = None  # in place, it would be read with the logs beside it
            summary = scan_copy(copy, source.name, lambda: scan_db3(without_logs))
    except TooLarge as error:
        return RecordingSummary(RecordingFormat.rosbag2_db3, Content.pending, str(error))
    return replace(summary, bytes_read=source.size_bytes + sum(log.size_bytes for log in logs.values()))


def _with_extension_problem(summary: RecordingSummary, name: str, file_format: Format) -> RecordingSummary:
    problem = misleading_extension(name, file_format)
    return replace(summary, problems=bounded([problem, *summary.problems])) if problem else summary
