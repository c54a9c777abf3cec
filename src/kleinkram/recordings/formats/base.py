"""What a file is, by a look at its content: never by its name.

Reads at most 64 KB at the start of the file and decompresses at most 64 KB; only recognises, never judges.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

import zstandard

from kleinkram.recordings.formats.mcap import records as mcap_records
from kleinkram.recordings.formats.rosbag1 import records as bag_records
from kleinkram.recordings.formats.svo2 import LIBRARY_WORD
from kleinkram.recordings.limits import MAX_ZSTD_WINDOW
from kleinkram.recordings.model import Problem, RecordingFormat
from kleinkram.recordings.sources import Source

HEAD_BYTES = 4096
LONG_HEAD_BYTES = 65536
RECORDINGS = frozenset(
    (RecordingFormat.mcap, RecordingFormat.svo2, RecordingFormat.rosbag1, RecordingFormat.rosbag2_db3)
)
"""Formats whose messages are read."""

_MCAP_HEADER_BYTES = 64
_SQLITE_MAGIC = b"SQLite format 3\0"
_MAGICS = (
    (mcap_records.MAGIC, RecordingFormat.mcap),
    (bag_records.MAGIC, RecordingFormat.rosbag1),
    (b"#ROSBAG V1", RecordingFormat.rosbag1_old),
    (b"#ROSRECORD V1", RecordingFormat.rosbag1_old),
    (b"ULog\x01\x12\x35", RecordingFormat.ulog),
    (b"\x28\xb5\x2f\xfd", RecordingFormat.zstd),
)
_BINARY = frozenset(
    (
        RecordingFormat.mcap,
        RecordingFormat.svo2,
        RecordingFormat.rosbag1,
        RecordingFormat.rosbag1_old,
        RecordingFormat.rosbag2_db3,
        RecordingFormat.zstd,
        RecordingFormat.ulog,
    )
)
_TEXT_EXTENSIONS = frozenset((".yaml", ".yml", ".csv", ".tum", ".txt", ".json"))
_CLAIMS = {
    ".mcap": {RecordingFormat.mcap, RecordingFormat.svo2},
    ".bag": {RecordingFormat.rosbag1, RecordingFormat.rosbag1_old},
    ".db3": {RecordingFormat.rosbag2_db3},
    ".zstd": {RecordingFormat.zstd},
    ".zst": {RecordingFormat.zstd},
    ".ulg": {RecordingFormat.ulog},
    ".svo2": {RecordingFormat.svo2, RecordingFormat.mcap},
}
_ROSBAG2_TABLES = (re.compile(rb"TABLE\s+[\"'`\[]?messages\b", re.I), re.compile(rb"TABLE\s+[\"'`\[]?topics\b", re.I))
_YAML_KEY = re.compile(r"""(- |)["']?[\w./ -]+["']?\s*:(\s|$)|---(\s|$)|%YAML""")
_JSON = re.compile(r"""\s*(\{\s*("|\})|\[\s*(["\[{\]\d-]|true|false|null))""")
_TUM_COLUMNS, _KITTI_COLUMNS = 8, 12


def sniff(source: Source) -> RecordingFormat:
    """Say what a file is by its content.

    Raises:
        SourceError: as `Source.read`.
    """
    if source.size_bytes == 0:
        return RecordingFormat.empty
    head = source.read(0, min(HEAD_BYTES, source.size_bytes))
    if head.startswith(_SQLITE_MAGIC):
        head = source.read(0, min(LONG_HEAD_BYTES, source.size_bytes))
    return sniff_head(head, path=getattr(source, "path", None))


def sniff_head(head: bytes, *, path: Path | None = None) -> RecordingFormat:
    """Say what a file is by its first bytes: up to `LONG_HEAD_BYTES` of a database, `HEAD_BYTES` of all else.

    `path`: where it is on this machine, so that the log beside a database can be found; None where it is nowhere.
    """
    if head.startswith(mcap_records.MAGIC) and LIBRARY_WORD in head[len(mcap_records.MAGIC) :][:_MCAP_HEADER_BYTES]:
        return RecordingFormat.svo2
    for magic, kind in _MAGICS:
        if head.startswith(magic):
            return kind
    if head.startswith(_SQLITE_MAGIC):
        # The schema of a database stands in its first page, as the text of the statements that made it.
        is_rosbag2 = all(table.search(head) for table in _ROSBAG2_TABLES) or is_database_in_log(head, path)
        return RecordingFormat.rosbag2_db3 if is_rosbag2 else RecordingFormat.unknown
    return _sniff_text(head[:HEAD_BYTES])


def is_database(head: bytes) -> bool:
    """Say by its first bytes whether a file is an SQLite database, of whatever content."""
    return head.startswith(_SQLITE_MAGIC)


def is_database_in_log(head: bytes, path: Path | None) -> bool:
    """Say whether a file is a database whose tables may all be in the log beside it: its recorder was killed early.

    `head`: its first bytes, in which there are no tables. `path`: where it is on this machine, None where nowhere.
    """
    if path is None or not head.startswith(_SQLITE_MAGIC) or path.suffix.lower() != ".db3":
        return False
    return any(Path(f"{path}{suffix}").is_file() for suffix in ("-wal", "-journal"))


def sniff_inside_zstd(source: Source) -> RecordingFormat:
    """Say what is in a file that is compressed as a whole; unknown if its beginning cannot be decompressed."""
    compressed = source.read(0, min(LONG_HEAD_BYTES, source.size_bytes))
    decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_ZSTD_WINDOW)
    try:
        with decompressor.stream_reader(compressed) as reader:
            return sniff_head(reader.read(LONG_HEAD_BYTES))
    except zstandard.ZstdError:
        return RecordingFormat.unknown


def extension_lies(name: str, kind: RecordingFormat) -> Problem | None:
    """Return a problem if the extension of the name promises another content than there is."""
    extension = PurePosixPath(name).suffix.lower()
    claims = _CLAIMS.get(extension)
    honest = kind in claims if claims else not (extension in _TEXT_EXTENSIONS and kind in _BINARY)
    if honest or kind is RecordingFormat.empty:
        return None
    what = "of no kind that we know" if kind is RecordingFormat.unknown else f"that of {kind.value}"
    return Problem("extension-lies", name, f"it is named '{extension}', but its content is {what}")


def _sniff_text(head: bytes) -> RecordingFormat:
    if b"\0" in head:
        return RecordingFormat.unknown
    text = head.decode("utf-8", "ignore")
    if len(text.encode()) < len(head) - 3:
        return RecordingFormat.unknown
    if _JSON.match(text):
        return RecordingFormat.json
    whole_lines = text.splitlines()[: -1 if len(head) == HEAD_BYTES else None]
    lines = [line.strip() for line in whole_lines if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        return RecordingFormat.unknown
    if any(line.startswith("rosbag2_bagfile_information:") for line in lines):
        return RecordingFormat.rosbag2_metadata
    if _are_numbers(lines, _TUM_COLUMNS):
        return RecordingFormat.tum
    if _are_numbers(lines, _KITTI_COLUMNS):
        return RecordingFormat.kitti
    if len(lines) > 1 and "," in lines[0] and len({line.count(",") for line in lines}) == 1:
        return RecordingFormat.csv
    if _YAML_KEY.match(lines[0]):
        return RecordingFormat.yaml
    return RecordingFormat.unknown


def _are_numbers(lines: list[str], columns: int) -> bool:
    for line in lines:
        cells = line.split()
        if len(cells) != columns:
            return False
        try:
            [float(cell) for cell in cells]
        except ValueError:
            return False
    return True
