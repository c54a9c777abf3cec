"""Bringing a database to this version's schema while others use it: they wait for seconds at most, and nothing is lost.

One migrator at a time: the others wait for it, and find nothing left to do. Each revision is one transaction. One that
does not get its locks within moments gives up its place, so that those behind it go on, and tries again later.
"""

import logging
import time
from dataclasses import dataclass

import psycopg
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, create_engine, pool, text
from sqlalchemy.exc import DBAPIError

from kleinkram.server.migrations import HEAD, alembic_config, later_schema_problem

_log = logging.getLogger("kleinkram.migrations")
# Others of this database's migrators wait for each other on it.
LOCK = 0x6B6C65696E
_LOOK_S = 0.2
_PAUSE_S = 0.5
_LONGEST_PAUSE_S = 10.0
_IN_THE_WAY = (psycopg.errors.LockNotAvailable, psycopg.errors.DeadlockDetected)


class MigrationBlocked(Exception):
    """Somebody kept a migration from its locks for too long. The text says what to do."""


class SchemaTooNew(Exception):
    """The database has a schema that this program neither knows nor works with. The text says what to do."""


@dataclass(frozen=True)
class Patience:
    """How long a migration keeps others waiting for a lock that it wants, and how often it tries before it gives up."""

    lock_s: float = 2.0
    whole_s: float = 600.0


def migrate(url: str, serving_role: str, patience: Patience = Patience()) -> list[str]:
    """Bring a database, given as SQLAlchemy address, to this version; return the revisions that it took.

    What was taken stays, whatever happens to the next one. A revision that needs minutes of its own takes them.

    Raises:
        MigrationBlocked: a lock could not be had for as long as patience lasts.
        SchemaTooNew: a later version migrated the database, and this one does not work with its schema.
    """
    engine = create_engine(url, poolclass=pool.NullPool)
    try:
        with engine.connect() as connection:
            _wait_for_others(connection)
            config = alembic_config(url, serving_role)
            config.attributes["connection"] = connection
            taken = _missing(connection, config)
            for revision in taken:
                _take(connection, config, revision, patience)
            return taken
    finally:
        engine.dispose()


def _wait_for_others(connection: Connection) -> None:
    # Held by the session, over all transactions that follow; it goes with the connection.
    is_told = False
    while True:
        with connection.begin():
            if connection.execute(text("SELECT pg_try_advisory_lock(:lock)"), {"lock": LOCK}).scalar_one():
                return
        if not is_told:
            _log.info("another migrator is at work; waiting for it")
            is_told = True
        time.sleep(_LOOK_S)


def _missing(connection: Connection, config: Config) -> list[str]:
    with connection.begin():
        at = MigrationContext.configure(connection).get_current_revision() or "base"
        if at != "base" and at > HEAD:
            return _nothing_to_do(connection, at)
    steps = ScriptDirectory.from_config(config).iterate_revisions("head", at)
    return [step.revision for step in reversed([*steps])]


def _nothing_to_do(connection: Connection, at: str) -> list[str]:
    oldest = connection.execute(text("SELECT compatible_from FROM alembic_version")).scalar_one()
    problem = later_schema_problem(at, oldest)
    if problem is not None:
        raise SchemaTooNew(f"Nothing was changed: {problem}.")
    _log.warning(
        "the schema is later than this program, and compatible with it: nothing to do",
        extra={"fields": {"revision": at}},
    )
    return []


def _take(connection: Connection, config: Config, revision: str, patience: Patience) -> None:
    began, pause_s = time.monotonic(), _PAUSE_S
    while True:
        try:
            with connection.begin():
                connection.execute(text(f"SET LOCAL lock_timeout = {round(patience.lock_s * 1000)}"))
                command.upgrade(config, revision)
        except DBAPIError as error:  # noqa: PERF203  (what comes between tries is what this is for)
            if not isinstance(error.orig, _IN_THE_WAY):
                raise
            waited_s = time.monotonic() - began
            if waited_s + pause_s > patience.whole_s:
                raise MigrationBlocked(_advice(revision, waited_s)) from error
            _log.warning("a table is in use; trying again", extra={"fields": {"revision": revision}})
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
        else:
            _log.info("migrated", extra={"fields": {"revision": revision}})
            return


def _advice(revision: str, waited_s: float) -> str:
    who = "SELECT pid, application_name, xact_start FROM pg_stat_activity ORDER BY xact_start"
    said = f"Revision {revision} did not get its locks within {waited_s:.0f} s: somebody keeps a transaction open. "
    return f"{said}`{who}` names them; end it, then migrate again. All before it is done, and nothing is half done."
