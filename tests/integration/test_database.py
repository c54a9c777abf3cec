"""Failed transactions are classified and, where possible, retried."""

import asyncio
from typing import Any

import pytest
from sqlalchemy import text
from sqlalchemy.exc import DBAPIError

from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.server import db
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, Database, open_database
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site
from tests.integration.races import racing


async def _run(database: Database, statement: str) -> str:
    async with database.begin() as connection:
        return str((await connection.execute(text(statement))).scalar_one())


@pytest.mark.parametrize("state", ["40P01", "40001", "57014", "57P01", "55P03"])
def test_retryable_errors_are_marked(api: Api, state: str) -> None:
    async def work(context: AppContext) -> None:
        with pytest.raises(DatabaseUnavailable):
            await _run(context.database, f"DO $$ BEGIN RAISE SQLSTATE '{state}'; END $$")

    on_site(api, work)


def test_a_statement_that_takes_too_long_is_ended(api: Api) -> None:
    async def work(context: AppContext) -> None:
        database = open_database(context.settings, statement_timeout_s=0.05)
        try:
            with pytest.raises(DatabaseUnavailable):
                await asyncio.wait_for(_run(database, "SELECT pg_sleep(20)"), 10)
        finally:
            await database.close()

    on_site(api, work)


@pytest.mark.parametrize(("timeout_s", "shown"), [(30, "30s"), (None, "0")])
def test_the_statement_timeout_is_ours_or_the_databases(api: Api, timeout_s: float | None, shown: str) -> None:
    async def work(context: AppContext) -> str:
        address = f"{context.settings.database_url}?options=-c%20lock_timeout%3D7s"
        settings = context.settings.model_copy(update={"database_url": address})
        database = open_database(settings, statement_timeout_s=timeout_s)
        try:
            return await _run(
                database,
                "SELECT concat_ws(' ', current_setting(s), current_setting('lock_timeout'))"
                " FROM (VALUES ('statement_timeout')) v(s)",
            )
        finally:
            await database.close()

    assert on_site(api, work) == f"{shown} 7s"


def test_a_request_without_a_free_connection_gets_503(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(db, "_POOL_TIMEOUT_S", 0.2)
    api = start_api(database_connections=2)
    project = api.project()["id"]
    with racing(api, "SELECT 1 FROM project WHERE id = %s FOR UPDATE", project) as send:
        waiting = [send(api.patch, f"/projects/{project}", {"description": description}) for description in "ab"]
        answer = api.get("/projects")
    answer.refused(503, "database_unavailable")
    assert answer.headers["retry-after"]
    assert [description.result().status for description in waiting] == [200, 200]


def test_closed_connections_are_replaced(api: Api) -> None:
    """It is noticed without asking: whoever comes next waits for a new connection, and hears of nothing."""

    async def work(context: AppContext) -> None:
        database = open_database(context.settings.model_copy(update={"database_connections": 1}))
        try:
            mine = await _run(database, "SELECT pg_backend_pid()")
            assert await _run(database, "SELECT pg_backend_pid()") == mine
            await _run(context.database, f"SELECT pg_terminate_backend({mine}, 5000)")
            assert await _run(database, "SELECT pg_backend_pid()") != mine
        finally:
            await database.close()

    on_site(api, work)


async def _ids(connection: Connection) -> list[str]:
    return [str((await connection.execute(text("SELECT pg_current_xact_id()"))).scalar_one()) for _ in range(2)]


async def _fails(connection: Connection) -> None:
    await connection.execute(text("SELECT 1 / 0"))


async def _is_cancelled(connection: Connection) -> None:
    await asyncio.wait_for(connection.execute(text("SELECT pg_sleep(20)")), 0.2)


async def _raises(connection: Connection) -> None:
    await connection.execute(text("SET LOCAL work_mem = '1MB'"))
    raise ValueError


@pytest.mark.parametrize("trouble", [None, _fails, _is_cancelled, _raises])
@pytest.mark.parametrize("how", [Database.begin, Database.autocommit])
def test_autocommit_statements_start_no_transaction(api: Api, how: Any, trouble: Any) -> None:
    """And the connection is as it was for whoever takes it next, whatever became of what it was taken for."""

    async def work(context: AppContext) -> None:
        database = open_database(context.settings.model_copy(update={"database_connections": 1}))
        try:
            if trouble is not None:
                with pytest.raises((DBAPIError, asyncio.TimeoutError, ValueError)):
                    async with how(database) as connection:
                        await trouble(connection)
            for _ in range(2):
                async with database.autocommit() as connection:
                    first, second = await _ids(connection)
                assert first != second
                async with database.begin() as connection:
                    first, second = await _ids(connection)
                assert first == second
        finally:
            await database.close()

    on_site(api, work)


def test_single_reads_are_retried_too(api: Api) -> None:
    async def work(context: AppContext) -> None:
        with pytest.raises(DatabaseUnavailable):
            async with context.database.autocommit() as connection:
                await connection.execute(text("DO $$ BEGIN RAISE SQLSTATE '57P01'; END $$"))

    on_site(api, work)
