"""Copying the database as of one moment, table by table, and listing the objects that it named then.

By `COPY` in one transaction that sees nothing of what is written meanwhile: it needs no program of PostgreSQL's, and
what it writes every version of PostgreSQL reads. The list goes to a file of this machine that nobody else sees.
"""

import json
import tempfile
from collections.abc import AsyncGenerator, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import IO

import psycopg
import zstandard
from psycopg import sql

from kleinkram.server.backup.failing import CannotBeMeant
from kleinkram.server.backup.repository import Repository
from kleinkram.server.backup.snapshot import Piece, TableCopy

Reading = psycopg.AsyncConnection[tuple[object, ...]]
_MOST_TOGETHER = 1000
_PIECE_BYTES = 8 * 1024 * 1024

_TABLES = """
SELECT c.relname, array_agg(a.attname ORDER BY a.attnum)
FROM pg_class c JOIN pg_attribute a ON a.attrelid = c.oid AND a.attnum > 0 AND NOT a.attisdropped
WHERE c.relnamespace = 'public'::regnamespace AND c.relkind = 'r' AND a.attgenerated = ''
  AND c.relname <> 'alembic_version'
GROUP BY c.relname ORDER BY c.relname
"""

# Blobs that are on their way out are left: their objects may be gone already. Of pieces of logs no hash is known.
_WANTED = """
COPY (
  SELECT key, size_bytes, encode(sha256, 'hex') AS hash FROM blob
    WHERE marked_for_deletion_at IS NULL AND store_id = {store}
  UNION ALL
  SELECT key, size_bytes, NULL FROM log_chunk WHERE kept_at IS NOT NULL AND store_id = {store}
  ORDER BY hash, key
) TO STDOUT
"""
_WANTED_BEFORE_RUNS = """
COPY (
  SELECT key, size_bytes, encode(sha256, 'hex') AS hash FROM blob
    WHERE marked_for_deletion_at IS NULL AND store_id = {store}
  ORDER BY hash, key
) TO STDOUT
"""


@dataclass(frozen=True)
class Wanted:
    """An object that the database named; `sha256` is what it states of the content, None for a piece of a log."""

    key: str
    size_bytes: int
    sha256: bytes | None


@dataclass(frozen=True)
class Facts:
    """What the database is, and which tables with which columns there are."""

    postgres: str
    revision: str
    tables: dict[str, tuple[str, ...]]
    elsewhere: int


@asynccontextmanager
async def one_moment(dsn: str) -> AsyncGenerator[Reading, None]:
    """Open a transaction that sees the database as it is now, and writes nothing.

    Raises:
        psycopg.OperationalError: the database does not answer.
    """
    connection = await psycopg.AsyncConnection.connect(dsn, application_name="kleinkram backup")
    async with connection:
        await connection.set_isolation_level(psycopg.IsolationLevel.REPEATABLE_READ)
        await connection.set_read_only(True)
        for name in ("statement_timeout", "idle_in_transaction_session_timeout", "transaction_timeout"):
            await _unlimited(connection, name)
        yield connection


async def _unlimited(connection: Reading, name: str) -> None:
    # `transaction_timeout` came with PostgreSQL 17.
    await connection.execute("SELECT set_config(name, '0', true) FROM pg_settings WHERE name = %s", (name,))


async def facts(connection: Reading, store_id: str) -> Facts:
    """Say what there is to copy, and keep its tables from being changed or dropped until the transaction ends.

    Raises:
        CannotBeMeant: the database is none of Kleinkram's.
    """
    rows = await (await connection.execute(_TABLES)).fetchall()
    tables = {str(name): tuple(str(each) for each in _strings(columns)) for name, columns in rows}
    if "blob" not in tables:
        raise CannotBeMeant("The database has no tables of Kleinkram: check which one the settings name.")
    listing = sql.SQL(", ").join(sql.Identifier("public", name) for name in tables)
    await connection.execute(sql.SQL("LOCK TABLE {} IN ACCESS SHARE MODE").format(listing))
    revision = await _one(connection, "SELECT version_num FROM alembic_version")
    elsewhere = await _one(
        connection, "SELECT count(*)::text FROM blob WHERE marked_for_deletion_at IS NULL AND store_id <> %s", store_id
    )
    return Facts(await _one(connection, "SHOW server_version"), revision, tables, int(elsewhere))


