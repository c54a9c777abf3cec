"""Upgrade a database to this version's schema while servers use it: they wait for seconds at most, and lose nothing.

One migrator at a time; the others wait, and then find nothing to do. Each revision is one transaction. A revision that
does not get its table locks within two seconds is rolled back, so that statements queued behind it run, and is retried.
It locks its tables before it changes anything, and never for so long that PostgreSQL ends a request instead.
"""

import logging
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import psycopg
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import Script, ScriptDirectory
from sqlalchemy import Connection, create_engine, delete, pool, text
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import DBAPIError

from kleinkram.server.migrations import HEAD, alembic_config, development_schema_problem, later_schema_problem
from kleinkram.server.tables import audit_retention

_log = logging.getLogger("kleinkram.migrations")
# The advisory lock that migrators of one database take.
LOCK = 0x6B6C65696E
_POLL_S = 0.2
_FIRST_PAUSE_S = 0.5
_LONGEST_PAUSE_S = 10.0
_TRY_S = 0.02
_LOCK_ERRORS = (psycopg.errors.LockNotAvailable, psycopg.errors.DeadlockDetected)


class MigrationBlocked(Exception):
    """Another transaction kept a migration from its locks for too long. The text says what to do."""


class SchemaUnsupported(Exception):
    """The database has a schema that this program cannot use or upgrade. The text says what to do."""


@dataclass(frozen=True)
class LockTimeouts:
    """Timeout of one attempt to lock tables, and of all attempts of a revision."""

    # With half a second, a migration under the load of twenty clients got no locks in five minutes.
    attempt_s: float = 2.0
    # For all tables after the first.
    others_s: float = 1.0
    total_s: float = 600.0


def migrate(url: str, serving_role: str, timeouts: LockTimeouts = LockTimeouts()) -> list[str]:
    """Upgrade a database, given as SQLAlchemy URL, to this version; return the applied revisions.

    Revisions applied before one that fails stay applied. The timeouts limit waiting for locks, not a migration's work.

    Raises:
        MigrationBlocked: a revision did not get its locks in time.
        SchemaUnsupported: a later version or a development version made the schema.
    """
    engine = create_engine(url, poolclass=pool.NullPool)
    try:
        with engine.connect() as connection:
            _wait_for_other_migrators(connection)
            config = alembic_config(url, serving_role)
            config.attributes["connection"] = connection
            steps = _missing_revisions(connection, config)
            for step in steps:
                _apply(connection, config, step, timeouts)
            return [step.revision for step in steps]
    finally:
        engine.dispose()


def set_audit_retention(url: str, days: int) -> None:
    """Store for how many days the audit log is kept, 0 for ever; the serving role can only read it."""
    engine = create_engine(url, poolclass=pool.NullPool)
    try:
        with engine.begin() as connection:
            if days:  # one statement: migrators may run at once
                stmt = upsert(audit_retention).values(is_set=True, days=days)
                connection.execute(stmt.on_conflict_do_update(index_elements=["is_set"], set_={"days": days}))
            else:
                connection.execute(delete(audit_retention))
    finally:
        engine.dispose()


def _wait_for_other_migrators(connection: Connection) -> None:
    # A session lock: it spans the transactions that follow, and ends with the connection.
    is_logged = False
    while True:
        with connection.begin():
            if connection.execute(text("SELECT pg_try_advisory_lock(:lock)"), {"lock": LOCK}).scalar_one():
                return
        if not is_logged:
            _log.info("waiting for another migrator")
            is_logged = True
        time.sleep(_POLL_S)


def _missing_revisions(connection: Connection, config: Config) -> list[Script]:
    with connection.begin():
        current = MigrationContext.configure(connection).get_current_revision() or "base"
        problem = development_schema_problem(current)
        if current != "base" and current > HEAD:
            oldest = connection.execute(text("SELECT compatible_from FROM alembic_version")).scalar_one()
            problem = later_schema_problem(current, oldest)
            if problem is None:
                _log.warning(
                    "the schema is later than this program and compatible with it: nothing to do",
                    extra={"fields": {"revision": current}},
                )
                return []
        if problem is not None:
            raise SchemaUnsupported(f"Nothing was changed: {problem}.")
    steps = ScriptDirectory.from_config(config).iterate_revisions("head", current)
    return [*reversed([*steps])]


def _apply(connection: Connection, config: Config, step: Script, timeouts: LockTimeouts) -> None:
    revision, tables = step.revision, deque(getattr(step.module, "locked_tables", ()))
    start, pause_s = time.monotonic(), _FIRST_PAUSE_S
    while True:
        try:
            with connection.begin():
                _lock_tables(connection, tables, timeouts)
                command.upgrade(config, revision)
        except DBAPIError as error:  # noqa: PERF203  (retrying is what the loop is for)
            if not isinstance(error.orig, _LOCK_ERRORS):
                raise
            waited_s = time.monotonic() - start
            if waited_s + pause_s > timeouts.total_s:
                raise MigrationBlocked(_explain(revision, waited_s)) from error
            _log.warning("a table is in use; retrying", extra={"fields": {"revision": revision}})
            tables.rotate(1)
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
        else:
            _log.info("migrated", extra={"fields": {"revision": revision}})
            return


def _lock_tables(connection: Connection, tables: Sequence[str], timeouts: LockTimeouts) -> None:
    """Lock the tables that a revision changes: wait for the first, then try to get the others.

    A transaction that holds a table and waits for another one may be in a deadlock with a request, of which PostgreSQL
    ends either. This one waits only while it holds none.
    """
    connection.execute(text(f"SET LOCAL lock_timeout = {round(timeouts.attempt_s * 1000)}"))
    for table in [*tables][:1]:
        connection.execute(text(f"LOCK TABLE {table} IN ACCESS EXCLUSIVE MODE"))
    deadline = time.monotonic() + timeouts.others_s
    for table in [*tables][1:]:
        _lock_when_free(connection, table, deadline)


def _lock_when_free(connection: Connection, table: str, deadline: float) -> None:
    while True:
        try:
            with connection.begin_nested():
                connection.execute(text(f"LOCK TABLE {table} IN ACCESS EXCLUSIVE MODE NOWAIT"))
        except DBAPIError as error:  # noqa: PERF203  (retrying is what the loop is for)
            if not isinstance(error.orig, _LOCK_ERRORS) or time.monotonic() > deadline:
                raise
            time.sleep(_TRY_S)
        else:
            return


def _explain(revision: str, waited_s: float) -> str:
    list_sessions = "SELECT pid, application_name, xact_start FROM pg_stat_activity ORDER BY xact_start"
    return (
        f"Revision {revision} did not get its locks within {waited_s:.0f} s: another session keeps a transaction open. "
        f"`{list_sessions}` lists the sessions; end that one, then migrate again. Earlier revisions stay applied; this "
        "one changed nothing."
    )
