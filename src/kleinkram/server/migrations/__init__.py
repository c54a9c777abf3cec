"""Migrations: the schema from nothing to this version, forward only. Run by the role that owns the schema."""

from pathlib import Path

from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import text
from sqlalchemy.exc import ProgrammingError

from kleinkram.server.db import Connection

_HERE = Path(__file__).parent


def alembic_config(url: str, serving_role: str) -> Config:
    """Return Alembic's settings for a database, given as SQLAlchemy address with a synchronous driver."""
    config = Config()
    config.set_main_option("script_location", str(_HERE))
    config.attributes["url"] = url
    config.attributes["serving_role"] = serving_role
    return config


def _head() -> str:
    head = ScriptDirectory(str(_HERE)).get_current_head()
    if head is None:
        raise RuntimeError("this installation has no migrations")
    return head


HEAD = ScriptDirectory(str(_HERE)).get_current_head()


async def at_head(db: Connection) -> bool:
    """Say whether the database has this version's schema."""
    try:
        found = (await db.execute(text("SELECT version_num FROM alembic_version"))).scalars().all()
    except ProgrammingError:
        return False
    return found == [HEAD]
