"""Every metric of the server is exported as it is defined, and counts what it says."""

import asyncio
import datetime
import uuid
from collections.abc import Iterator

import pytest
import urllib3

from kleinkram import metric_definitions as definitions
from kleinkram.contract.access import Scope, TokenKind
from kleinkram.metric_definitions import DEFINITIONS, MetricKind, MetricSource
from kleinkram.server import metrics
from kleinkram.server.backup import operations
from kleinkram.server.db import Database, open_database
from kleinkram.server.health import metrics_server
from kleinkram.server.health.metrics_server import serve_metrics
from kleinkram.server.http import rate_limit
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.event_client import listening
from tests.integration.exposition import assert_accepted_by_promtool, assert_defined, value
from tests.integration.jobs import run_jobs
from tests.integration.runs.conftest import FakeRunner, launch
from tests.integration.upload_client import upload, wait_until

_NOTHING = "00000000-0000-4000-8000-000000000000"
_BODY = b"the bytes of a file, in two missions"


@pytest.fixture(scope="module")
def lab(start_api: StartApi, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """An API that allows one verification in a window that does not end meanwhile, and knows its store's disk."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(rate_limit, "_WINDOW", rate_limit._WINDOW * 60 * 24 * 365)
        yield start_api(verifications_per_minute=1, store_folder=tmp_path_factory.mktemp("store"))


def _worker_metrics(api: Api) -> str:
    """Return what a worker in this process exports."""

    async def scrape() -> str:
        settings = api.app.state.settings
        database = open_database(settings)
        try:
            async with serve_metrics(settings, database, MetricSource.worker) as port:
                answer = await asyncio.to_thread(urllib3.request, "GET", f"http://127.0.0.1:{port}/metrics")
                return answer.data.decode()
        finally:
            await database.close()

    return asyncio.run(scrape())


def _run(api: Api, mission: object) -> None:
    """Launch a run, and be the runner that executes it."""
    admin = people.person(api, admin=True)
    runner = FakeRunner(api.as_(people.token(api, admin, [Scope.run], kind=TokenKind.runner).secret))
    runner.register()
    launch(api, runner, mission)
    claim = runner.claim()
    runner.heartbeat(claim)
    runner.finish(claim).ok()


def test_api_and_worker_export_every_metric_as_it_is_defined(lab: Api) -> None:
    mission = lab.mission(lab.project()["id"])
    with listening(lab) as ears:
        file = upload(lab, mission["id"], "a.bin", _BODY)
        ears.receive(resource_type="file", id=file["id"])
        run_jobs(lab)
    upload(lab, lab.mission(lab.project()["id"])["id"], "again.bin", _BODY)
    lab.post("/files/download", {"file_ids": [file["id"]]}).ok()
    _run(lab, mission)
    lab.as_("klein_unknown").get("/projects").refused(401, "not_authenticated")
    for status in (404, 429):
        assert lab.post(f"/files/{_NOTHING}/verify").status == status
    lab.sql("INSERT INTO scrub (id, store_id, ended_at) VALUES (gen_random_uuid(), 'main', now())")
    job = "INSERT INTO procrastinate_jobs (queue_name, task_name, attempts, scheduled_at, args) VALUES"
    lab.sql(f"{job} ('default', 'collect_garbage', 2, now() + interval '1 h', '{{}}')")
    shared = (MetricSource.process, MetricSource.server)
    assert_defined(lab.metrics(), *shared, MetricSource.api, MetricSource.instance)
    assert_defined(_worker_metrics(lab), *shared, MetricSource.worker)


@pytest.mark.slow
def test_promtool_accepts_the_metrics_of_api_and_worker(lab: Api) -> None:
    assert_accepted_by_promtool(lab.metrics())
    assert_accepted_by_promtool(_worker_metrics(lab))


def test_bytes_in_and_out_are_counted(lab: Api) -> None:
    before = lab.metrics()
    body = uuid.uuid4().bytes * 4
    file = upload(lab, lab.mission(lab.project()["id"])["id"], "a.bin", body)
    run_jobs(lab)
    upload(lab, lab.mission(lab.project()["id"])["id"], "again.bin", body)
    lab.post("/files/download", {"file_ids": [file["id"]]}).ok()
    after = lab.metrics()
    for definition, labels in (
        (definitions.UPLOAD_BYTES, {"result": "stored"}),
        (definitions.UPLOAD_BYTES, {"result": "linked"}),
        (definitions.DOWNLOAD_BYTES, {}),
    ):
        assert value(after, definition, **labels) - value(before, definition, **labels) == 64
    assert value(after, definitions.DOWNLOAD_FILES) - value(before, definitions.DOWNLOAD_FILES) == 1
    assert value(after, definitions.STORE_READ_BYTES) - value(before, definitions.STORE_READ_BYTES) >= 64


def test_refusals_are_counted_by_their_reason(lab: Api) -> None:
    before = lab.metrics()
    lab.as_("klein_unknown").get("/projects").refused(401, "not_authenticated")
    lab.get(f"/projects/{_NOTHING}").refused(404, "not_found")
    after = lab.metrics()
    for definition, labels in (
        (definitions.SIGN_IN_REFUSALS, {"reason": "not_authenticated"}),
        (definitions.PROBLEMS, {"code": "not_authenticated"}),
        (definitions.PROBLEMS, {"code": "not_found"}),
    ):
        assert value(after, definition, **labels) - value(before, definition, **labels) == 1
    assert value(after, definitions.SIGN_IN_REFUSALS) - value(before, definitions.SIGN_IN_REFUSALS) == 1


def test_requests_that_wait_do_not_count_as_slow(lab: Api) -> None:
    mission = lab.mission(lab.project()["id"])
    upload(lab, mission["id"], "a.bin", _BODY)
    admin = people.person(lab, admin=True)
    runner = FakeRunner(lab.as_(people.token(lab, admin, [Scope.run], kind=TokenKind.runner).secret))
    runner.register()
    routes = [f"/api/v1{path}" for path in ("/runners/{runner_id}/claims", "/runs/{run_id}/log")]
    counters = (definitions.REQUESTS, definitions.REQUEST_SECONDS)

    def counts() -> list[list[float]]:
        # Other tests in this process have made requests, too.
        text = lab.metrics()
        return [[value(text, counter, route=route) for counter in counters] for route in routes]

    before = counts()
    assert runner.claim(wait_s=0.2) is None
    run = launch(lab, runner, mission)
    path = f"/runs/{run['id']}/log"
    lab.get(path, {"wait_s": "0.2"}).ok()
    between = counts()
    for (requests, durations), (more_requests, same_durations) in zip(before, between, strict=True):
        assert more_requests > requests
        assert same_durations == durations
    lab.get(path).ok()
    assert counts()[1][1] - between[1][1] == 1
    lab.post(f"/runs/{run['id']}/cancel").ok()


def test_quotas_and_the_trash_are_measured(start_api: StartApi) -> None:
    api = start_api()
    project = api.project()
    api.patch(f"/projects/{project['id']}", {"quota_bytes": 100}).ok()
    mission = api.mission(project["id"])["id"]
    upload(api, mission, "a.bin", b"a" * 95)
    api.patch(f"/projects/{api.project()['id']}", {"quota_bytes": 0}).ok()  # nothing can fill it
    gone = upload(api, api.mission(api.project()["id"])["id"], "gone.bin", b"g" * 30)
    api.delete(f"/files/{gone['id']}").ok()
    text = api.metrics()
    assert value(text, definitions.QUOTA_USED_RATIO, unit="bytes") == 0.95
    assert value(text, definitions.PROJECTS_NEAR_QUOTA, unit="bytes") == 1
    assert value(text, definitions.PROJECTS_NEAR_QUOTA, unit="files") == 0
    assert value(text, definitions.TRASH_BYTES) == 30
    assert value(text, definitions.FILES) == 1
    assert value(text, definitions.STORED_BYTES) == 125


def test_blobs_that_are_marked_for_deletion_are_counted_apart(start_api: StartApi) -> None:
    api = start_api()
    file = upload(api, api.mission(api.project()["id"])["id"], "a.bin", b"a" * 40)
    api.sql("DELETE FROM file WHERE id = %s", file["id"])
    api.sql("UPDATE blob SET marked_for_deletion_at = now()")
    text = api.metrics()
    assert value(text, definitions.MARKED_FOR_DELETION_BYTES) == 40
    assert value(text, definitions.STORED_BYTES) == value(text, definitions.BLOBS) == 0


def test_the_age_of_the_last_backup_is_reported(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metrics_server, "_HOLDS_S", -1)
    monkeypatch.setattr("kleinkram.server.health.readiness._LOOKUP_TIME_FACTOR", 0)
    api = start_api()
    text = api.metrics()
    assert value(text, definitions.BACKUP_LAST_SUCCESS) == value(text, definitions.BACKUP_LAST_ATTEMPT) == 0
    settings = api.app.state.settings
    began = datetime.datetime(2026, 5, 1, tzinfo=datetime.timezone.utc)
    api.sql(
        "INSERT INTO backup_attempt (id, started_at, ended_at, snapshot_id, damaged_objects)"
        " VALUES (gen_random_uuid(), %s, now() - interval '1 day', 'one', 3)",
        began,
    )
    operations.record_attempt(settings, began, None)
    text = api.metrics()
    assert value(text, definitions.BACKUP_LAST_SUCCESS) == began.timestamp()
    assert value(text, definitions.BACKUP_LAST_ATTEMPT) > began.timestamp()
    assert value(text, definitions.BACKUP_LAST_ATTEMPT_FAILED) == 1
    assert value(text, definitions.BACKUP_DAMAGED_OBJECTS) == 3


def test_slow_gauges_are_read_in_the_background(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_SLOW_HOLDS_S", "_SLOW_TIME_FACTOR"):
        monkeypatch.setattr(metrics_server, name, 0)
    api = start_api()
    assert value(api.metrics(), definitions.PROJECTS) == 0
    api.project()
    assert value(api.metrics(), definitions.PROJECTS) == 0, "a scrape does not wait for them"
    wait_until(lambda: value(api.metrics(), definitions.PROJECTS) == 1)


def test_waiting_for_a_connection_is_seen(lab: Api) -> None:
    settings = lab.app.state.settings.model_copy(update={"database_connections": 2})

    def waiting_now() -> float:
        definition = definitions.DATABASE_CONNECTIONS_WAITING
        return metrics.REGISTRIES[definition.source].get_sample_value(definition.name) or 0.0

    async def use_all_and_wait() -> float:
        database = open_database(settings)
        try:
            async with database.begin(), database.begin():
                waiting = asyncio.create_task(_use(database))
                await asyncio.sleep(0)  # it runs until it waits
                number = waiting_now()
            await waiting
            return number
        finally:
            await database.close()

    assert asyncio.run(asyncio.wait_for(use_all_and_wait(), 20)) == 1


async def _use(database: Database) -> None:
    async with database.begin():
        pass


def test_series_are_bounded(lab: Api) -> None:
    """Neither paths nor methods nor tokens that clients choose make series."""
    lab.get("/projects").ok()
    before = len([line for line in lab.metrics().splitlines() if not line.startswith("#")])
    for number in range(20):
        urllib3.request("GET", f"{lab.url}/api/v1/nothing/{number}")
        urllib3.request(f"M{number}", f"{lab.url}/api/v1/projects")
        lab.get(f"/projects/{uuid.uuid4()}")
        lab.as_(f"klein_{number}").get("/projects")
    after = [line for line in lab.metrics().splitlines() if not line.startswith("#")]
    assert len(after) < before + 40, after


def test_names_follow_the_conventions_of_prometheus() -> None:
    names = [definition.name for definition in DEFINITIONS]
    assert len({*names}) == len(names)
    for definition in DEFINITIONS:
        assert definition.name.endswith("_total") == (definition.kind is MetricKind.counter), definition.name
        assert bool(definition.buckets) == (definition.kind is MetricKind.histogram), definition.name
        assert definition.meaning.endswith("."), definition.name
