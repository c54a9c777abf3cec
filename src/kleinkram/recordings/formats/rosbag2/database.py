"""Opens untrusted rosbag2 databases: read-only, without running anything in them; applies their logs to copies.

No view, trigger, virtual table or function of the database runs (an authorizer lets only plain reads pass), and no
query runs longer than the file's size can explain. SQLite takes a few MB.

Source: rosbag2_storage_sqlite3, schema versions: topics(id, name, type), + serialization_format (Dashing),
+ offered_qos_profiles (Foxy), + tables schema and metadata (Humble, 3), + type_description_hash and
message_definitions (Iron and later, 4). Security: sqlite.org/security.html.
"""

from __future__ import annotations

import os
import re
import sqlite3
import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from itertools import count
from pathlib import Path
from typing import NamedTuple

from kleinkram.recordings.errors import Malformed, SourceError
from kleinkram.recordings.limits import MAX_NAME, MAX_NAMES, MAX_TOPICS
from kleinkram.recordings.messages import Properties
from kleinkram.recordings.model import Problem, counted
from kleinkram.recordings.sources import FileSource, SourceReader
from kleinkram.recordings.temporary_files import TooLarge, temporary_database

CACHE_KIB = 16 * 1024
MAX_VALUE_BYTES = 16 * 2**20
"""Bytes of one value that SQLite may hold; messages are measured and not held, so theirs may be larger."""

_STEPS_A_TICK = 100_000
_FREE_STEPS = 20_000_000
_STEPS_A_BYTE = 8  # a row takes at least 8 bytes of the file, and about 20 steps
_FUNCTIONS = frozenset(("count", "length", "substr"))
_PRAGMAS = frozenset(("table_info", "quick_check"))
_PREPARE = (
    "PRAGMA trusted_schema=OFF",
    "PRAGMA cell_size_check=ON",
    "PRAGMA query_only=ON",
    "PRAGMA ignore_check_constraints=ON",
    "PRAGMA mmap_size=0",
    f"PRAGMA cache_size=-{CACHE_KIB}",
)
_TEXT_COLUMNS = ("name", "type", "serialization_format")
_PROPERTY_COLUMNS = {"offered_qos_profiles": "offered_qos_profiles", "type_description_hash": "topic_type_hash"}
_MAX_PROPERTY = 64 * 2**10
_MAX_FAULTS = 10
_MAX_METADATA = 4 * 2**20


class TopicRow(NamedTuple):
    """A row of the table `topics`; `serialization_format` is empty in the oldest databases.

    `properties`: QoS profiles and type hash, by the names that rosbag2 gives them in an MCAP.
    """

    topic_id: int
    name: str
    message_type: str
    serialization_format: str
    properties: Properties = ()


class Origin(NamedTuple):
    """The distribution, schema version, number of types and message compression that a database states, if any."""

    ros_distro: str = ""
    schema_version: int | None = None
    definitions: int = 0
    message_compression: str = ""


class MessageRow(NamedTuple):
    """A message: topic, integer nanoseconds, and the size of its data."""

    topic_id: int
    timestamp: int
    data_bytes: int


