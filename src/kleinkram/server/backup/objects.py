"""The objects of one backup, as sets: those the database names, those stored in the location, those verified before.

Kept in a temporary SQLite database that has no name and goes with the process: millions of objects need little memory.
"""

import sqlite3
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from kleinkram.server.backup.rclone import RemoteFile

BATCH_OBJECTS = 10_000
BATCH_BYTES = 50_000_000_000

_SCHEMA = """
CREATE TABLE named (key TEXT PRIMARY KEY, size_bytes INTEGER NOT NULL, sha256 TEXT) WITHOUT ROWID;
CREATE TABLE stored (key TEXT PRIMARY KEY, size_bytes INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE verified (key TEXT PRIMARY KEY, sha256 TEXT, problem TEXT) WITHOUT ROWID;
"""
# Of a corrupt object only the SHA-256 of what was found is known, not its size.
_IS_COMPLETE = "stored.key IS NOT NULL AND (stored.size_bytes = named.size_bytes OR verified.problem = 'corrupt')"
_PENDING = f"""
SELECT named.key, named.size_bytes, named.sha256, coalesce({_IS_COMPLETE}, 0)
FROM named LEFT JOIN stored USING (key) LEFT JOIN verified USING (key)
WHERE NOT coalesce({_IS_COMPLETE} AND verified.sha256 IS NOT NULL, 0) ORDER BY named.key
"""  # noqa: S608  (constants)
_ENTRIES = """
SELECT named.key, named.size_bytes, verified.sha256, named.sha256, verified.problem
FROM named LEFT JOIN verified USING (key) ORDER BY named.key
"""


class NamedObject(NamedTuple):
    """An object that the database names. `sha256` is None for a chunk of a log; `is_stored`: in the location."""

    key: str
    size_bytes: int
    sha256: str | None
    is_stored: bool = False


class ObjectEntry(NamedTuple):
    """An object in a backup's list.

    `sha256`: of the bytes in the location, None where there are none. `expected`: what the database states.
    `problem`: what was wrong in the store when it was copied (lost, unreadable or corrupt).
    """

    key: str
    size_bytes: int
    sha256: str | None
    expected: str | None
    problem: str | None


class UnnamedObject(NamedTuple):
    """An object in the location."""

    key: str
    size_bytes: int


class ObjectIndex:
    """Sets of objects, in a temporary file."""

    def __init__(self) -> None:
        self._db = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        self._db.executescript(_SCHEMA)

    def close(self) -> None:
        """Delete the temporary file."""
        self._db.close()

    def add_named(self, objects: Iterable[NamedObject]) -> None:
        """Add objects that the database names."""
        self._insert("INSERT OR REPLACE INTO named VALUES (?, ?, ?)", (named[:3] for named in objects))

    def add_stored(self, files: Iterable[RemoteFile]) -> None:
        """Add objects that the location has."""
        self._insert("INSERT OR REPLACE INTO stored VALUES (?, ?)", ((file.path, file.size_bytes) for file in files))

    def add_verified(self, entries: Iterable[ObjectEntry]) -> None:
        """Add what is known of objects: from an earlier backup, or because they were read."""
        rows = ((entry.key, entry.sha256, entry.problem) for entry in entries)
        self._insert("INSERT OR REPLACE INTO verified VALUES (?, ?, ?)", rows)

    def remove_named(self, keys: Iterable[str]) -> None:
        """Drop objects that the database no longer names."""
        self._insert("DELETE FROM named WHERE key = ?", ((key,) for key in keys))

    def totals(self) -> tuple[int, int]:
        """Return how many objects the database names, and their bytes."""
        return self._totals("named")

    def stored_totals(self) -> tuple[int, int]:
        """Return how many objects the location has, and their bytes."""
        return self._totals("stored")

    def pending_batches(self) -> Iterator[list[NamedObject]]:
        """Yield the objects that are to be copied or read, in batches; others were verified by an earlier backup."""
        self._db.executescript(f"DROP TABLE IF EXISTS pending; CREATE TABLE pending AS {_PENDING}")
        rows = self._db.execute("SELECT * FROM pending")
        return in_batches(NamedObject(key, size, sha256, bool(is_stored)) for key, size, sha256, is_stored in rows)

    def entries(self) -> Iterator[ObjectEntry]:
        """Yield all named objects with what is known of each."""
        for key, size_bytes, sha256, expected, problem in self._db.execute(_ENTRIES):
            yield ObjectEntry(key, size_bytes, sha256, expected, problem)

    def stored_size(self, key: str) -> int | None:
        """Return the size of an object in the location, None where there is none."""
        row = self._db.execute("SELECT size_bytes FROM stored WHERE key = ?", (key,)).fetchone()
        return None if row is None else int(row[0])

    def unnamed_stored(self) -> Iterator[UnnamedObject]:
        """Yield objects in the location that nothing names."""
        for row in self._db.execute(
            "SELECT key, size_bytes FROM stored WHERE key NOT IN (SELECT key FROM named) ORDER BY key"
        ):
            yield UnnamedObject(*row)

    def stored_batches(self) -> Iterator[list[NamedObject]]:
        """Yield the named objects that the location has, in batches."""
        rows = self._db.execute(
            "SELECT named.key, named.size_bytes, named.sha256 FROM named JOIN stored USING (key) ORDER BY 1"
        )
        return in_batches(NamedObject(*row) for row in rows)

    def _totals(self, table: str) -> tuple[int, int]:
        query = f"SELECT count(*), coalesce(sum(size_bytes), 0) FROM {table}"  # noqa: S608  (a constant)
        count, size_bytes = self._db.execute(query).fetchone()
        return int(count), int(size_bytes)

    def _insert(self, statement: str, rows: Iterable[tuple[object, ...]]) -> None:
        self._db.execute("BEGIN")
        try:
            self._db.executemany(statement, rows)
        finally:
            self._db.execute("COMMIT")


def in_batches(objects: Iterable[NamedObject]) -> Iterator[list[NamedObject]]:
    """Yield objects in lists of bounded number and bytes."""
    batch: list[NamedObject] = []
    size_bytes = 0
    for named in objects:
        if batch and (len(batch) == BATCH_OBJECTS or size_bytes + named.size_bytes > BATCH_BYTES):
            yield batch
            batch, size_bytes = [], 0
        batch.append(named)
        size_bytes += named.size_bytes
    if batch:
        yield batch
