"""Loading a copied database into an empty one, in one transaction: schema, rows, what no longer holds, newest schema.

The schema is made as it was when the copy was, by the same migrations, and brought to the newest once the rows are in:
so a backup of any earlier version can be restored, to any version of PostgreSQL. Foreign keys are made anew after the
rows, which checks every one of them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import psycopg
from alembic import command
from alembic.script import ScriptDirectory
from psycopg import sql
from sqlalchemy import create_engine, pool

from kleinkram.server.backup.failing import BackupError, Damaged, InTheWay
from kleinkram.server.backup.snapshot import Piece, Snapshot, TableCopy
from kleinkram.server.migrations import alembic_config

Database = psycopg.Connection[tuple[object, ...]]

_HAS_TABLES = "SELECT EXISTS (SELECT FROM pg_class WHERE relnamespace = 'public'::regnamespace AND relkind = 'r')"
_RESTORED_FROM = "SELECT obj_description(to_regclass('public.alembic_version'), 'pg_class')"
_FOREIGN_KEYS = """
SELECT conrelid::regclass::text, quote_ident(conname), pg_get_constraintdef(oid)
FROM pg_constraint WHERE contype = 'f' AND connamespace = 'public'::regnamespace
"""
_TRIGGERED = """
SELECT DISTINCT tgrelid::regclass::text FROM pg_trigger
WHERE NOT tgisinternal AND tgrelid IN (SELECT oid FROM pg_class WHERE relnamespace = 'public'::regnamespace)
"""
_COUNTING = """
SELECT c.relname, quote_ident(t.relname), quote_ident(a.attname)
FROM pg_class c JOIN pg_depend d ON d.objid = c.oid AND d.deptype IN ('a', 'i') AND d.classid = 'pg_class'::regclass
JOIN pg_class t ON t.oid = d.refobjid JOIN pg_attribute a ON a.attrelid = t.oid AND a.attnum = d.refobjsubid
WHERE c.relkind = 'S' AND c.relnamespace = 'public'::regnamespace
"""


@dataclass(frozen=True)
class Missing:
    """An object that the restored site has not, or not as its uploader sent it, and why."""

    key: str
    state: str
    reason: str


@dataclass(frozen=True)
class Target:
    """The database to fill, as the role that owns it; who serves it; and by which name its blobs know the new store."""

    dsn: str
    serving_role: str
    store_id: str


def refuse_unknown_schema(snapshot: Snapshot) -> None:
    """Refuse a backup that a newer version made.

    Raises:
        BackupError: this version has no such schema.
    """
    known = {each.revision for each in ScriptDirectory.from_config(alembic_config("", "")).walk_revisions()}
    if snapshot.revision not in known:
        raise BackupError(
            f"The backup {snapshot.id} was made by Kleinkram {snapshot.kleinkram}, whose schema {snapshot.revision} "
            f"this version does not know: restore it with {snapshot.kleinkram} or later."
        )


def restored_from(target: Target) -> str | None:
    """Return which backup a database was restored from; None where it is empty.

    Raises:
        InTheWay: it holds something else.
    """
    with psycopg.connect(target.dsn) as database:
        if not _answer(database, _HAS_TABLES):
            return None
        found = _answer(database, _RESTORED_FROM)
    if not isinstance(found, str) or not found.startswith("restored from "):
        raise InTheWay("The database is not empty: a backup is restored into a new one, without any tables.")
    return found.removeprefix("restored from ")


def load(target: Target, snapshot: Snapshot, read: Callable[[Piece], bytes], missing: Iterable[Missing]) -> None:
    """Fill an empty database; all of it, or nothing. Afterwards it is looked through, so that plans are good at once.

    Raises:
        Damaged: pieces are missing, or a table has not all its rows.
        psycopg.Error, sqlalchemy.exc.SQLAlchemyError: the database would not take it.
    """
    url = target.dsn.replace("postgresql://", "postgresql+psycopg://", 1)
    engine = create_engine(url, poolclass=pool.NullPool, hide_parameters=True)
    config = alembic_config(url, target.serving_role)
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, snapshot.revision)
        database: Database = connection.connection.driver_connection  # type: ignore[assignment]  # psycopg's own
        _fill(database, snapshot, read)
        command.upgrade(config, "head")
        _mend(database, target, snapshot, missing)
        database.execute(
            sql.SQL("COMMENT ON TABLE alembic_version IS {}").format(sql.Literal(f"restored from {snapshot.id}"))
        )
    engine.dispose()
    with psycopg.connect(target.dsn, autocommit=True) as database:
        database.execute("VACUUM (ANALYZE)")


def _fill(database: Database, snapshot: Snapshot, read: Callable[[Piece], bytes]) -> None:
    keys = database.execute(_FOREIGN_KEYS).fetchall()
    for table, name, _ in keys:
        _run(database, f"ALTER TABLE {table} DROP CONSTRAINT {name}")
    triggered = [row[0] for row in database.execute(_TRIGGERED).fetchall()]
    for table in triggered:
        _run(database, f"ALTER TABLE {table} DISABLE TRIGGER USER")
    names = sql.SQL(", ").join(sql.Identifier("public", table.name) for table in snapshot.tables)
    database.execute(sql.SQL("TRUNCATE {}").format(names))  # migrations may have put rows there
    for each in snapshot.tables:
        _fill_table(database, each, read)
    for table, name, definition in keys:
        _run(database, f"ALTER TABLE {table} ADD CONSTRAINT {name} {definition}")
    for table in triggered:
        _run(database, f"ALTER TABLE {table} ENABLE TRIGGER USER")
    _count_on(database, snapshot.sequences)


def _fill_table(database: Database, table: TableCopy, read: Callable[[Piece], bytes]) -> None:
    what = sql.SQL("COPY {} ({}) FROM STDIN").format(
        sql.Identifier("public", table.name), sql.SQL(", ").join(map(sql.Identifier, table.columns))
    )
    with database.cursor() as cursor:
        with cursor.copy(what) as copy:
            for piece in table.pieces:
                copy.write(read(piece))
        if cursor.rowcount != table.rows:
            raise Damaged(f"The backup's table {table.name} has {cursor.rowcount} rows, and was made of {table.rows}.")


def _count_on(database: Database, counted: dict[str, int]) -> None:
    """Let sequences go on where they were, and never below what a table holds: who copied may not have seen them."""
    for sequence, table, column in database.execute(_COUNTING).fetchall():
        highest = _answer(database, f"SELECT max({column}) FROM {table}")  # noqa: S608  (quoted by the catalog)
        last = max(counted.get(str(sequence), 0), highest if isinstance(highest, int) else 0)
        if last:
            database.execute("SELECT setval(quote_ident(%s)::regclass, %s)", (sequence, last))


def _mend(database: Database, target: Target, snapshot: Snapshot, missing: Iterable[Missing]) -> None:
    """Let the rows say no more than is so: about another store, on which nothing has been verified yet."""
    to, was = target.store_id, snapshot.store_id
    for table in ("blob", "upload", "log_chunk"):
        _run(database, f"UPDATE {table} SET store_id = %s WHERE store_id = %s AND store_id <> %s", to, was, to)  # noqa: S608  (constants)
    database.execute("DELETE FROM store_probe")
    # Parts lay in the old store. Whoever sends again begins anew, and finds the name free.
    database.execute(
        "UPDATE upload SET state = 'expired', completing_since = NULL WHERE state IN ('open', 'completing')"
    )
    # Whatever had these runs, had them of another server: the next round takes them back, as of a runner that is gone.
    database.execute("UPDATE run SET lease_ends_at = now() WHERE lease_ends_at > now()")
    database.execute(
        "UPDATE blob SET state = 'stored', state_reason = NULL, damaged_at = NULL"
        " WHERE state <> 'stored' AND store_id = %s AND marked_for_deletion_at IS NULL",
        (to,),
    )
    with database.cursor() as cursor:
        cursor.executemany(
            "UPDATE blob SET state = %s, state_reason = %s, damaged_at = now() WHERE store_id = %s AND key = %s",
            ((each.state, each.reason, to, each.key) for each in missing),
        )


def _run(database: Database, statement: str, *values: str) -> None:
    # Names in it come from the catalog, quoted, or are constants.
    database.execute(statement, values or None)


def _answer(database: Database, question: str) -> object:
    row = database.execute(question).fetchone()
    return row[0] if row else None
