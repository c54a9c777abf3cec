"""Missions with files as if they had been uploaded and read, and jobs that judge them."""

import uuid
from typing import Any

from kleinkram.server.recordings.derive import derive_again
from tests.integration.api_server import Answer, Api
from tests.integration.jobs import WorkerResources, in_worker, run_jobs
from tests.integration.sample import Sample

START_NS = 1_700_000_000 * 10**9
SECOND_NS = 10**9

RULES = """\
version: 1
profiles:
  - name: all robots
    topics:
      /imu: {rate: 100 Hz, tolerance: 5%, max_gap: 100ms}
      /camera: {required: true, severity: warning}
"""


def topic(name: str, *, rate_hz: float = 100, seconds: float = 10, gap_ns: int | None = None) -> dict[str, Any]:
    """Return a topic of a file that begins at `START_NS`, with messages at a rate."""
    step_ns = round(1e9 / rate_hz)
    count = int(seconds * rate_hz)
    return {
        "name": name,
        "message_type": "a/msg/B",
        "count": count,
        "first_ns": START_NS,
        "last_ns": START_NS + (count - 1) * step_ns,
        "rate_hz": rate_hz,
        "longest_gap_ns": gap_ns or step_ns,
    }


GOOD = (topic("/imu"), topic("/camera", rate_hz=10))
SLOW = (topic("/imu", rate_hz=50), topic("/camera", rate_hz=10))


def put_file(api: Api, mission_id: str, path: str, topics: tuple[dict[str, Any], ...], **columns: Any) -> str:
    """Put a recording of these topics into a mission, and have its recordings derived; returns the file's id."""
    file_id = put_underived_file(api, mission_id, path, topics, **columns)
    derive(api, mission_id)
    return file_id


def put_underived_file(api: Api, mission_id: str, path: str, topics: tuple[dict[str, Any], ...], **columns: Any) -> str:
    """Put a recording of these topics into a mission; returns the file's id."""
    span = {"start_ns": START_NS, "end_ns": START_NS + 10 * SECOND_NS}
    count = sum(one["count"] for one in topics)
    return Sample(api).file(mission_id, path, topics=[*topics], message_count=count, **{**span, **columns})


def derive(api: Api, *mission_ids: str) -> None:
    """Request that the recordings of missions are derived, as every change of files does."""

    async def request(resources: WorkerResources) -> None:
        async with resources.context.database.begin() as db:
            for mission_id in mission_ids:
                await derive_again(db, uuid.UUID(mission_id))

    in_worker(api, request)


def judged_mission(api: Api, project_id: str, *topics: dict[str, Any], **fields: Any) -> str:
    """Create a mission with one recording, and judge it; returns its id."""
    mission_id = str(api.mission(project_id, **fields)["id"])
    put_file(api, mission_id, "run.mcap", topics)
    run_jobs(api)
    return mission_id


def set_rules(api: Api, project_id: str, text: str = RULES, **headers: str) -> Answer:
    """Set the `checks.yaml` of a project."""
    return api.call("PUT", f"/projects/{project_id}/checks", {"text": text}, headers=headers)


def checked_project(api: Api, text: str = RULES) -> str:
    """Create a project with rules; returns its id."""
    project_id = str(api.project()["id"])
    set_rules(api, project_id, text).ok()
    return project_id


def verdict(api: Api, mission_id: str) -> str:
    """Return the verdict of a mission, which is the same wherever it is shown."""
    shown = {
        api.get(f"/missions/{mission_id}").ok()["verdict"],
        api.get(f"/missions/{mission_id}/checks").ok()["verdict"],
    }
    shown |= {one["verdict"] for one in api.all("/missions", {"missions": mission_id})}
    (only,) = shown
    return str(only)


def failing(api: Api, mission_id: str) -> list[tuple[str, str, str | None]]:
    """Return name, status and topic of the checks of a mission that fail and are not accepted."""
    checks = api.get(f"/missions/{mission_id}/checks").ok()["checks"]
    failed = [one for one in checks if one["status"] in ("error", "warning", "not_made") and not one["acceptance_id"]]
    return [(one["name"], one["status"], one["topic"]) for one in failed]


def judging_jobs(api: Api) -> list[str]:
    """Run all jobs, and return the names of those that judged missions."""
    return [name for name in run_jobs(api) if name.startswith("judge")]