def _strings(value: object) -> list[object]:
    return list(value) if isinstance(value, list) else []


async def _one(connection: Reading, question: str, *values: str) -> str:
    row = await (await connection.execute(question, values)).fetchone()
    return str(row[0]) if row else ""


async def copy_table(connection: Reading, repository: Repository, name: str, columns: tuple[str, ...]) -> TableCopy:
    """Keep all rows of one table."""
    what = sql.SQL("COPY {} ({}) TO STDOUT").format(
        sql.Identifier("public", name), sql.SQL(", ").join(map(sql.Identifier, columns))
    )
    pieces: list[Piece] = []
    rows, held = 0, bytearray()
    async with connection.cursor() as cursor, cursor.copy(what) as copy:
        async for row in copy:
            held += row
            rows += 1
            if len(held) >= _PIECE_BYTES:
                pieces.append(await repository.put_packed(bytes(held)))
                held.clear()
    if held:
        pieces.append(await repository.put_packed(bytes(held)))
    return TableCopy(name=name, columns=columns, rows=rows, pieces=tuple(pieces))


async def sequences(connection: Reading) -> dict[str, int]:
    """Return how far the sequences have counted; those that have not are left out."""
    question = (
        "SELECT sequencename, last_value FROM pg_sequences WHERE schemaname = 'public' AND last_value IS NOT NULL"
    )
    rows = await (await connection.execute(question)).fetchall()
    return {str(name): int(str(value)) for name, value in rows}


class WantedList:
    """All objects that the database named, in a file without a name: those of one content stand together."""

    def __init__(self) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile(prefix="klein-backup-")  # noqa: SIM115  (`close`)
        self.count = 0
        self.size_bytes = 0

    def close(self) -> None:
        """Forget it."""
        self._file.close()

    async def fill(self, connection: Reading, store_id: str, *, with_logs: bool) -> None:
        """Ask the database."""
        packer = zstandard.ZstdCompressor(level=1).stream_writer(self._file, closefd=False)
        question = sql.SQL(_WANTED if with_logs else _WANTED_BEFORE_RUNS).format(store=sql.Literal(store_id))
        async with connection.cursor() as cursor, cursor.copy(question) as copy:
            copy.set_types(["text", "int8", "text"])
            async for key, size_bytes, sha256 in copy.rows():
                packer.write(json.dumps([key, size_bytes, sha256]).encode() + b"\n")
                self.count += 1
                self.size_bytes += int(str(size_bytes))
        packer.close()  # type: ignore[no-untyped-call]  # the library says nothing of it

    def groups(self) -> Iterator[list[Wanted]]:
        """Yield the objects, those of one content together, as far as memory allows."""
        self._file.seek(0)
        reader = zstandard.ZstdDecompressor().stream_reader(self._file, closefd=False)
        group: list[Wanted] = []
        for line in _lines(reader):
            key, size_bytes, hashed = json.loads(line)
            wanted = Wanted(key, size_bytes, bytes.fromhex(hashed) if hashed else None)
            is_other = wanted.sha256 is None or not group or wanted.sha256 != group[0].sha256
            if group and (is_other or len(group) == _MOST_TOGETHER):
                yield group
                group = []
            group.append(wanted)
        if group:
            yield group


def _lines(reader: zstandard.ZstdDecompressionReader) -> Iterator[bytes]:
    held = b""
    while piece := reader.read(65_536):
        *whole, held = (held + piece).split(b"\n")
        yield from whole
