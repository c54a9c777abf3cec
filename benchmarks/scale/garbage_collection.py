"""Collects garbage until nothing is left, as its own process: `python -m benchmarks.scale.garbage_collection`.

Prints the number of rounds. The environment is the worker's.
"""

import asyncio
import os

from sqlalchemy import func, select

from kleinkram.server.context import AppContext
from kleinkram.server.db import open_database
from kleinkram.server.maintenance import collect_garbage
from kleinkram.server.s3.storage import open_storage
from kleinkram.server.settings import Settings
from kleinkram.server.tables import mission

# At low priority, as in the worker.
_NICENESS = 10


async def main() -> int:
    """Collect in rounds; return the number of rounds."""
    settings = Settings()
    database = open_database(settings)
    rounds = 0
    # A mission is deleted in the round after its last file.
    due = (
        select(mission.c.id)
        .where(mission.c.deleted_at < func.now() - func.make_interval(0, 0, 0, settings.trash_days))
        .limit(1)
    )
    async with open_storage(settings) as storage:
        while True:
            async with database.begin() as db:
                if (await db.execute(due)).first() is None:
                    break
            await collect_garbage(AppContext(database, storage, settings))
            rounds += 1
    await database.close()
    return rounds


if __name__ == "__main__":
    os.nice(_NICENESS)
    print(asyncio.run(main()))
