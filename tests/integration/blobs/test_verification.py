"""Reading an object completely: connections are returned, and damage is distinguished from store failures."""

import os
from collections.abc import Iterator
from itertools import chain, repeat
from typing import Any

import pytest

from kleinkram.server.blobs.readers import read_through
from kleinkram.server.context import AppContext
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.fault_proxy import Cut, Middleman, ProxiedRequest, Reply, Rule, standing_before
from tests.integration.jobs import on_site, run_jobs
from tests.integration.upload_client import upload
from tests.services import RunningStore


def test_a_reader_that_stops_early_gives_its_connection_back_at_once(api: Api) -> None:
    body = bytes(5_000_000)
    file = upload(api, str(api.mission(api.project()["id"])["id"]), "long.bin", body)
    [(key,)] = api.sql("SELECT b.key FROM blob b JOIN file f ON f.blob_id = b.id WHERE f.id = %s", file["id"])

    async def stop(_piece: bytes) -> None:
        raise RuntimeError("enough")

    async def work(context: AppContext) -> None:
        with pytest.raises(RuntimeError, match="enough"):
            await read_through(context, key, stop)
        connector = context.storage._client._session.connector
        assert connector is not None
        assert len(connector._acquired) == 0
        assert (await read_through(context, key)).size_bytes == len(body)

    on_site(api, work)


@pytest.fixture(name="middleman", scope="module")
def _middleman(store: RunningStore) -> Iterator[Middleman]:
    with standing_before(store.endpoint) as middleman:
        yield middleman


@pytest.fixture(name="troubled", scope="module")
def _troubled(start_api: StartApi, middleman: Middleman) -> Api:
    """An API whose store can be made to fail."""
    return start_api(s3_internal_url=middleman.url)


def _uploaded(api: Api, size_bytes: int) -> tuple[Any, str]:
    """A file that is not verified yet, and the key of its object."""
    file = upload(api, str(api.mission(api.project()["id"])["id"]), "drive.bin", os.urandom(size_bytes))
    [(key,)] = api.sql("SELECT b.key FROM blob b JOIN file f ON f.blob_id = b.id WHERE f.id = %s", file["id"])
    return file, key


_FAILURE = Reply(500, "InternalError")


def _fails_at(key: str, first: Reply | Cut, then: Reply | Cut) -> Rule:
    """Answer the first request for an object, and those that follow."""
    answers: Iterator[Reply | Cut] = chain([first], repeat(then))
    return lambda requested: next(answers) if requested.method == "GET" and requested.key == key else None


@pytest.mark.parametrize("answer", [_FAILURE, Cut()], ids=["not opened", "broken off"])
@pytest.mark.parametrize("size_bytes", [3_000, 6_000_000], ids=["small", "large"])
def test_an_object_that_the_store_cannot_return_is_damaged_at_once(
    troubled: Api, middleman: Middleman, answer: Reply | Cut, size_bytes: int
) -> None:
    file, key = _uploaded(troubled, size_bytes)
    middleman.rule = _fails_at(key, answer, _FAILURE)
    try:
        run_jobs(troubled)
    finally:
        middleman.rule = lambda _requests: None
    seen = troubled.get(f"/files/{file['id']}").ok()
    assert seen["state"] == "corrupt"
    assert "serves others" in seen["state_reason"]
    troubled.post(f"/files/{file['id']}/verify").ok(202)
    run_jobs(troubled)
    assert troubled.get(f"/files/{file['id']}").ok()["state"] == "verified", "the store was at fault, and is no more"


def test_connections_that_break_off_damage_no_object(troubled: Api, middleman: Middleman) -> None:
    file, key = _uploaded(troubled, 3_000)
    middleman.rule = _fails_at(key, Cut(), Cut())
    try:
        run_jobs(troubled)
    finally:
        middleman.rule = lambda _requests: None
    assert troubled.get(f"/files/{file['id']}").ok()["state"] == "stored"


def _all_fail(requested: ProxiedRequest) -> Reply | None:
    return _FAILURE if requested.method == "GET" and "list-type" not in requested.query else None


def test_a_store_that_returns_nothing_damages_no_object(troubled: Api, middleman: Middleman) -> None:
    file, _ = _uploaded(troubled, 3_000)
    middleman.rule = _all_fail
    try:
        run_jobs(troubled)
    finally:
        middleman.rule = lambda _requests: None
    assert troubled.get(f"/files/{file['id']}").ok()["state"] == "stored"
    [(attempts,)] = troubled.sql(
        "SELECT max(attempts) FROM procrastinate_jobs JOIN file f ON f.blob_id::text = args ->> 'ref' WHERE f.id = %s",
        file["id"],
    )
    assert attempts >= 1, "it is tried again"


def test_requesting_a_verification_does_not_wait_for_a_retry(troubled: Api, middleman: Middleman) -> None:
    file, _ = _uploaded(troubled, 3_000)
    troubled.sql("DELETE FROM procrastinate_jobs")
    [(blob_id,)] = troubled.sql("SELECT blob_id::text FROM file WHERE id = %s", file["id"])
    troubled.sql(
        "SELECT procrastinate_defer_jobs_v1(ARRAY[ROW('verification', 'verify_blob', -10, NULL, NULL,"
        " jsonb_build_object('ref', %s::text), now() + interval '1 day')::procrastinate_job_to_defer_v1])",
        blob_id,
    )
    troubled.post(f"/files/{file['id']}/verify").ok(202)
    [(due, priority)] = troubled.sql("SELECT coalesce(scheduled_at, now()) <= now(), priority FROM procrastinate_jobs")
    assert due
    assert priority > 0
