"""Whether this process can serve."""

import asyncio

from kleinkram.contract.errors import DatabaseUnavailable, StoreUnavailable
from kleinkram.server.db import Database
from kleinkram.server.migrations import at_head
from kleinkram.server.storage import Storage

_STORE_TIMEOUT_S = 2


async def missing(database: Database, storage: Storage) -> str | None:
    """Return in words what keeps this process from serving, or None when nothing does.

    Takes one connection, and gives it back before the store is asked.
    """
    try:
        async with database.begin() as db:
            current = await at_head(db)
        if not current:
            return "the database schema is not this version's; run the migrations"
        await asyncio.wait_for(storage.check(), _STORE_TIMEOUT_S)
    except (DatabaseUnavailable, StoreUnavailable) as error:
        return str(error)
    except asyncio.TimeoutError:
        return f"the object store did not answer within {_STORE_TIMEOUT_S} seconds"
    return None
