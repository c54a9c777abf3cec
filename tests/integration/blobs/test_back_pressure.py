"""Background jobs yield to uploads, for a bounded time."""

import asyncio
import time
import uuid
from collections.abc import Awaitable, Callable

import pytest

from kleinkram.server.context import AppContext
from kleinkram.server.jobs.execution import BackPressure
from kleinkram.server.overviews import jobs as derivation_jobs
from kleinkram.server.recordings.derive import derive_again
from tests.integration.api_server import Api
from tests.integration.jobs import drain, on_site
from tests.integration.upload_client import begin

_LONG_S = 3600.0
_Work = Callable[[BackPressure], Awaitable[None]]


@pytest.fixture(name="api", scope="module")
def _api(start_api: Callable[[], Api]) -> Api:
    """An API of its own, to which no other test uploads."""
    return start_api()


@pytest.fixture(name="upload_id")
def _upload_id(api: Api) -> str:
    api.sql("UPDATE upload SET state = 'aborted'")
    mission_id = str(api.mission(api.project()["id"])["id"])
    upload_id = str(begin(api, mission_id, {"a.bin": b"a"})[0]["upload"]["id"])
    # As if its client asked for an address again and again, for an hour.
    api.sql("UPDATE upload SET renewed_at = renewed_at + interval '1 h' WHERE id = %s", upload_id)
    return upload_id


def _with_back_pressure(api: Api, work: _Work) -> None:
    async def on(context: AppContext) -> None:
        await work(BackPressure(context.database))

    on_site(api, on)


async def _waits(back_pressure: BackPressure) -> None:
    with pytest.raises(asyncio.TimeoutError):
        await asyncio.wait_for(back_pressure.wait_for_uploads(_LONG_S), 0.8)


async def _goes(back_pressure: BackPressure) -> None:
    await asyncio.wait_for(back_pressure.wait_for_uploads(_LONG_S), 10)


def test_background_jobs_wait_during_uploads(api: Api, upload_id: str) -> None:
    _with_back_pressure(api, _waits)
    api.delete(f"/uploads/{upload_id}").ok(204)
    _with_back_pressure(api, _goes)


def test_an_abandoned_upload_delays_no_job(api: Api, upload_id: str) -> None:
    api.sql("UPDATE upload SET renewed_at = renewed_at - interval '1 h 3 s' WHERE id = %s", upload_id)
    _with_back_pressure(api, _goes)


def test_continuous_uploads_delay_a_job_by_its_maximum_wait(api: Api, upload_id: str) -> None:
    async def twice(back_pressure: BackPressure) -> None:
        started = time.monotonic()
        await back_pressure.wait_for_uploads(0.7)
        assert time.monotonic() - started >= 0.7
        [created_at] = api.sql("SELECT created_at - interval '1 h' FROM upload WHERE id = %s", upload_id)[0]
        await asyncio.wait_for(back_pressure.wait_for_uploads(_LONG_S, since=created_at), 10)

    _with_back_pressure(api, twice)


def test_jobs_past_their_maximum_wait_run_one_at_a_time_during_uploads(api: Api, upload_id: str) -> None:
    async def several(back_pressure: BackPressure) -> None:
        started = time.monotonic()
        await asyncio.wait_for(asyncio.gather(*(back_pressure.wait_for_uploads(0) for _ in range(4))), 10)
        assert time.monotonic() - started >= 0.6
        api.delete(f"/uploads/{upload_id}").ok(204)
        await asyncio.wait_for(asyncio.gather(*(back_pressure.wait_for_uploads(0) for _ in range(1000))), 60)

    _with_back_pressure(api, several)


def test_a_worker_that_stops_waits_for_nobody(api: Api, upload_id: str) -> None:
    async def stop(back_pressure: BackPressure) -> None:
        waiting = asyncio.create_task(back_pressure.wait_for_uploads(_LONG_S))
        await _waits(back_pressure)
        back_pressure.end()
        await asyncio.wait_for(waiting, 10)

    _with_back_pressure(api, stop)


def test_grouping_is_delayed_from_the_time_of_its_request(
    api: Api, upload_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(derivation_jobs, "SUMMARY_MAX_WAIT_S", _LONG_S)
    mission_id = uuid.UUID(api.mission(api.project()["id"])["id"])

    async def ask(context: AppContext) -> None:
        async with context.database.begin() as db:
            await derive_again(db, mission_id)

    async def work(context: AppContext) -> None:
        await asyncio.wait_for(drain(context, BackPressure(context.database)), 20)

    on_site(api, ask)
    api.sql("UPDATE procrastinate_events SET at = at - interval '2 h'")
    on_site(api, work)
    current = "SELECT derived_revision = files_revision FROM mission WHERE id = %s"
    assert api.sql(current, mission_id) == [(True,)]
    assert upload_id
