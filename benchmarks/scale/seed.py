"""Ten years of a lab, inserted into PostgreSQL by the serving role: one statement per step, each committed.

Ids follow from names, so that a step that was done is passed over, and one that was interrupted is done again. The
bytes are nobody's: they are said to be in another store, which the jobs of this one leave alone.

`python -m benchmarks.scale.seed SERVING_URL 1|10 [OWNER_URL]` fills any migrated database that has an admin.
"""

import hashlib
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import psycopg
from psycopg import sql

from benchmarks.scale import statements

Say = Callable[[str], None]
# These people see all missions, one in ten, and a few.
ALL, TENTH, SOME = "bench-reads-all", "bench-reads-a-tenth", "bench-reads-a-few"
_SLICES = 64
# The most expensive indexes that no job of the worker needs during the seeding.
_COSTLY = """
SELECT index.relname, pg_get_indexdef(index.oid)
  FROM pg_index JOIN pg_class index ON index.oid = indexrelid JOIN pg_am ON pg_am.oid = index.relam
  WHERE NOT indisunique AND (amname = 'gin' AND indrelid = 'file'::regclass OR indrelid = 'topic'::regclass)
"""
_TABLES = "person access_group membership access_grant project mission recording blob file topic mission_topic token"


@dataclass(frozen=True)
class Size:
    """The amount of data: 1 or 10 times the base size."""

    times: int

    def values(self) -> dict[str, int]:
        """Return the parameters of the statements."""
        sizes = {"people": 500, "groups": 60, "projects": 100, "missions": 10_000}
        return {name: number * self.times for name, number in sizes.items()}


def fill(url: str, size: Size, *, owner_url: str | None = None, say: Say = print) -> None:
    """Insert everything. Existing rows stay; repeat an interrupted call to continue.

    With `owner_url`, of the role that the tables belong to, indexes are made once all rows are there, which takes a
    fraction of the time, and the tables are vacuumed and analysed at the end, as they would be in any database that has
    stood for some minutes.
    """
    began = time.perf_counter()

    def progress(what: str) -> None:
        say(f"{time.perf_counter() - began:6.0f} s  {what}")

    with psycopg.connect(url, autocommit=True) as database:
        database.execute("SET synchronous_commit = off")
        database.execute("SET statement_timeout = 0")
        database.execute("SET work_mem = '256MB'")
        owner = database.execute("SELECT person_id FROM token WHERE name = 'local owner'").fetchone()
        secrets = {f"secret_{n}": hashlib.sha256(name.encode()).digest() for n, name in enumerate((ALL, TENTH, SOME))}
        parameters = {**size.values(), **secrets, "owner": owner and owner[0]}
        left = [
            (name, statement.encode(), {**parameters, **values})
            for name, check, statement, values in _steps()
            if database.execute(check.encode(), {**parameters, **values}).fetchone() is None
        ]
        if owner_url is None and _noted(database):
            raise SystemExit("indexes were set aside by a call that was interrupted: give OWNER_URL, to have them made")
        if owner_url is not None and left:
            _set_indexes_aside(owner_url)
        for name, statement, values in left:
            database.execute(statement, values)
            progress(name)
    if owner_url is not None:
        _make_indexes(owner_url, progress)
        with psycopg.connect(owner_url, autocommit=True) as database:
            for table in _TABLES.split():
                database.execute(f"VACUUM (ANALYZE) {table}".encode())
        progress("vacuumed and analysed")


def _set_indexes_aside(owner_url: str) -> None:
    """Drop the costly indexes of the largest tables, and note their definitions."""
    with psycopg.connect(owner_url) as database:
        database.execute("CREATE TABLE IF NOT EXISTS seed_index (definition text PRIMARY KEY)")
        for name, definition in database.execute(_COSTLY).fetchall():
            database.execute("INSERT INTO seed_index VALUES (%s) ON CONFLICT DO NOTHING", [definition])
            database.execute(sql.SQL("DROP INDEX {}").format(sql.Identifier(name)))


def _noted(database: psycopg.Connection) -> bool:
    return database.execute("SELECT FROM pg_tables WHERE tablename = 'seed_index'").fetchone() is not None


def _make_indexes(owner_url: str, progress: Say) -> None:
    """Recreate the dropped indexes, of this call or of an interrupted one."""
    with psycopg.connect(owner_url, autocommit=True) as database:
        if not _noted(database):
            return
        database.execute("SET maintenance_work_mem = '1GB'")
        for (definition,) in database.execute("SELECT definition FROM seed_index").fetchall():
            with database.transaction():
                database.execute(definition.encode())
                database.execute("DELETE FROM seed_index WHERE definition = %s", [definition])
            progress(definition.split()[2])
        database.execute("DROP TABLE seed_index")


def _steps() -> Iterator[tuple[str, str, str, dict[str, object]]]:
    """Yield each step with the query whether it is done, and its parameters."""
    for name, check, statement in statements.WHOLE_BEFORE:
        yield name, check, statement, {}
    for number in range(_SLICES):
        # In the order of ids, so that each index is filled page by page.
        low = f"{number * 256 // _SLICES:02x}000000-0000-0000-0000-000000000000"
        high = f"{(number + 1) * 256 // _SLICES - 1:02x}ffffff-ffff-ffff-ffff-ffffffffffff"
        yield f"topics {number + 1}/{_SLICES}", statements.TOPICS_DONE, statements.TOPICS, {"low": low, "high": high}
    for name, check, statement in statements.WHOLE_AFTER:
        yield name, check, statement, {}


if __name__ == "__main__":
    fill(sys.argv[1], Size(int(sys.argv[2])), owner_url=sys.argv[3] if len(sys.argv) > 3 else None)
