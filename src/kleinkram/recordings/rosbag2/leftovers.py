"""Files beside a database that SQLite needs to read all of it: the log and journal of a recorder that was killed.

A recording is never written to. What these files hold is applied, by SQLite, to a temporary copy.

Source: sqlite.org/fileformat2.html, sections 3 (the rollback journal) and 4 (the write-ahead log).
"""

from __future__ import annotations

import os
import sqlite3
import struct
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import BinaryIO

from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.forward import FileForward
from kleinkram.recordings.model import Problem, counted
from kleinkram.recordings.rosbag2.spool import TooLarge, temporary_database

WAL_SUFFIX, JOURNAL_SUFFIX = "-wal", "-journal"
LOG_SUFFIXES = (WAL_SUFFIX, JOURNAL_SUFFIX)
_WAL_HEADER = struct.Struct(">8I")
_FRAME_HEADER = struct.Struct(">6I")
_WAL_MAGICS = (0x377F0682, 0x377F0683)
_MOST_FRAMES = 4_000_000
# At the end of a journal that names another one. SQLite would delete that file, whichever it is.
_JOURNAL_MAGIC = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
_READ_ONLY_PRAGMAS = frozenset(("trusted_schema", "locking_mode", "journal_mode", "wal_checkpoint", "schema_version"))


def find_leftovers(path: Path, name: str | None = None) -> list[Problem]:
    """Name the log and the journal beside a database that hold something it does not; `name`: what it is called.

    Raises:
        SourceError: one of them cannot be read.
    """
    name = name or path.name
    wal, journal = (Path(f"{path}{suffix}") for suffix in LOG_SUFFIXES)
    problems: list[Problem] = []
    try:
        if wal.is_file() and (pages := _pages_not_merged(path, wal)):
            message = (
                f"{counted(pages, 'page')} of the recording {'is' if pages == 1 else 'are'} only in this log, because "
                "the recorder was killed; keep it beside the database, and merge it with: "
                f"sqlite3 {name} 'PRAGMA wal_checkpoint(TRUNCATE)'"
            )
            problems.append(Problem("wal-not-merged", f"{name}{WAL_SUFFIX}", message))
        if journal.is_file() and _is_hot(journal):
            message = (
                "the recorder was killed while it wrote, so the latest messages may be written only in part; keep it "
                f"beside the database, and roll back with: sqlite3 {name} 'PRAGMA schema_version'"
            )
            problems.append(Problem("journal-not-merged", f"{name}{JOURNAL_SUFFIX}", message))
    except OSError as error:
        raise SourceError(f"{error.filename or path}: cannot be read: {error.strerror}") from error
    return problems


def not_read(left: Sequence[Problem]) -> list[Problem]:
    """Say that what was found beside a database could not be applied to a copy."""
    return [Problem("log-not-read", left[0].where, "its content could not be read along")] if left else []


@contextmanager
def replayed_copy(path: Path) -> Iterator[Path | None]:
    """Give the path of a temporary copy of a database, to which its log and journal are applied.

    None where it cannot be made: too little space, or SQLite does not apply them.

    Raises:
        SourceError: one of the files cannot be read, or the copy cannot be written.
    """
    present = [suffix for suffix in LOG_SUFFIXES if Path(f"{path}{suffix}").is_file()]
    try:
        with FileForward(path) as database:
            logs = {suffix: FileForward(f"{path}{suffix}") for suffix in present}
            reads = {suffix: log.read for suffix, log in logs.items()}
            with temporary_database(database.read, reads) as copy:
                for log in logs.values():
                    log.close()
                yield copy if replay(copy) else None
    except TooLarge:
        yield None


def replay(copy: Path) -> bool:
    """Have SQLite apply the log and journal beside a database, which is a copy of ours; say whether it did."""
    journal = Path(f"{copy}{JOURNAL_SUFFIX}")
    if journal.is_file() and _names_other_journal(journal):
        return False
    try:
        with closing(sqlite3.connect(copy, isolation_level=None)) as database:
            database.set_authorizer(_allow_pragmas)
            database.execute("PRAGMA trusted_schema=OFF")
            database.execute("PRAGMA locking_mode=EXCLUSIVE")
            database.execute("PRAGMA journal_mode=DELETE").fetchall()
            database.execute("PRAGMA schema_version").fetchall()
    except sqlite3.Error:
        return False
    return True


def _allow_pragmas(action: int, first: str | None, *_: str | None) -> int:
    is_allowed = action == sqlite3.SQLITE_PRAGMA and first in _READ_ONLY_PRAGMAS
    return sqlite3.SQLITE_OK if is_allowed else sqlite3.SQLITE_DENY


def _names_other_journal(journal: Path) -> bool:
    with journal.open("rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - len(_JOURNAL_MAGIC)))
        return file.read() == _JOURNAL_MAGIC


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
