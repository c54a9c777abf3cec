"""Files beside a database that SQLite would need to read all of it: the log and journal of a recorder that was killed.

They are looked at, never applied: that would write to the recording.

Source: sqlite.org/fileformat2.html, section 4 (the write-ahead log).
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.model import Problem

_WAL_HEADER = struct.Struct(">8I")
_FRAME_HEADER = struct.Struct(">6I")
_WAL_MAGICS = (0x377F0682, 0x377F0683)
_MOST_FRAMES = 4_000_000


def find_leftovers(path: Path) -> list[Problem]:
    """Name the log and the journal beside a database that hold something it does not.

    Raises:
        SourceError: one of them cannot be read.
    """
    wal = path.with_name(f"{path.name}-wal")
    journal = path.with_name(f"{path.name}-journal")
    problems: list[Problem] = []
    try:
        if wal.is_file() and (pages := _pages_not_merged(path, wal)):
            message = (
                f"{pages} pages of messages are only in this log, because the recorder was killed; "
                f"keep it beside the database, and merge it with: sqlite3 {path.name} 'PRAGMA wal_checkpoint(TRUNCATE)'"
            )
            problems.append(Problem("wal-not-merged", wal.name, message))
        if journal.is_file() and _is_hot(journal):
            message = "the recorder was killed while it wrote: the latest messages may be written only in part"
            problems.append(Problem("journal-not-merged", journal.name, message))
    except OSError as error:
        raise SourceError(f"{error.filename or path}: cannot be read: {error.strerror}") from error
    return problems


def _is_hot(journal: Path) -> bool:
    with journal.open("rb") as file:
        return any(file.read(8))


def _pages_not_merged(path: Path, wal: Path) -> int:
    """Count the pages whose latest committed content in the log differs from that in the database."""
    with path.open("rb") as database, wal.open("rb") as log:
        head = log.read(_WAL_HEADER.size)
        if len(head) < _WAL_HEADER.size:
            return 0
        magic, _version, page_bytes, _sequence, *salts, _, _ = _WAL_HEADER.unpack(head)
        if magic not in _WAL_MAGICS or not 512 <= page_bytes <= 65536:
            return 0
        committed: dict[int, int] = {}
        open_frames: dict[int, int] = {}
        for _ in range(_MOST_FRAMES):
            at = log.tell()
            frame = log.read(_FRAME_HEADER.size)
            if len(frame) < _FRAME_HEADER.size:
                break
            number, pages_after_commit, *frame_salts, _, _ = _FRAME_HEADER.unpack(frame)
            if frame_salts != salts or number == 0:
                break
            open_frames[number] = at + _FRAME_HEADER.size
            if pages_after_commit:
                committed.update(open_frames)
                open_frames.clear()
            log.seek(page_bytes, 1)
        return sum(_differs(database, log, page_bytes, number, at) for number, at in committed.items())


def _differs(database: BinaryIO, log: BinaryIO, page_bytes: int, number: int, at: int) -> bool:
    log.seek(at)
    database.seek((number - 1) * page_bytes)
    logged = log.read(page_bytes)
    return len(logged) == page_bytes and logged != database.read(page_bytes)