@contextmanager
def open_database(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a database for reading. Damage raises `sqlite3.Error` here or at any later query."""
    if not os.access(path, os.R_OK):
        raise SourceError(f"{path}: cannot be opened for reading")
    try:
        with _connect(path) as database:
            yield database
    except MemoryError:
        # SQLite reports this for some damaged schemas too. Allocating as much raises again if memory is short.
        bytearray(MAX_VALUE_BYTES + CACHE_KIB * 1024)
        raise sqlite3.DatabaseError("its schema is damaged") from None
    except UnicodeDecodeError:
        # SQLite quotes a damaged name in its message, which Python cannot read then.
        raise sqlite3.DatabaseError("its schema is damaged") from None


@contextmanager
def _connect(path: Path) -> Iterator[sqlite3.Connection]:
    uri = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
    with closing(sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False)) as database:
        if sys.version_info >= (3, 11):
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE_BYTES)
            database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
        # The steps of queries are bounded by the rows that the file has room for.
        ticks = count((_FREE_STEPS + _STEPS_A_BYTE * path.stat().st_size) // _STEPS_A_TICK, -1)
        database.set_progress_handler(lambda: next(ticks) <= 0, _STEPS_A_TICK)
        for statement in _PREPARE:
            database.execute(statement)
        database.text_factory = lambda text: text.decode("utf-8", "replace")
        database.set_authorizer(_authorize)
        yield database


def _authorize(action: int, first: str | None, second: str | None, _database: str | None, _trigger: str | None) -> int:
    allowed = (
        action in (sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ)
        or (action == sqlite3.SQLITE_PRAGMA and first in _PRAGMAS)
        or (action == sqlite3.SQLITE_FUNCTION and second in _FUNCTIONS)
    )
    return sqlite3.SQLITE_OK if allowed else sqlite3.SQLITE_DENY


def check_tables(database: sqlite3.Connection) -> None:
    """Check that `topics` and `messages` are tables with the columns of every version."""
    rows = database.execute(
        "SELECT name, type, rootpage FROM sqlite_master WHERE name IN ('topics', 'messages') AND type != 'index'"
    ).fetchall()
    kinds = {name: "virtual table" if kind == "table" and not root else kind for name, kind, root in rows}
    for table, needed in (("topics", {"name", "type"}), ("messages", {"topic_id", "timestamp", "data"})):
        if kinds.get(table) != "table":
            what = f"is a {kinds[table]}" if table in kinds else "is missing"
            raise Malformed(f"table {table}", f"it {what}, so this is no rosbag2 recording")
        if missing := needed - columns(database, table):
            raise Malformed(f"table {table}", f"it has no column {', '.join(sorted(missing))}")


def columns(database: sqlite3.Connection, table: str) -> set[str]:
    """Return the names of a table's stored columns, without generated ones."""
    return {row[1] for row in database.execute(f"PRAGMA table_info({table})")}


def read_topics(database: sqlite3.Connection) -> list[TopicRow]:
    """Return the topics, in the order of their ids."""
    present = columns(database, "topics")
    bounds = {**dict.fromkeys(_TEXT_COLUMNS, MAX_NAME), **dict.fromkeys(_PROPERTY_COLUMNS, _MAX_PROPERTY + 1)}
    columns_sql = ", ".join(f"substr({name}, 1, {most})" if name in present else "''" for name, most in bounds.items())
    topics: list[TopicRow] = []
    names_bytes = properties_bytes = 0
    for topic_id, *values in database.execute(f"SELECT rowid, {columns_sql} FROM topics ORDER BY rowid"):  # noqa: S608  # names of ours
        name, kind, encoding, *properties = (value if isinstance(value, str) else "" for value in values)
        names_bytes += len(name) + len(kind) + len(encoding)
        properties_bytes += sum(map(len, properties))
        if len(topics) >= MAX_TOPICS or names_bytes > MAX_NAMES:
            raise Malformed("table topics", f"more than {MAX_TOPICS} topics, or very long names", certain=False)
        is_within = properties_bytes <= MAX_NAMES
        topics.append(TopicRow(topic_id, name, kind, encoding, read_properties(properties) if is_within else ()))
    return topics


def read_properties(values: Sequence[str]) -> Properties:
    """Return the properties of a topic by its last columns, without empty and very long ones."""
    named = zip(_PROPERTY_COLUMNS.values(), values, strict=False)
    return tuple((name, value) for name, value in named if 0 < len(value) <= _MAX_PROPERTY)


def read_origin(database: sqlite3.Connection) -> Origin:
    """Read the tables `schema`, `metadata` and `message_definitions`, which older databases lack."""
    distro: object = ""
    version: object = None
    definitions, metadata = 0, ""
    if {"schema_version", "ros_distro"} <= columns(database, "schema"):
        row = database.execute(f"SELECT schema_version, substr(ros_distro, 1, {MAX_NAME}) FROM schema").fetchone()  # noqa: S608  # ours
        version, distro = row or (None, "")
    if "metadata" in columns(database, "metadata"):
        latest = f"SELECT substr(metadata, 1, {_MAX_METADATA}) FROM metadata ORDER BY rowid DESC LIMIT 1"  # noqa: S608  # ours
        row = database.execute(latest).fetchone()
        metadata = row[0] if row and isinstance(row[0], str) else ""
    if columns(database, "message_definitions"):
        definitions = database.execute("SELECT count(*) FROM message_definitions").fetchone()[0]
    is_message = _metadata_value(metadata, "compression_mode") == "message"
    return Origin(
        distro if isinstance(distro, str) else "",
        version if isinstance(version, int) else None,
        definitions,
        _metadata_value(metadata, "compression_format") or "zstd" if is_message else "",
    )


def _metadata_value(text: str, key: str) -> str:
    """Return a top-level value of the metadata text: YAML, one key a line."""
    match = re.search(rf"^{key}:[ ]*[\"']?(\w*)", text, re.MULTILINE)
    return match[1].lower() if match else ""


def find_faults(database: sqlite3.Connection) -> list[str]:
    """Check the structure of every page; return the faults in SQLite's words."""
    rows = database.execute(f"PRAGMA quick_check({_MAX_FAULTS})").fetchall()
    return [str(row[0]) for row in rows if row[0] != "ok"]


def message_cursor(database: sqlite3.Connection) -> sqlite3.Cursor:
    """Return topic id, timestamp and data size of all messages, in file order; the pages of large data are not read."""
    return database.execute("SELECT topic_id, timestamp, length(data) FROM messages NOT INDEXED")


WAL_SUFFIX, JOURNAL_SUFFIX = "-wal", "-journal"
LOG_SUFFIXES = (WAL_SUFFIX, JOURNAL_SUFFIX)
_WAL_HEADER = struct.Struct(">8I")
_FRAME_HEADER = struct.Struct(">6I")
_WAL_MAGICS = (0x377F0682, 0x377F0683)
_MAX_FRAMES = 4_000_000
# At the end of a journal that names another one. SQLite would delete that file, whichever it is.
_JOURNAL_MAGIC = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
_READ_ONLY_PRAGMAS = frozenset(("trusted_schema", "locking_mode", "journal_mode", "wal_checkpoint", "schema_version"))


def find_unmerged_logs(path: Path, name: str | None = None) -> list[Problem]:
    """Report the log and the journal beside a database that hold unmerged pages."""
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
        if journal.is_file() and _begins_with_content(journal):
            message = (
                "the recorder was killed while it wrote, so the latest messages may be written only in part; keep it "
                f"beside the database, and roll back with: sqlite3 {name} 'PRAGMA schema_version'"
            )
            problems.append(Problem("journal-not-merged", f"{name}{JOURNAL_SUFFIX}", message))
    except OSError as error:
        raise SourceError(f"{error.filename or path}: cannot be read: {error.strerror}") from error
    return problems


def log_not_read(log_problems: Sequence[Problem]) -> list[Problem]:
    """Report that a log or journal could not be applied to a copy."""
    return (
        [Problem("log-not-read", log_problems[0].where, "its content could not be read along")] if log_problems else []
    )


@contextmanager
def replayed_copy(path: Path) -> Iterator[Path | None]:
    """Yield a temporary copy of a database with log and journal applied; None without room, or if SQLite fails."""
    present = [suffix for suffix in LOG_SUFFIXES if Path(f"{path}{suffix}").is_file()]
    try:
        with ExitStack() as stack:
            database = stack.enter_context(FileSource(path))
            logs = {suffix: stack.enter_context(FileSource(f"{path}{suffix}")) for suffix in present}
            reads = {suffix: SourceReader(log).read for suffix, log in logs.items()}
            with temporary_database(SourceReader(database).read, reads) as copy:
                yield copy if replay(copy) else None
    except TooLarge:
        yield None


def replay(copy: Path) -> bool:
    """Have SQLite apply log and journal to our copy of a database; return whether it did."""
    journal = Path(f"{copy}{JOURNAL_SUFFIX}")
    if journal.is_file():
        with journal.open("rb") as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - len(_JOURNAL_MAGIC)))
            if file.read() == _JOURNAL_MAGIC:
                return False

    def authorize(action: int, first: str | None, *_: str | None) -> int:
        is_allowed = action == sqlite3.SQLITE_PRAGMA and first in _READ_ONLY_PRAGMAS
        return sqlite3.SQLITE_OK if is_allowed else sqlite3.SQLITE_DENY

    try:
        with closing(sqlite3.connect(copy, isolation_level=None)) as database:
            database.set_authorizer(authorize)
            database.execute("PRAGMA trusted_schema=OFF")
            database.execute("PRAGMA locking_mode=EXCLUSIVE")
            database.execute("PRAGMA journal_mode=DELETE").fetchall()
            database.execute("PRAGMA schema_version").fetchall()
    except sqlite3.Error:
        return False
    return True


