"""The database of a backup: dumped with COPY at one moment, and loaded into an empty database in one transaction.

Every version of PostgreSQL reads the text that COPY writes. The database file is a sequence of pieces: a line of JSON
with the table, its columns and a number of bytes, then these bytes.
"""

import contextlib
import json
import uuid
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from typing import IO, NamedTuple, cast

import psycopg
from alembic import command
from alembic.script import ScriptDirectory
from psycopg import sql
from sqlalchemy import create_engine, pool

from kleinkram.server.backup.errors import (
    BackupConflict,
    BackupDamaged,
    BackupError,
    BackupRequestInvalid,
    BackupUnreachable,
)
from kleinkram.server.backup.lock import repeating
from kleinkram.server.backup.repository import Snapshot
from kleinkram.server.blobs.garbage_collection import DELETION_LOCK
from kleinkram.server.migrations import alembic_config, development_schema_problem

Connection = psycopg.Connection[tuple[object, ...]]
_APPLICATION = "kleinkram backup"
_PIECE_BYTES = 8 * 1024 * 1024
_CONFIRM_S = 30.0
_MAX_IDLE_MS = 300_000

_TABLES = """
SELECT c.relname, string_agg(a.attname, ',' ORDER BY a.attnum)
FROM pg_class c JOIN pg_attribute a ON a.attrelid = c.oid AND a.attnum > 0 AND NOT a.attisdropped
WHERE c.relnamespace = 'public'::regnamespace AND c.relkind = 'r' AND a.attgenerated = ''
  AND c.relname <> 'alembic_version'
GROUP BY c.relname ORDER BY c.relname
"""
# Blobs marked for deletion are left out: their objects may be gone. Chunks of logs have no known hash.
_NAMED = """
COPY (
  SELECT key, size_bytes, encode(sha256, 'hex') FROM blob WHERE marked_for_deletion_at IS NULL AND store_id = {store}
  UNION ALL
  SELECT key, size_bytes, NULL FROM log_chunk WHERE confirmed_at IS NOT NULL AND store_id = {store}
) TO STDOUT
"""
_HAS_TABLES = "SELECT EXISTS (SELECT FROM pg_class WHERE relnamespace = 'public'::regnamespace AND relkind = 'r')"
_RESTORED_FROM = "SELECT obj_description(to_regclass('public.alembic_version'), 'pg_class')"
_FOREIGN_KEYS = """
SELECT conrelid::regclass::text, quote_ident(conname), pg_get_constraintdef(oid)
FROM pg_constraint WHERE contype = 'f' AND connamespace = 'public'::regnamespace
"""
_TABLES_WITH_TRIGGERS = """
SELECT DISTINCT tgrelid::regclass::text FROM pg_trigger
WHERE NOT tgisinternal AND tgrelid IN (SELECT oid FROM pg_class WHERE relnamespace = 'public'::regnamespace)
"""
_SEQUENCES = """
SELECT c.relname, quote_ident(t.relname), quote_ident(a.attname)
FROM pg_class c JOIN pg_depend d ON d.objid = c.oid AND d.deptype IN ('a', 'i') AND d.classid = 'pg_class'::regclass
JOIN pg_class t ON t.oid = d.refobjid JOIN pg_attribute a ON a.attrelid = t.oid AND a.attnum = d.refobjsubid
WHERE c.relkind = 'S' AND c.relnamespace = 'public'::regnamespace
"""


class DatabaseFacts(NamedTuple):
    """The schema's revision, the tables with their columns, and how many blobs are in other stores."""

    revision: str
    tables: dict[str, tuple[str, ...]]
    elsewhere: int


class UnavailableObject(NamedTuple):
    """An object that the restored instance does not have, or not as its uploader sent it, and why."""

    key: str
    state: str
    reason: str


class RestoreTarget(NamedTuple):
    """The database to fill, as the role that owns it; the serving role; and the name of the new store."""

    dsn: str
    serving_role: str
    store_id: str


