"""`klein admin`, used by an admin and refused to others."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from typer.testing import CliRunner

from kleinkram.cli.main import app
from kleinkram.contract.errors import Forbidden
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.people import person

Klein = Callable[..., str]


@pytest.fixture(scope="module")
def lab(start_api: StartApi) -> Api:
    return start_api()


@pytest.fixture
def klein(lab: Api, monkeypatch: pytest.MonkeyPatch) -> Klein:
    """A terminal: runs a command as an admin, or with another token, and returns what it printed."""

    def run(*arguments: str, token: str | None = None) -> str:
        monkeypatch.setenv("KLEINKRAM_URL", lab.url)
        monkeypatch.setenv("KLEINKRAM_TOKEN", token or str(lab.token))
        ran = CliRunner().invoke(app, ["admin", *arguments])
        if ran.exception is not None:
            raise ran.exception
        return ran.stdout

    return run


def _fail_a_job(lab: Api) -> int:
    job_id: int = lab.sql(
        "INSERT INTO procrastinate_jobs (queue_name, task_name, status, attempts, args)"
        " VALUES ('verification', 'verify_blob', 'failed', 5, '{\"ref\": \"x\"}') RETURNING id"
    )[0][0]
    lab.sql("INSERT INTO job_error VALUES (%s, 'the store is \x1b[31m away') RETURNING job_id", job_id)
    return job_id


def test_failed_jobs_are_shown_with_their_error_and_retried(lab: Api, klein: Klein) -> None:
    job_id = _fail_a_job(lab)
    shown = klein("jobs")
    assert f"{job_id}  verify_blob" in shown
    assert "the store is \\x1b[31m away" in shown, "a terminal obeys nothing of it"
    (message,) = json.loads(klein("jobs", "--json"))["failed"]
    assert (message["id"], message["error"]) == (job_id, "the store is \x1b[31m away")
    assert json.loads(klein("retry", str(job_id), "--json")) == {"retried": job_id}
    assert json.loads(klein("jobs", "--json"))["failed"] == []


def test_all_failed_jobs_are_retried_by_one_command(lab: Api, klein: Klein) -> None:
    _fail_a_job(lab)
    _fail_a_job(lab)
    assert json.loads(klein("retry", "--all", "--json")) == {"retried": 2}
    assert json.loads(klein("jobs", "--json"))["failed"] == []
    with pytest.raises(SystemExit):
        klein("retry")


def test_health_and_storage_are_shown(klein: Klein) -> None:
    health = klein("health")
    assert "ready:" in health
    assert "PostgreSQL" in health
    message: Any = json.loads(klein("health", "--json"))
    assert message["not_ready"] is None
    assert "under_way" in klein("storage")
    assert json.loads(klein("storage", "--json"))["marked_for_deletion"] == {
        "state": "marked_for_deletion",
        "count": 0,
        "size_bytes": 0,
    }


@pytest.mark.parametrize("command", [["jobs"], ["storage"], ["health"], ["retry", "1"]])
def test_only_admins_have_access(lab: Api, klein: Klein, command: list[str]) -> None:
    with pytest.raises(Forbidden):
        klein(*command, token=person(lab).token)
