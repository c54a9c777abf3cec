"""What the worker of a restored instance does first: compare the store with the database, and read every blob."""

import asyncio

from sqlalchemy import select

from kleinkram.server.blobs import queries, scrub
from kleinkram.server.blobs.readers import read_through
from kleinkram.server.blobs.scrub import scrub_store
from kleinkram.server.context import AppContext
from kleinkram.server.db import open_database
from kleinkram.server.s3.storage import open_storage
from kleinkram.server.settings import Settings
from kleinkram.server.tables import blob, person


def complaints(settings: Settings) -> list[str]:
    """Scrub, and read all blobs through as their verification does; return what is wrong with any."""

    async def go() -> list[str]:
        database = open_database(settings)
        try:
            async with open_storage(settings) as storage:
                context = AppContext(database, storage, settings)
                return [*await _scrub(context), *await _read(context)]
        finally:
            await database.close()

    return asyncio.run(go())


async def _scrub(context: AppContext) -> list[str]:
    async with context.database.begin() as db:
        anybody = (await db.execute(select(person.c.id).limit(1))).scalar_one()
        begun = await scrub.request_scrub(db, context.settings.store_id, by_id=anybody, accept_losses=False)
    await scrub_store(context, begun.id)
    async with context.database.begin() as db:
        last = await scrub.last_scrub(db, context.settings.store_id)
    assert last is not None
    assert last.ended_at is not None
    assert last.compared > 0
    result = {"aborted_reason": last.aborted_reason, "lost": last.lost, "corrupt": last.corrupt}
    return [f"{what}: {value}" for what, value in result.items() if value]


async def _read(context: AppContext) -> list[str]:
    async with context.database.begin() as db:
        ids = (await db.execute(select(blob.c.id).where(blob.c.marked_for_deletion_at.is_(None)))).scalars().all()
        rows = await db.execute(queries.blobs_with_path(ids))
        blobs = [queries.BlobRow._make(row) for row in rows]
    differences = [(row.key, (await read_through(context, row.key)).differs_from(row)) for row in blobs]
    return [f"{key}: {difference}" for key, difference in differences if difference]
