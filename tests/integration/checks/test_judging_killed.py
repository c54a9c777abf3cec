"""A worker is killed while it judges the missions of a project: another one ends the job, with the same verdicts."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psycopg
import pytest

from kleinkram.server.settings import plain_dsn
from tests.integration.api_server import Api
from tests.integration.checks.judged import GOOD, RULES, SLOW, derive, judging_jobs, put_underived_file, set_rules
from tests.integration.conftest import StartApi
from tests.integration.jobs import run_jobs
from tests.integration.upload_client import wait_until

_MISSIONS, _JUDGED_AT_ONCE = 60, 25
_STORED = """
    SELECT mission.name, verdict, checks_number, is_outdated, counts, statuses, failed, checks, bad_since IS NOT NULL
    FROM mission_checks JOIN mission ON mission.id = mission_id WHERE mission.project_id = %s ORDER BY mission.name
"""
_NUMBERS = "SELECT checks_number FROM mission_checks WHERE project_id = %s ORDER BY mission_id"
_WAITS = (
    "SELECT count(*) FROM pg_locks JOIN pg_stat_activity USING (pid) WHERE NOT granted AND datname = current_database()"
)
_JOBS = "SELECT count(*) FROM procrastinate_jobs WHERE status IN ('todo', 'doing') AND task_name = 'judge_project'"
_JUDGE_AGAIN = (
    "INSERT INTO procrastinate_jobs (queue_name, task_name, args) VALUES ('default', 'judge_project', %s::jsonb)"
)


@contextlib.contextmanager
def _working(api: Api, log: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """Run a worker of this API as a process of its own; killed at the end."""
    settings = api.app.state.settings
    environment = {
        "KLEINKRAM_DATABASE_URL": plain_dsn(settings.database_url),
        "KLEINKRAM_S3_INTERNAL_URL": str(settings.s3_internal_url),
        "KLEINKRAM_S3_BUCKET": settings.s3_bucket,
        "KLEINKRAM_S3_REGION": settings.s3_region,
        "KLEINKRAM_S3_ACCESS_KEY": settings.s3_access_key,
        "KLEINKRAM_S3_SECRET_KEY": settings.s3_secret_key.get_secret_value(),
        "KLEINKRAM_SCRUB_HOURS": "0",
    }
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "kleinkram.server", "worker", "--metrics-port", "0"],
            env={**os.environ, **environment},
            stderr=stream,
        )
    try:
        yield process
    finally:
        process.kill()
        process.wait(60)


def _messages(log: Path) -> list[tuple[str, str | None]]:
    """Return the messages of a log, and the jobs that they name."""
    lines: list[dict[str, Any]] = [json.loads(line) for line in log.read_text().splitlines()]
    return [(str(line["message"]), line.get("job")) for line in lines]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_project_is_judged_to_its_end_after_its_worker_was_killed(start_api: StartApi, tmp_path: Path) -> None:
    api = start_api()
    project_id = str(api.project()["id"])
    mission_ids = [str(api.mission(project_id, name=f"drive {number:02}")["id"]) for number in range(_MISSIONS)]
    for number, mission_id in enumerate(mission_ids):
        put_underived_file(api, mission_id, "run.mcap", SLOW if number % 3 == 0 else GOOD)
    derive(api, *mission_ids)
    run_jobs(api)
    set_rules(api, project_id, "version: 1\nprofiles:\n  - files: {'*.mcap': {}}\n").ok()
    run_jobs(api)
    assert {row[1] for row in api.sql(_STORED, project_id)} == {"good"}

    # A row of a later batch cannot be written until the worker that waits for it is dead.
    set_rules(api, project_id, RULES).ok()
    ids = [row[0] for row in api.sql("SELECT id FROM mission WHERE project_id = %s ORDER BY id", project_id)]
    own_url = plain_dsn(api.app.state.settings.database_url)
    with psycopg.connect(own_url) as blocker, _working(api, tmp_path / "first.log") as worker:
        blocker.execute("SELECT 1 FROM mission_checks WHERE mission_id = %s FOR UPDATE", [ids[_JUDGED_AT_ONCE + 5]])
        # The jobs that a worker has when it starts may wait for that row, too.
        wait_until(lambda: (2,) in api.sql(_NUMBERS, project_id) and api.sql(_WAITS) != [(0,)], limit_s=60)
        worker.send_signal(signal.SIGKILL)
        worker.wait(60)
        blocker.rollback()
    wait_until(lambda: api.sql(_WAITS) == [(0,)], limit_s=60)
    numbers = [row[0] for row in api.sql(_NUMBERS, project_id)]
    stored = numbers.count(2)
    # Fewer than `_JUDGED_AT_ONCE` where a batch took long.
    assert 0 < stored <= _JUDGED_AT_ONCE + 20
    assert numbers == [2] * stored + [1] * (_MISSIONS - stored), "a batch is stored whole or not"
    evaluated = "SELECT mission_id, evaluated_at FROM mission_checks WHERE checks_number = 2 AND project_id = %s"
    first = {*api.sql(evaluated, uuid.UUID(project_id))}

    with _working(api, tmp_path / "second.log"):
        wait_until(lambda: api.sql(_JOBS) == [(0,)], limit_s=120)
    assert ("job was left unfinished: it will run again", "judge_project") in _messages(tmp_path / "second.log")
    judged = api.sql(_STORED, project_id)
    bad = [f"drive {number:02}" for number in range(0, _MISSIONS, 3)]
    assert [row[0] for row in judged if row[1] == "bad"] == bad
    assert {row[1] for row in judged} == {"good", "bad"}
    assert first <= {*api.sql(evaluated, uuid.UUID(project_id))}, "what was judged is not judged again"

    api.sql("UPDATE mission_checks SET is_outdated = true")
    api.sql(_JUDGE_AGAIN, json.dumps({"ref": project_id}))
    assert judging_jobs(api) == ["judge_project"]
    assert api.sql(_STORED, project_id) == judged, "as without an interruption"