@contextlib.contextmanager
def deletion_lock(dsn: str) -> Iterator[Callable[[], None]]:
    """Keep the server from deleting objects (see `blobs.garbage_collection`); yields a check that this is still so.

    Raises:
        psycopg.OperationalError: the database does not answer.
        BackupUnreachable: by the check: the connection ended, and objects may have been deleted since.
    """
    with psycopg.connect(dsn, autocommit=True, application_name=_APPLICATION) as connection:

        def confirm() -> None:
            try:
                connection.execute("SELECT 1")
            except psycopg.Error as error:
                raise BackupUnreachable(
                    f"The database ended the connection that kept objects from being deleted ({first_line(error)}): "
                    "run the same command again. What was copied stays."
                ) from error

        # A process that hangs must not keep objects for ever: the database ends idle connections.
        connection.execute(f"SET idle_session_timeout = {_MAX_IDLE_MS}")
        connection.execute("SELECT pg_advisory_lock_shared(%s)", (DELETION_LOCK,))
        with repeating(_CONFIRM_S, confirm):
            yield confirm


@contextlib.contextmanager
def read_snapshot(dsn: str) -> Iterator[Connection]:
    """Open a transaction that sees the database as it is now, and writes nothing.

    Raises:
        psycopg.OperationalError: the database does not answer.
    """
    with psycopg.connect(dsn, application_name=_APPLICATION) as connection:
        connection.isolation_level = psycopg.IsolationLevel.REPEATABLE_READ
        connection.read_only = True
        for name in ("statement_timeout", "idle_in_transaction_session_timeout", "transaction_timeout"):
            # `transaction_timeout` came with PostgreSQL 17.
            connection.execute("SELECT set_config(name, '0', true) FROM pg_settings WHERE name = %s", (name,))
        yield connection


def database_facts(connection: Connection, store_id: str) -> DatabaseFacts:
    """Return what there is to dump; its tables cannot be changed or dropped until the transaction ends.

    Raises:
        BackupRequestInvalid: the database is none of Kleinkram's.
    """
    tables = {str(name): tuple(str(columns).split(",")) for name, columns in connection.execute(_TABLES).fetchall()}
    if "blob" not in tables:
        raise BackupRequestInvalid("The database has no tables of Kleinkram: check which one the settings name.")
    listing = sql.SQL(", ").join(sql.Identifier("public", name) for name in tables)
    connection.execute(sql.SQL("LOCK TABLE {} IN ACCESS SHARE MODE").format(listing))
    elsewhere = "SELECT count(*) FROM blob WHERE marked_for_deletion_at IS NULL AND store_id <> %s"
    return DatabaseFacts(
        revision=str(_value(connection, "SELECT version_num FROM alembic_version")),
        tables=tables,
        elsewhere=int(str(_value(connection, elsewhere, store_id))),
    )


def named_objects(connection: Connection, store_id: str) -> Iterator[tuple[str, int, str | None]]:
    """Yield key, size and SHA-256 of the objects that the database names; log chunks have no SHA-256."""
    with connection.cursor() as cursor, cursor.copy(sql.SQL(_NAMED).format(store=sql.Literal(store_id))) as copy:
        copy.set_types(["text", "int8", "text"])
        yield from cast("Iterator[tuple[str, int, str | None]]", copy.rows())


def dump_tables(connection: Connection, tables: dict[str, tuple[str, ...]], file: IO[bytes]) -> int:
    """Write all rows of the tables; return their number."""
    rows = 0
    for table, columns in tables.items():
        piece = bytearray()
        with connection.cursor() as cursor, cursor.copy(_copy(table, columns, "TO STDOUT")) as copy:
            for row in copy:
                piece += row
                rows += 1
                if len(piece) >= _PIECE_BYTES:
                    _write_piece(file, table, columns, piece)
                    piece.clear()
        _write_piece(file, table, columns, piece)
    return rows


def _write_piece(file: IO[bytes], table: str, columns: tuple[str, ...], piece: bytearray) -> None:
    if piece:
        file.write(json.dumps([table, columns, len(piece)]).encode() + b"\n" + piece)


