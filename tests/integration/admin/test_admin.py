"""The admin view of the server, which contains no secret."""

import json

import pytest

from kleinkram.client import connect
from kleinkram.contract.errors import NotFound, StoreUnavailable
from kleinkram.metric_definitions import MetricSource
from kleinkram.server import metrics
from kleinkram.server.blobs import service
from kleinkram.server.jobs.execution import ATTEMPTS
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import run_jobs
from tests.integration.sample import Sample
from tests.integration.upload_client import begin
from tests.log_lines import logged_lines


@pytest.fixture(scope="module")
def lab(start_api: StartApi) -> Api:
    return start_api()


def test_storage_is_reported_by_state(lab: Api) -> None:
    mission = lab.mission(lab.project()["id"])
    sample = Sample(lab)
    sample.file(mission["id"], "kept.mcap", size_bytes=3)
    trashed = sample.file(mission["id"], "trashed.mcap", size_bytes=5)
    lab.delete(f"/files/{trashed}").ok()
    sample.blob(size_bytes=7, marked_for_deletion_at="2026-01-01T00:00:00Z")
    begin(lab, mission["id"], {"coming.bin": b"eleven byte"}, hashed=False)
    message = lab.get("/admin/storage").ok()
    assert message["blobs"] == [{"state": "stored", "count": 2, "size_bytes": 8}]
    assert message["trash"] == {"state": "trash", "count": 1, "size_bytes": 5}
    assert message["marked_for_deletion"] == {"state": "marked_for_deletion", "count": 1, "size_bytes": 7}
    assert message["uploads"] == {"state": "under_way", "count": 1, "size_bytes": 11}


def test_a_failed_job_is_listed_and_retried(lab: Api) -> None:
    insert = "INSERT INTO procrastinate_jobs (queue_name, task_name, status, args) VALUES"
    job_id = lab.sql(f"{insert} ('default', 'verify_blob', 'failed', '{{\"ref\": \"x\"}}') RETURNING id")[0][0]
    with connect(lab.url, lab.token) as client:
        message = client.admin.jobs()
        assert [(item.id, item.kind, item.ref) for item in message.failed] == [(job_id, "verify_blob", "x")]
        assert ("verify_blob", "failed", 1) in [(item.kind, item.state, item.count) for item in message.queue]
        client.admin.retry_job(job_id)
        assert client.admin.jobs().failed == []
        with pytest.raises(NotFound):
            client.admin.retry_job(job_id)
    assert lab.sql("SELECT status::text FROM procrastinate_jobs WHERE id = %s", job_id) == [("todo",)]
    (event,) = lab.all("/audit", {"operation": "job.retry"})
    assert event["after"] == {"job": job_id}


