"""The objects of a backup: what the database states, what the location has, and what reading them showed.

Kept in a temporary SQLite database that has no name and ends with the process: millions of objects need little memory.
"""

import itertools
import sqlite3
from collections.abc import Iterable, Iterator
from typing import NamedTuple

BATCH_OBJECTS = 10_000
BATCH_BYTES = 50_000_000_000

IS_NAMED = "size_bytes IS NOT NULL"
IS_UNUSED = "size_bytes IS NULL"
IS_NAMED_AND_STORED = f"{IS_NAMED} AND stored_bytes IS NOT NULL"
# Of a corrupt object only the SHA-256 of what was found is known, not its size.
_IS_COMPLETE = "stored_bytes IS NOT NULL AND (stored_bytes IS size_bytes OR problem IS 'corrupt')"
IS_PENDING = f"{IS_NAMED} AND NOT ({_IS_COMPLETE} AND sha256 IS NOT NULL)"
"""To be copied or read: no earlier backup verified it, or the location no longer has it."""


class BackupObject(NamedTuple):
    """An object of the store or of the backup location; columns are None where nothing is known.

    `size_bytes`, `expected`: size and SHA-256 by the database, which has no SHA-256 of log chunks. `stored_bytes`: its
    size in the location. `sha256`: of the bytes in the location. `problem`: what was wrong in the store when it was
    copied (lost, unreadable or corrupt).
    """

    key: str
    size_bytes: int | None = None
    expected: str | None = None
    stored_bytes: int | None = None
    sha256: str | None = None
    problem: str | None = None

    @property
    def bytes(self) -> int:
        """The size, by the database if it names the object."""
        return self.size_bytes if self.size_bytes is not None else self.stored_bytes or 0

    @property
    def is_complete(self) -> bool:
        """Whether the location has it completely."""
        return self.stored_bytes is not None and (self.stored_bytes == self.size_bytes or self.problem == "corrupt")

    def matches(self, sha256: str | None) -> bool:
        """Whether bytes with this SHA-256 are the object's; None: there are no bytes."""
        return sha256 is not None and self.expected in (None, sha256)


class ObjectIndex:
    """A set of objects, by key."""

    def __init__(self) -> None:
        self._db = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        self._db.execute(
            "CREATE TABLE object (key TEXT PRIMARY KEY, size_bytes INTEGER, expected TEXT, stored_bytes INTEGER,"
            " sha256 TEXT, problem TEXT) WITHOUT ROWID"
        )

    def close(self) -> None:
        """Delete the temporary database."""
        self._db.close()

    def put(self, columns: str, rows: Iterable[tuple[object, ...]]) -> None:
        """Set columns of objects; `columns` begins with the key. Objects that are new are added."""
        names = columns.split(", ")
        placeholders = ", ".join("?" * len(names))
        values = ", ".join(f"{name} = excluded.{name}" for name in names[1:])
        self._execute_many(
            f"INSERT INTO object ({columns}) VALUES ({placeholders}) ON CONFLICT (key) DO UPDATE SET {values}",  # noqa: S608  (constants)
            rows,
        )

    def remove(self, keys: Iterable[str]) -> None:
        """Remove objects."""
        self._execute_many("DELETE FROM object WHERE key = ?", ((key,) for key in keys))

    def stored_size(self, key: str) -> int | None:
        """Return the size of an object in the location, None where there is none."""
        row = self._db.execute("SELECT stored_bytes FROM object WHERE key = ?", (key,)).fetchone()
        return None if row is None or row[0] is None else int(row[0])

    def select(self, condition: str) -> Iterator[BackupObject]:
        """Yield the objects that meet an SQL condition, ordered by key; do not change the index while iterating."""
        for row in self._db.execute(f"SELECT * FROM object WHERE {condition} ORDER BY key"):  # noqa: S608  (constants)
            yield BackupObject(*row)

    def batches(self, condition: str) -> Iterator[list[BackupObject]]:
        """Yield the objects that meet an SQL condition, in lists of bounded number and bytes, ordered by key."""
        query = f"SELECT * FROM object WHERE key > ? AND {condition} ORDER BY key LIMIT {BATCH_OBJECTS}"  # noqa: S608  (constants)
        last = ""
        while rows := [BackupObject(*row) for row in self._db.execute(query, (last,))]:
            sizes = itertools.accumulate(row.bytes for row in rows)
            fitting = sum(size_bytes <= BATCH_BYTES for size_bytes in sizes)
            batch = rows[: max(1, fitting)]
            yield batch
            last = batch[-1].key

    def totals(self, column: str) -> tuple[int, int]:
        """Return the number of objects with a size in this column, and the sum of the sizes."""
        query = f"SELECT count({column}), coalesce(sum({column}), 0) FROM object"  # noqa: S608  (a constant)
        count, size_bytes = self._db.execute(query).fetchone()
        return int(count), int(size_bytes)

    def _execute_many(self, statement: str, rows: Iterable[tuple[object, ...]]) -> None:
        self._db.execute("BEGIN")
        try:
            self._db.executemany(statement, rows)
        finally:
            self._db.execute("COMMIT")
