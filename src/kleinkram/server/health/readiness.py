"""Whether this process can serve, and what is wrong beside it."""

import asyncio
from dataclasses import dataclass

from kleinkram.contract.errors import DatabaseUnavailable, StoreUnavailable
from kleinkram.server.db import Database
from kleinkram.server.health.worker_heartbeat import find_workers
from kleinkram.server.migrations import schema_problem
from kleinkram.server.s3.storage import Storage

_STORE_TIMEOUT_S = 2


@dataclass(frozen=True)
class Readiness:
    """What keeps this process from serving, in words; and what does not, but takes somebody to look at it.

    Without workers an API process serves all the same: were it "not ready", a load balancer would drop all of them.
    """

    missing: str | None
    warnings: tuple[str, ...] = ()


async def readiness(database: Database, storage: Storage) -> Readiness:
    """Return whether this process can serve.

    Takes one connection, and gives it back before the store is asked.
    """
    try:
        async with database.begin() as db:
            problem = await schema_problem(db)
            warning = None if problem else (await find_workers(db)).warning
        if problem:
            return Readiness(problem)
        await asyncio.wait_for(storage.check(), _STORE_TIMEOUT_S)
    except (DatabaseUnavailable, StoreUnavailable) as error:
        return Readiness(str(error))
    except asyncio.TimeoutError:
        return Readiness(f"the object store did not answer within {_STORE_TIMEOUT_S} seconds")
    return Readiness(None, (warning,) if warning else ())
