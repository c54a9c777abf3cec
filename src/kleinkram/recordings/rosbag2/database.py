"""A rosbag2 database, opened as something that a stranger made: read-only, unchanging, nothing in it is obeyed.

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
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NamedTuple

from kleinkram.recordings.errors import Malformed, SourceError
from kleinkram.recordings.limits import MAX_NAME, MAX_NAMES, MAX_TOPICS

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
_MOST_FAULTS = 10
_MAX_STATED = 4 * 2**20


class TopicRow(NamedTuple):
    """A row of the table `topics`; the oldest databases have no `serialization_format`, which is empty then."""

    topic_id: int
    name: str
    message_type: str
    serialization_format: str


class Origin(NamedTuple):
    """What a database says of where it comes from; empty, 0 or None where it says nothing.

    Attributes:
        ros_distro: such as "jazzy".
        schema_version: of the tables.
        definitions: how many message types it defines.
        message_compression: how the data of each message is compressed, such as "zstd".
    """

    ros_distro: str = ""
    schema_version: int | None = None
    definitions: int = 0
    message_compression: str = ""


class MessageRow(NamedTuple):
    """What is read of a message: its time as integer nanoseconds, and the bytes of its data."""

    topic_id: int
    timestamp: int
    data_bytes: int


@contextmanager
def open_database(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a database for reading. What cannot be read of it raises `sqlite3.Error` then, or at any later query.

    Raises:
        SourceError: the file cannot be opened.
    """
    if not os.access(path, os.R_OK):
        raise SourceError(f"{path}: cannot be opened for reading")
    try:
        with _connect(path) as database:
            yield database
    except MemoryError:
        # SQLite says this of some damaged schemas too. Whether there was enough is tried out: a MemoryError says no.
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
        database.set_progress_handler(_allowance(path.stat().st_size), _STEPS_A_TICK)
        for statement in _PREPARE:
            database.execute(statement)
        database.text_factory = _decode
        database.set_authorizer(_authorize)
        yield database


class _Allowance:
    def __init__(self, ticks: int) -> None:
        self._left = ticks

    def __call__(self) -> int:
        self._left -= 1
        return self._left < 0


def _allowance(size_bytes: int) -> _Allowance:
    """End queries that take more steps than all rows that such a file can hold."""
    return _Allowance((_FREE_STEPS + _STEPS_A_BYTE * size_bytes) // _STEPS_A_TICK)


def _decode(text: bytes) -> str:
    return text.decode("utf-8", "replace")


def _authorize(action: int, first: str | None, second: str | None, _database: str | None, _trigger: str | None) -> int:
    allowed = (
        action in (sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ)
        or (action == sqlite3.SQLITE_PRAGMA and first in _PRAGMAS)
        or (action == sqlite3.SQLITE_FUNCTION and second in _FUNCTIONS)
    )
    return sqlite3.SQLITE_OK if allowed else sqlite3.SQLITE_DENY


def check_tables(database: sqlite3.Connection) -> None:
    """Make sure that `topics` and `messages` are tables with the columns that every version has.

    Raises:
        Malformed: they are not.
        sqlite3.Error: the schema cannot be read.
    """
    found = database.execute(
        "SELECT name, type, rootpage FROM sqlite_master WHERE name IN ('topics', 'messages') AND type != 'index'"
    ).fetchall()
    kinds = {name: "virtual table" if kind == "table" and not root else kind for name, kind, root in found}
    for table, needed in (("topics", {"name", "type"}), ("messages", {"topic_id", "timestamp", "data"})):
        if kinds.get(table) != "table":
            what = f"is a {kinds[table]}" if table in kinds else "is missing"
            raise Malformed(f"table {table}", f"it {what}, so this is no rosbag2 recording")
        if missing := needed - columns(database, table):
            raise Malformed(f"table {table}", f"it has no column {', '.join(sorted(missing))}")


def columns(database: sqlite3.Connection, table: str) -> set[str]:
    """Return the names of a table's stored columns: generated ones are not among them."""
    return {row[1] for row in database.execute(f"PRAGMA table_info({table})")}


def read_topics(database: sqlite3.Connection) -> list[TopicRow]:
    """Return the topics, in the order of their ids.

    Raises:
        Malformed: there are more than is credible.
        sqlite3.Error: they cannot be read.
    """
    there = columns(database, "topics")
    wanted = ", ".join(f"substr({name}, 1, {MAX_NAME})" if name in there else "''" for name in _TEXT_COLUMNS)
    topics: list[TopicRow] = []
    names_bytes = 0
    for topic_id, *texts in database.execute(f"SELECT rowid, {wanted} FROM topics ORDER BY rowid"):  # noqa: S608  # names of ours
        row = TopicRow(topic_id, *(text if isinstance(text, str) else "" for text in texts))
        names_bytes += sum(map(len, row[1:]))
        if len(topics) >= MAX_TOPICS or names_bytes > MAX_NAMES:
            raise Malformed("table topics", f"more than {MAX_TOPICS} topics, or very long names", certain=False)
        topics.append(row)
    return topics


def read_origin(database: sqlite3.Connection) -> Origin:
    """Return what the tables `schema`, `metadata` and `message_definitions` say, of which older databases have none.

    Raises:
        sqlite3.Error: one of them cannot be read.
    """
    distro: object = ""
    version: object = None
    definitions, stated = 0, ""
    if {"schema_version", "ros_distro"} <= columns(database, "schema"):
        row = database.execute(f"SELECT schema_version, substr(ros_distro, 1, {MAX_NAME}) FROM schema").fetchone()  # noqa: S608  # ours
        version, distro = row or (None, "")
    if "metadata" in columns(database, "metadata"):
        latest = f"SELECT substr(metadata, 1, {_MAX_STATED}) FROM metadata ORDER BY rowid DESC LIMIT 1"  # noqa: S608  # ours
        row = database.execute(latest).fetchone()
        stated = row[0] if row and isinstance(row[0], str) else ""
    if columns(database, "message_definitions"):
        definitions = database.execute("SELECT count(*) FROM message_definitions").fetchone()[0]
    is_message = _stated_value(stated, "compression_mode") == "message"
    return Origin(
        distro if isinstance(distro, str) else "",
        version if isinstance(version, int) else None,
        definitions,
        _stated_value(stated, "compression_format") or "zstd" if is_message else "",
    )


def _stated_value(text: str, key: str) -> str:
    """Return a value at the top of the metadata as a recorder writes it: YAML, one key a line, in whatever case."""
    found = re.search(rf"^{key}:[ ]*[\"']?(\w*)", text, re.MULTILINE)
    return found[1].lower() if found else ""


def find_faults(database: sqlite3.Connection) -> list[str]:
    """Check the structure of every page and the place of every row; what is wrong, in SQLite's words.

    Raises:
        sqlite3.Error: not even that can be done.
    """
    rows = database.execute(f"PRAGMA quick_check({_MOST_FAULTS})").fetchall()
    return [str(row[0]) for row in rows if row[0] != "ok"]


def message_cursor(database: sqlite3.Connection) -> sqlite3.Cursor:
    """Return all messages as rows of topic id, timestamp and bytes of data, in the order of the file (rowid).

    Of large data only the length is looked at, so its pages are not read.
    """
    return database.execute("SELECT topic_id, timestamp, length(data) FROM messages NOT INDEXED")
