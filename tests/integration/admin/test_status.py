"""The status says whether the server is healthy, what is full and when, and what needs an admin."""

import datetime
import json
from collections.abc import Iterator
from typing import Any

import pytest
from typer.testing import CliRunner

import kleinkram
from kleinkram.cli.main import app
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.sample import Sample

_GB = 10**9
_WORKER = (
    "INSERT INTO worker_process (id, host, pid, version, seen_at)"
    " VALUES (gen_random_uuid(), 'here', 1, %s, now() + interval '1 h')"
)


@pytest.fixture(name="lab")
def _lab(start_api: StartApi) -> Iterator[Api]:
    """A server that has existed for ten days, with a living worker."""
    api = start_api(store_folder=None, store_capacity_bytes=100 * _GB, scrub_hours=24)
    api.sql("UPDATE person SET created_at = now() - interval '10 days'")
    api.sql(_WORKER, kleinkram.__version__)
    yield api
    api.sql("DELETE FROM worker_process")


def _status(api: Api) -> dict[str, Any]:
    status: dict[str, Any] = api.get("/admin/status").ok()
    return status


def _subjects(status: dict[str, Any]) -> list[tuple[str, str]]:
    return [(item["severity"], item["subject"]) for item in status["items"]]


def _days_left(status: dict[str, Any], row: dict[str, Any]) -> float:
    full_at, now = (datetime.datetime.fromisoformat(text) for text in (row["full_at"], status["now"]))
    return (full_at - now).total_seconds() / 86_400


def test_a_new_server_is_healthy(lab: Api) -> None:
    status = _status(lab)
    assert (status["items"], status["is_healthy"]) == ([], True)
    (store,) = status["capacities"]
    assert (store["project"], store["used"], store["limit"], store["full_at"]) == (None, 0, 100 * _GB, None)


def test_the_store_is_forecast_by_what_came_in_the_life_of_the_server(lab: Api) -> None:
    sample = Sample(lab)
    for _ in range(2):
        sample.blob(size_bytes=20 * _GB, created_at="now")
    sample.blob(size_bytes=10 * _GB, created_at="2020-01-01T00:00:00Z")
    sample.blob(size_bytes=90 * _GB, marked_for_deletion_at="2026-01-01T00:00:00Z")
    status = _status(lab)
    (store,) = status["capacities"]
    assert status["stored_bytes"] == store["used"] == 50 * _GB
    assert store["per_day"] == status["stored_bytes_per_day"] == pytest.approx(4 * _GB, rel=0.01)
    assert _days_left(status, store) == pytest.approx(12.5, rel=0.01)
    assert ("warning", "capacity") in _subjects(status), "it will be full within 30 days"
    assert status["is_healthy"]


def test_quotas_are_forecast_by_project_and_the_first_to_be_full_comes_first(lab: Api) -> None:
    slow, full = lab.project(), lab.project()
    sample = Sample(lab)
    for project, quota in ((slow, 100), (full, 20)):
        lab.sql("UPDATE project SET created_at = now() - interval '90 days' WHERE id = %s", project["id"])
        lab.patch(f"/projects/{project['id']}", {"quota_bytes": quota, "quota_files": 1000}).ok()
        mission = lab.mission(project["id"])
        sample.file(mission["id"], "new.mcap", size_bytes=30)
        gone = sample.file(mission["id"], "gone.mcap", size_bytes=30)
        lab.delete(f"/files/{gone}").ok()
    status = _status(lab)
    rows = [(row["project"]["name"], row["unit"], row["used"]) for row in status["capacities"] if row["project"]]
    assert rows[0] == (full["name"], "bytes", 30)
    assert (slow["name"], "bytes", 30) in rows
    assert (slow["name"], "files", 1) in rows
    by_name = {(row["project"]["name"], row["unit"]): row for row in status["capacities"] if row["project"]}
    assert _days_left(status, by_name[slow["name"], "bytes"]) == pytest.approx(70, rel=0.05)
    (item,) = [item for item in status["items"] if item["subject"] == "capacity" and full["name"] in item["message"]]
    assert (item["severity"], "100% full (30 B of 20 B)" in item["message"]) == ("problem", True)
    assert not status["is_healthy"]


def test_what_needs_an_admin_is_named_with_a_remedy(lab: Api) -> None:
    mission = lab.mission(lab.project()["id"])
    sample = Sample(lab)
    sample.file(mission["id"], "lost.mcap", size_bytes=7, state="lost")
    sample.file(mission["id"], "late.mcap", created_at="2020-01-01T00:00:00Z")
    insert = "INSERT INTO procrastinate_jobs (queue_name, task_name, status, args) VALUES ('default', 'scrub',"
    lab.sql(f"{insert} 'failed', '{{}}')")
    waiting = lab.sql(f"{insert} 'todo', '{{}}') RETURNING id")[0][0]
    deferred = "INSERT INTO procrastinate_events (job_id, type, at) VALUES (%s, 'deferred', now() - interval '1 h')"
    lab.sql(deferred, waiting)
    lab.sql(
        "INSERT INTO scrub (id, store_id, created_at, ended_at, seen_at, aborted_reason)"
        " SELECT gen_random_uuid(), %s, at, at, at, 'another store' FROM (SELECT now() - interval '9 days' AS at) AS t",
        lab.app.state.settings.store_id,
    )
    lab.sql(_WORKER, "0.0.1")
    lab.sql(
        "INSERT INTO token (id, person_id, kind, name, secret_sha256, scopes, expires_at) SELECT gen_random_uuid(), id,"
        " 'runner', 'gpu', sha256('x'), '{run}', now() + interval '3 days' FROM person LIMIT 1"
    )
    status = _status(lab)
    assert set(_subjects(status)) >= {
        *{("problem", "files"), ("problem", "scrub"), ("warning", "verification"), ("warning", "jobs")},
        *{("warning", "scrub"), ("warning", "version"), ("warning", "runners")},
    }
    severities = [item["severity"] for item in status["items"]]
    assert severities == sorted(severities), "problems come first"
    texts = " ".join(f"{item['message']} {item['remedy']}" for item in status["items"])
    for part in (
        "Blobs that are lost: 1 (7 B).",
        "Workers of version 0.0.1: 1",
        "klein admin retry --all",
        "token gpu",
    ):
        assert part in texts


def test_a_server_without_workers_is_not_healthy(lab: Api) -> None:
    lab.sql("DELETE FROM worker_process")
    status = _status(lab)
    assert ("problem", "workers") in _subjects(status)
    assert not status["is_healthy"]


def test_the_command_shows_it_and_fails_if_there_is_a_problem(lab: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KLEINKRAM_URL", lab.url)
    monkeypatch.setenv("KLEINKRAM_TOKEN", str(lab.token))
    healthy = CliRunner().invoke(app, ["admin", "status"])
    assert (healthy.exit_code, "Healthy" in healthy.stdout, "100.0 GB" in healthy.stdout) == (0, True, True)
    lab.sql("DELETE FROM worker_process")
    ill = CliRunner().invoke(app, ["admin", "status"])
    assert (ill.exit_code, "PROBLEM workers: No worker process" in ill.stdout) == (1, True)
    as_json = CliRunner().invoke(app, ["admin", "status", "--json"])
    assert (as_json.exit_code, json.loads(as_json.stdout)["is_healthy"]) == (1, False)


def test_others_do_not_see_it(lab: Api) -> None:
    lab.as_(people.person(lab).token).get("/admin/status").refused(403, "forbidden")