def dump_sequences(connection: Connection) -> dict[str, int]:
    """Return the last values of the sequences; those never used are left out."""
    query = "SELECT sequencename, last_value FROM pg_sequences WHERE schemaname = 'public' AND last_value IS NOT NULL"
    return {str(name): int(str(value)) for name, value in connection.execute(query).fetchall()}


def missing_log_chunks(dsn: str, keys: Iterable[str]) -> set[str]:
    """Return which of these chunks of logs the database no longer names."""
    listed = [*keys]
    with psycopg.connect(dsn, application_name=_APPLICATION) as connection:
        query = "SELECT key FROM log_chunk WHERE key = ANY(%s)"
        return {*listed} - {str(key) for (key,) in connection.execute(query, (listed,)).fetchall()}


def refuse_unknown_schema(snapshot: Snapshot) -> None:
    """Refuse a backup whose schema this version does not know.

    Raises:
        BackupError: it is one.
    """
    known = {script.revision for script in ScriptDirectory.from_config(alembic_config("", "")).walk_revisions()}
    if snapshot.revision in known:
        return
    if problem := development_schema_problem(snapshot.revision):
        raise BackupError(f"The backup {snapshot.id} cannot be restored: {problem}.")
    raise BackupError(
        f"The backup {snapshot.id} was made by Kleinkram {snapshot.kleinkram}, whose schema {snapshot.revision} "
        f"this version does not know: restore it with {snapshot.kleinkram} or later."
    )


def restored_from(target: RestoreTarget) -> str | None:
    """Return the backup that a database was restored from; None if it is empty.

    Raises:
        BackupConflict: it has other tables.
    """
    with psycopg.connect(target.dsn) as database:
        if not _value(database, _HAS_TABLES):
            return None
        comment = _value(database, _RESTORED_FROM)
    if not isinstance(comment, str) or not comment.startswith("restored from "):
        raise BackupConflict("The database is not empty: a backup is restored into a new one, without any tables.")
    return comment.removeprefix("restored from ")


def load_database(
    target: RestoreTarget,
    snapshot: Snapshot,
    file: IO[bytes],
    unavailable: Iterable[UnavailableObject],
) -> None:
    """Fill an empty database, all of it or nothing: schema as it was, rows, foreign keys, then the newest schema.

    Raises:
        BackupDamaged: rows are missing.
        psycopg.Error, sqlalchemy.exc.SQLAlchemyError: the database refused.
    """
    url = target.dsn.replace("postgresql://", "postgresql+psycopg://", 1)
    engine = create_engine(url, poolclass=pool.NullPool, hide_parameters=True)
    config = alembic_config(url, target.serving_role)
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, snapshot.revision)
        database: Connection = connection.connection.driver_connection  # type: ignore[assignment]  # psycopg's own
        _load_rows(database, snapshot, file)
        command.upgrade(config, "head")
        _adjust_rows(database, target, snapshot, unavailable)
        database.execute(
            sql.SQL("COMMENT ON TABLE alembic_version IS {}").format(sql.Literal(f"restored from {snapshot.id}"))
        )
    engine.dispose()
    with psycopg.connect(target.dsn, autocommit=True) as database:
        database.execute("VACUUM (ANALYZE)")


