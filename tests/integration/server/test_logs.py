"""Log lines: untrusted text is escaped, and each line has the ids of what it belongs to."""

import json
import logging
import socket
import subprocess
import sys
import uuid
from collections.abc import Mapping
from typing import Any

from kleinkram.json_logs import JsonLines, log_fields
from kleinkram.server.jobs.queue import queue
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.upload_client import upload
from tests.log_lines import logged_lines


def test_log_lines_cannot_control_a_terminal() -> None:
    path = "/käse \u009b31m\x1b[31m \u202eback \U000e0001"
    record = logging.makeLogRecord({"msg": "request", "fields": {"path": path}})
    line = JsonLines("api").format(record)
    assert line.isprintable()
    assert "käse" in line
    assert json.loads(line)["path"] == path


def test_the_error_that_ends_a_process_is_logged() -> None:
    program = (
        "from kleinkram.server.logs import set_up_logs; import threading\n"
        "set_up_logs('json', 'info', role='worker')\n"
        "thread = threading.Thread(target=lambda: 1 / 0); thread.start(); thread.join()\n"
        "raise ValueError('no more')\n"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    lines = [json.loads(line) for line in ran.stderr.splitlines()]
    assert [line["message"] for line in lines] == [
        "ended by an error: ZeroDivisionError: division by zero",
        "ended by an error: ValueError: no more",
    ]
    assert all("Traceback" in line["exception"] for line in lines)
    assert {(line["role"], line["host"]) for line in lines} == {("worker", socket.gethostname())}
    assert ran.returncode == 1


def test_fields_belong_to_the_lines_of_their_block() -> None:
    formatter = JsonLines("runner")

    def line() -> Any:
        return json.loads(formatter.format(logging.makeLogRecord({"msg": "x"})))

    with log_fields(run_id="r", attempt=None):
        with log_fields(attempt=2):
            assert (line()["run_id"], line()["attempt"]) == ("r", 2)
        assert "attempt" not in line()
    assert "run_id" not in line()


def test_a_request_is_logged_with_its_route_and_the_ids_of_its_sender(api: Api, mission_id: str) -> None:
    request_id = uuid.uuid4().hex
    with logged_lines() as lines:
        api.call("GET", f"/missions/{mission_id}", headers={"X-Request-Id": request_id}).ok()
        api.as_(None).get("/me").refused(401, "not_authenticated")
    requests = [line for line in lines if line["message"] == "request"]
    (known,) = [line for line in requests if line["request_id"] == request_id]
    (stranger,) = [line for line in requests if line["status"] == 401]
    assert (known["route"], known["path"]) == ("/api/v1/missions/{mission_id}", f"/api/v1/missions/{mission_id}")
    assert (known["method"], known["status"], known["request_id"]) == ("GET", 200, request_id)
    sql = "SELECT person_id::text FROM token WHERE id = %s"
    assert api.sql(sql, known["token_id"]) == [(known["person_id"],)]
    assert "token_id" not in stranger
    assert "person_id" not in stranger


def test_the_jobs_of_a_request_are_logged_with_its_id(api: Api, mission_id: str) -> None:
    with logged_lines(logging.DEBUG) as lines:
        upload(api, mission_id, "notes.txt", uuid.uuid4().bytes)
        api.sql(
            "INSERT INTO procrastinate_jobs (queue_name, task_name, queueing_lock)"
            " VALUES ('default', 'maintain_runs', 'maintain_runs')"
        )
        run_jobs(api)
    (completed,) = [line for line in lines if line.get("route") == "/api/v1/uploads/complete"]
    # Jobs that earlier tests left behind run as well, so the ones of this request are found by its id.
    of_request = [line for line in lines if line.get("request_id") == completed["request_id"]]
    started, ended = _by_job(of_request, "job started"), _by_job(of_request, "job done")
    assert {"examine_blob", "group_recordings"} <= set(ended)
    assert ended["group_recordings"]["ref"] == mission_id
    assert {line["level"] for line in ended.values()} == {"info"}
    periodic = {name for name, task in queue.tasks.items() if task.queueing_lock is not None}
    assert {line["level"] for job, line in _by_job(lines, "job done").items() if job in periodic} == {"debug"}
    assert {line["level"] for line in started.values()} == {"debug"}
    assert started["examine_blob"]["job_id"] == ended["examine_blob"]["job_id"]


def _by_job(lines: list[dict[str, Any]], message: str) -> Mapping[str, dict[str, Any]]:
    return {line["job"]: line for line in lines if line["message"] == message}


def test_a_job_without_a_request_is_logged_without_an_id(api: Api) -> None:
    api.sql("INSERT INTO procrastinate_jobs (queue_name, task_name) VALUES ('default', 'no_such_task')")
    (origin,) = api.sql("DELETE FROM procrastinate_jobs WHERE task_name = 'no_such_task' RETURNING origin")
    assert origin == (None,)
