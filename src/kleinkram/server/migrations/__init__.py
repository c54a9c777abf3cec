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


async def at_head(db: Connection) -> bool:
    """Say whether the database has this version's schema."""
    try:
        found = (await db.execute(text("SELECT version_num FROM alembic_version"))).scalars().all()
    except ProgrammingError:
        return False
    return found == [HEAD]