def _load_rows(database: Connection, snapshot: Snapshot, file: IO[bytes]) -> None:
    """Load all tables without foreign keys and triggers, then make these again, which checks every key."""
    foreign_keys = database.execute(_FOREIGN_KEYS).fetchall()
    for table, name, _ in foreign_keys:
        _run(database, f"ALTER TABLE {table} DROP CONSTRAINT {name}")
    with_triggers = [str(row[0]) for row in database.execute(_TABLES_WITH_TRIGGERS).fetchall()]
    for table in with_triggers:
        _run(database, f"ALTER TABLE {table} DISABLE TRIGGER USER")
    tables = [str(row[0]) for row in database.execute(_TABLES).fetchall()]
    # Migrations insert rows, too.
    database.execute(sql.SQL("TRUNCATE {}").format(sql.SQL(", ").join(sql.Identifier("public", t) for t in tables)))
    rows = 0
    while line := file.readline():
        table, columns, size_bytes = json.loads(line)
        with database.cursor() as cursor:
            with cursor.copy(_copy(table, columns, "FROM STDIN")) as copy:
                copy.write(file.read(size_bytes))
            rows += cursor.rowcount
    if rows != snapshot.rows:
        raise BackupDamaged(f"The backup's database file contains {rows} rows instead of {snapshot.rows}.")
    for table, name, definition in foreign_keys:
        _run(database, f"ALTER TABLE {table} ADD CONSTRAINT {name} {definition}")
    for table in with_triggers:
        _run(database, f"ALTER TABLE {table} ENABLE TRIGGER USER")
    # Sequences continue where they were, and above the rows: the dumping role may not see all of them.
    for sequence, table, column in database.execute(_SEQUENCES).fetchall():
        highest = _value(database, f"SELECT max({column}) FROM {table}")  # noqa: S608  (quoted by the catalog)
        last = max(snapshot.sequences.get(str(sequence), 0), highest if isinstance(highest, int) else 0)
        if last:
            database.execute("SELECT setval(quote_ident(%s)::regclass, %s)", (sequence, last))


def _adjust_rows(
    database: Connection, target: RestoreTarget, snapshot: Snapshot, unavailable: Iterable[UnavailableObject]
) -> None:
    """Reset what no longer holds: the objects are in another store, where nothing has been verified yet."""
    to, was = target.store_id, snapshot.store_id
    for table in ("blob", "upload", "log_chunk", "recording_preview"):
        _run(database, f"UPDATE {table} SET store_id = %s WHERE store_id = %s AND store_id <> %s", to, was, to)  # noqa: S608  (constants)
    database.execute("DELETE FROM store_probe")
    # Their objects are in no backup: the worker makes previews again, except those that people deleted.
    database.execute("DELETE FROM recording_preview WHERE state <> 'deleted'")
    database.execute("UPDATE recording_preview SET key = NULL")
    # The parts of active uploads are in the old store: clients start these again, and their names are free.
    database.execute(
        "UPDATE upload SET state = 'expired', completing_since = NULL WHERE state IN ('open', 'completing')"
    )
    # Runs were leased to runners of another server: the scheduler queues them again.
    database.execute("UPDATE run SET lease_ends_at = now() WHERE lease_ends_at > now()")
    database.execute(
        "UPDATE blob SET state = 'stored', state_reason = NULL, damaged_at = NULL"
        " WHERE state <> 'stored' AND store_id = %s AND marked_for_deletion_at IS NULL",
        (to,),
    )
    with database.cursor() as cursor:
        cursor.executemany(
            "UPDATE blob SET state = %s, state_reason = %s, damaged_at = now() WHERE store_id = %s AND key = %s",
            ((lost.state, lost.reason, to, lost.key) for lost in unavailable),
        )


def _copy(table: str, columns: tuple[str, ...], direction: str) -> sql.Composed:
    listing = sql.SQL(", ").join(map(sql.Identifier, columns))
    return sql.SQL("COPY {} ({}) {}").format(sql.Identifier("public", table), listing, sql.SQL(direction))


def _run(database: Connection, statement: str, *values: str) -> None:
    # Names in it come from the catalog, quoted, or are constants.
    database.execute(statement, values or None)


def record_attempt(dsn: str, started_at: datetime, snapshot_id: str | None, damaged_objects: int) -> None:
    """Record that a backup was made, or with None that an attempt failed.

    Raises:
        psycopg.Error: the database is away, or the role may only read.
    """
    values = (uuid.uuid4(), started_at, snapshot_id, damaged_objects)
    with psycopg.connect(dsn, application_name=_APPLICATION) as connection:
        connection.execute(
            "INSERT INTO backup_attempt (id, started_at, snapshot_id, damaged_objects) VALUES (%s, %s, %s, %s)", values
        )


def _value(database: Connection, query: str, *values: str) -> object:
    row = database.execute(query, values or None).fetchone()
    return row[0] if row else None


def first_line(error: Exception) -> str:
    """Return the first line of the message of a database error."""
    return str(error).strip().partition("\n")[0]
