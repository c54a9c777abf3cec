"""The registry of formats. A file is recognised by its content, never by its name.

Recognising reads at most 64 KB at the start of a file. A new format is one line in `FORMATS`.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from kleinkram.recordings.formats.base import HEAD_BYTES, LONG_HEAD_BYTES, Format, Head
from kleinkram.recordings.formats.mcap.format import MCAP, SVO2
from kleinkram.recordings.formats.rosbag1.format import ROSBAG1, ROSBAG1_OLD
from kleinkram.recordings.formats.rosbag2.database import is_database
from kleinkram.recordings.formats.rosbag2.db3 import ROSBAG2_DB3
from kleinkram.recordings.formats.text_files import CSV, JSON, KITTI, ROSBAG2_METADATA, TUM, UNKNOWN, YAML
from kleinkram.recordings.formats.ulog import ULOG
from kleinkram.recordings.formats.zstd_file import ZSTD
from kleinkram.recordings.model import Content, Problem, RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import Source

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

    `path`: where it is on this machine, so that the log beside a database can be found; None where it is nowhere.
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
