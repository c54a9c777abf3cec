"""Concurrent requests: rows are locked until all requests wait, then released."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import psycopg

from tests.integration.api_server import Api
from tests.integration.upload_client import wait_until

Send = Callable[..., "Future[Any]"]
_WAITING = "SELECT count(*) FROM pg_locks WHERE NOT granted"


@contextmanager
def racing(api: Api, holding: str, *values: Any) -> Iterator[Send]:
    """Hold what a statement locks; what is sent meanwhile waits, one after the other, and goes on at the end."""
    info = api.database.info
    count = 0
    with ThreadPoolExecutor(max_workers=8) as pool, psycopg.connect(info.dsn, password=info.password) as holder:
        holder.execute(holding, values)

        def send(work: Callable[..., Any], *arguments: Any) -> "Future[Any]":
            nonlocal count
            count += 1
            future = pool.submit(work, *arguments)
            wait_until(lambda: future.done() or api.sql(_WAITING)[0][0] >= count)
            assert not future.done(), f"it did not wait: {future.result()}"
            return future

        yield send
        holder.rollback()