def test_the_error_of_a_failed_job_is_stored_and_deleted_with_it(lab: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = Sample(lab)
    blob_id = str(sample.blob(size_bytes=3))
    fails = [StoreUnavailable(reason="it is on holiday")]

    async def read(*_: object) -> None:
        if fails:
            raise fails[0]

    monkeypatch.setattr(service, "find_blob", read)
    job_id = lab.sql(
        "INSERT INTO procrastinate_jobs (queue_name, task_name, attempts, args)"
        " VALUES ('default', 'summarise_blob', %s, jsonb_build_object('ref', %s::text)) RETURNING id",
        *(ATTEMPTS, blob_id),
    )[0][0]
    run_jobs(lab)
    with connect(lab.url, lab.token) as client:
        (message,) = [item for item in client.admin.jobs().failed if item.id == job_id]
        assert message.error == fails[0].sentence()
        fails.clear()
        client.admin.retry_job(job_id)
        assert [item for item in client.admin.jobs().failed if item.id == job_id] == []
    run_jobs(lab)
    lab.sql("DELETE FROM procrastinate_jobs WHERE id = %s RETURNING id", job_id)
    assert lab.sql("SELECT 1 FROM job_error WHERE job_id = %s", job_id) == []


def test_the_error_of_a_job_is_shown_while_it_is_retried(lab: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    blob_id = str(Sample(lab).blob(size_bytes=3))
    error = StoreUnavailable(reason="it is on holiday")

    async def read(*_: object) -> None:
        raise error

    monkeypatch.setattr(service, "find_blob", read)
    job_id = lab.sql(
        "INSERT INTO procrastinate_jobs (queue_name, task_name, args)"
        " VALUES ('default', 'summarise_blob', jsonb_build_object('ref', %s::text)) RETURNING id",
        blob_id,
    )[0][0]
    with logged_lines() as lines:
        run_jobs(lab)
    with connect(lab.url, lab.token) as client:
        (message,) = [item for item in client.admin.jobs().retrying if item.id == job_id]
    assert (message.attempts, message.ref, message.error) == (1, blob_id, error.sentence())
    assert message.next_attempt_at is not None
    failures = [item for item in lines if item["message"] == f"job failed: {error.sentence()}"]
    (line,) = [item for item in failures if item["job_id"] == job_id]
    assert (line["level"], line["job"]) == ("warning", "summarise_blob")
    assert (line["ref"], line["attempt"]) == (blob_id, 1)
    labels = {"outcome": "failed", "task": "summarise_blob"}
    assert metrics.REGISTRIES[MetricSource.worker].get_sample_value("kleinkram_job_attempts_total", labels)
    lab.sql("DELETE FROM procrastinate_jobs WHERE id = %s", job_id)


def test_all_failed_jobs_are_retried_and_none_is_scheduled_later(lab: Api) -> None:
    insert = (
        "INSERT INTO procrastinate_jobs (queue_name, task_name, status, args) VALUES ('default', 'collect_garbage',"
    )
    job_id = lab.sql(f"{insert} 'failed', '{{}}') RETURNING id")[0][0]
    lab.sql(f"{insert} 'failed', '{{}}')")
    for kind, at in (("failed", "now() - interval '1 h'"), ("scheduled", "now() + interval '1 h'")):
        lab.sql(f"INSERT INTO procrastinate_events (job_id, type, at) VALUES (%s, '{kind}', {at})", job_id)
    with connect(lab.url, lab.token) as client:
        message = client.admin.jobs().failed
        (failed_at,) = [item.failed_at for item in message if item.id == job_id]
        assert failed_at is not None
        assert failed_at < client.admin.health().now
        assert client.admin.retry_jobs() == len(message)
        assert client.admin.jobs().failed == []
        assert client.admin.retry_jobs() == 0
    lab.sql("DELETE FROM procrastinate_jobs WHERE task_name = 'collect_garbage'")


def test_health_reports_database_and_store(lab: Api) -> None:
    message = lab.get("/admin/health").ok()
    assert message["not_ready"] is None
    assert message["database_bytes"] > 1_000_000
    assert abs(message["clock_skew_s"]) < 5
    assert (message["store_checksum"], message["store_allows_browser_uploads"]) == ("crc64nvme", True)


def test_effective_settings_contain_no_secret(lab: Api) -> None:
    message = {item["name"]: item for item in lab.get("/admin/settings").ok()["settings"]}
    assert message["KLEINKRAM_S3_BUCKET"]["value"] == lab.app.state.settings.s3_bucket
    assert message["KLEINKRAM_S3_BUCKET"]["is_set"] is True
    assert message["KLEINKRAM_TRASH_DAYS"] == {
        "name": "KLEINKRAM_TRASH_DAYS",
        "value": 30,
        "is_set": False,
        "is_secret": False,
    }
    settings = lab.app.state.settings
    password = settings.database_url.hosts()[0]["password"]
    secrets = [settings.s3_secret_key.get_secret_value(), settings.s3_access_key, password]
    assert all(secrets)
    assert [item for item in secrets if item in json.dumps(message)] == []


def test_only_admins_have_access(lab: Api) -> None:
    member = lab.as_(people.person(lab).token)
    for page in ("storage", "jobs", "scrub", "health", "settings"):
        member.get(f"/admin/{page}").refused(403, "forbidden")
    member.post("/admin/jobs/1/retry").refused(403, "forbidden")
    member.post("/admin/scrub", {}).refused(403, "forbidden")
