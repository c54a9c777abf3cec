"""Direct access to the database and the store of a running `klein up`."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar
from urllib.parse import quote

import psycopg

from kleinkram.server.context import AppContext
from kleinkram.server.db import open_database
from kleinkram.server.maintenance import collect_garbage, maintain_runs
from kleinkram.server.s3.storage import open_storage
from kleinkram.server.settings import Settings
from kleinkram.server.uploads.jobs import maintain_uploads
from kleinkram.standalone.data_dir import DataDir, load_secrets
from kleinkram.standalone.postgres import DATABASE, SERVE
from tests.system.cluster import Cluster

T = TypeVar("T")
# Start-up probes write and delete small objects. A kill between the two leaves one behind.
_PROBES = ("probe/", ".kleinkram-probe")


def sql(cluster: Cluster, statement: str, *values: object) -> list[tuple[Any, ...]]:
    """Run a statement in its database."""
    with psycopg.connect(_database_url(cluster)) as connection:
        return connection.execute(statement, values).fetchall()


def tidy(cluster: Cluster) -> None:
    """Run the worker's periodic jobs now: uploads, runs, garbage collection."""

    async def run_jobs(context: AppContext) -> None:
        await maintain_uploads(context, stale_after_s=0)
        await maintain_runs(context)
        for _ in range(2):
            await collect_garbage(context)

    run_in_context(cluster, run_jobs)


def objects(cluster: Cluster) -> dict[str, int]:
    """Return the sizes of the objects in its store by key, without those of start-up probes."""
    sizes = run_in_context(cluster, lambda context: context.storage.sizes(""))
    return {key: size for key, size in sizes.items() if not key.startswith(_PROBES)}


def list_multiparts(cluster: Cluster) -> list[tuple[str, str]]:
    """Return the multipart uploads in progress in its store."""
    uploads = run_in_context(cluster, lambda context: context.storage.list_multiparts(""))
    return [(key, multipart_id) for key, multipart_id in uploads if not key.startswith(_PROBES)]


def stored_bytes(cluster: Cluster) -> int:
    """Return the bytes in its store, including parts of unfinished uploads."""

    async def count_bytes(context: AppContext) -> int:
        while True:
            objects = await context.storage.sizes("")
            parts = [
                await context.storage.list_parts(*upload) or [] for upload in await context.storage.list_multiparts("")
            ]
            # An upload that is joined during the count would be counted twice, as parts and as an object.
            if await context.storage.sizes("") == objects:
                return sum(objects.values()) + sum(part.size_bytes for upload_parts in parts for part in upload_parts)

    return run_in_context(cluster, count_bytes)


def run_in_context(cluster: Cluster, work: Callable[[AppContext], Awaitable[T]]) -> T:
    """Run a function with its database and its store, as a job would."""
    secrets = load_secrets(DataDir(cluster.data_dir))
    settings = Settings(
        database_url=_database_url(cluster),
        s3_internal_url=cluster.runtime_info()["store_url"],
        s3_access_key=secrets.s3_access_key,
        s3_secret_key=secrets.s3_secret_key,
        garbage_grace_s=0,
    )

    async def run() -> T:
        database = open_database(settings)
        try:
            async with open_storage(settings) as storage:
                return await work(AppContext(database, storage, settings))
        finally:
            await database.close()

    return asyncio.run(run())


def _database_url(cluster: Cluster) -> str:
    password = quote(load_secrets(DataDir(cluster.data_dir)).postgres_serve)
    return f"postgresql://{SERVE}:{password}@127.0.0.1:{cluster.runtime_info()['ports']['postgres']}/{DATABASE}"
