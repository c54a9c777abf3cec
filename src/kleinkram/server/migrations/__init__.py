"""Migrations: the schema from nothing to this version, forward only. Run by the role that owns the schema."""

from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import text
from sqlalchemy.exc import ProgrammingError

from kleinkram.server.db import Connection

if TYPE_CHECKING:
    from alembic.config import Config

_HERE = Path(__file__).parent
# The newest revision in `versions/`: written down, so that what only serves need not load the migrator to know it.
HEAD = "0028"


def alembic_config(url: str, serving_role: str) -> "Config":
    """Return Alembic's settings for a database, given as SQLAlchemy address with a synchronous driver."""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(_HERE))
    config.attributes["url"] = url
    config.attributes["serving_role"] = serving_role
    return config


async def schema_problem(db: Connection) -> str | None:
    """Return in words why this program cannot work on the database's schema, or None where it can.

    It can on its own schema and on a later one that names this program's revision, or an earlier one, as compatible.
    """
    try:
        row = (await db.execute(text("SELECT version_num, compatible_from FROM alembic_version"))).one_or_none()
    except ProgrammingError:  # no schema, or one from before it named compatible programs
        row = None
    if row is None or not row.version_num.isdecimal() or row.version_num < HEAD:
        return "the database schema is older than this program; run the migrations"
    return None if row.version_num == HEAD else later_schema_problem(row.version_num, row.compatible_from)


def later_schema_problem(revision: str, compatible_from: str | None) -> str | None:
    """Return in words why this program cannot work on a schema later than its own, or None where it can."""
    if compatible_from is not None and compatible_from <= HEAD:
        return None
    return (
        f"the database schema ({revision}) is later than this program ({HEAD}) and not compatible with it; "
        "start the version that migrated it, or restore a backup made before; migrations only go forward"
    )