def _begins_with_content(path: Path) -> bool:
    with path.open("rb") as file:
        return any(file.read(8))


def _pages_not_merged(path: Path, wal: Path) -> int:
    """Count the pages whose latest committed content is only in the log."""
    with path.open("rb") as database, wal.open("rb") as log:
        head = log.read(_WAL_HEADER.size)
        if len(head) < _WAL_HEADER.size:
            return 0
        magic, _version, page_bytes, _sequence, *salts, _, _ = _WAL_HEADER.unpack(head)
        if magic not in _WAL_MAGICS or not 512 <= page_bytes <= 65536:
            return 0
        committed: dict[int, int] = {}
        open_frames: dict[int, int] = {}
        for _ in range(_MAX_FRAMES):
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
        pages = 0
        for number, at in committed.items():
            log.seek(at)
            database.seek((number - 1) * page_bytes)
            logged = log.read(page_bytes)
            pages += len(logged) == page_bytes and logged != database.read(page_bytes)
        return pages


_SQLITE_MAGIC = b"SQLite format 3\0"


def is_database(head: bytes) -> bool:
    """Return whether the first bytes are those of an SQLite database."""
    return head.startswith(_SQLITE_MAGIC)


def is_database_in_log(head: bytes, path: Path | None) -> bool:
    """Return whether the tables of a database may be in the log beside it, because its recorder was killed early."""
    if path is None or not is_database(head) or path.suffix.lower() != ".db3":
        return False
    return any(Path(f"{path}{suffix}").is_file() for suffix in LOG_SUFFIXES)
