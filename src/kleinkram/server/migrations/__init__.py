"""Migrations: the database schema from nothing to this version, forward only, run by the role that owns the schema."""

from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import text
from sqlalchemy.exc import ProgrammingError

from kleinkram.server.db import Connection

if TYPE_CHECKING:
    from alembic.config import Config

_HERE = Path(__file__).parent
# ArrayText down, so that a process that only serves need not load Alembic to know them.
INITIAL = "0100"
HEAD = "0118"
# Revisions below INITIAL existed during development only; one migration replaced them.
_LAST_COMMIT_BEFORE_INITIAL = "530100f"


def alembic_config(url: str, serving_role: str) -> "Config":
    """Return Alembic's configuration for a database, given as SQLAlchemy URL with a synchronous driver."""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(_HERE))
    config.attributes["url"] = url
    config.attributes["serving_role"] = serving_role
    return config


async def schema_problem(db: Connection) -> str | None:
    """Explain why this program cannot use the database's schema, or return None if it can.

    It can use its own schema, and a later one whose oldest compatible program is this one or an earlier one.
    """
    try:
        row = (await db.execute(text("SELECT version_num, compatible_from FROM alembic_version"))).one_or_none()
    except ProgrammingError:  # no schema
        row = None
    if row is None or not row.version_num.isdecimal():
        return "the database has no schema: run `python -m kleinkram.server migrate`"
    if row.version_num == HEAD:
        return None
    if row.version_num > HEAD:
        return later_schema_problem(row.version_num, row.compatible_from)
    return (
        development_schema_problem(row.version_num)
        or "the database schema is older than this program: run `python -m kleinkram.server migrate` of this version"
    )


def development_schema_problem(revision: str) -> str | None:
    """Explain why a schema from before the initial migration cannot be upgraded; None for any other revision."""
    if not revision.isdecimal() or revision >= INITIAL:
        return None
    return (
        f"the database schema ({revision}) was made by a development version and cannot be upgraded; "
        f"open it with commit {_LAST_COMMIT_BEFORE_INITIAL}, the last one that can, and download the files you need"
    )


def later_schema_problem(revision: str, compatible_from: str | None) -> str | None:
    """Explain why this program cannot use a schema later than its own, or return None if it can."""
    if compatible_from is not None and compatible_from <= HEAD:
        return None
    return (
        f"the database schema ({revision}) is later than this program ({HEAD}) and not compatible with it; "
        "start the version that migrated it, or restore a backup made before; migrations only go forward"
    )
