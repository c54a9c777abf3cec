"""Files that runs made from recordings are derived: they are in no sum of what was recorded."""

import uuid
from pathlib import Path
from typing import Any

import pytest

from kleinkram.recordings.sample import generate_mcap
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.runs.conftest import FakeRunner, definition, launch
from tests.integration.upload_client import upload


@pytest.fixture(name="bodies", scope="module")
def _bodies(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, bytes]:
    """Two recordings of the same drive: the recorded and the converted one."""
    folder: Path = tmp_path_factory.mktemp("drives")
    for seed in (1, 2):
        generate_mcap(folder / f"{seed}.mcap", size_bytes=200_000, seed=seed)
    return (folder / "1.mcap").read_bytes(), (folder / "2.mcap").read_bytes()


def convert(lab: Api, runner: FakeRunner, mission: Any, body: bytes, to: str) -> str:
    """Let a run make a file of a mission from its recording; return the run's id."""
    made = launch(lab, runner, mission, right="CREATE")
    claim = runner.claim()
    runner.upload_artifact(claim, "converted.mcap", body)
    runner.finish(claim, report={"mission_files": [{"path": "converted.mcap", "to": to}]}).ok()
    run_jobs(lab)
    return str(made["id"])


def sums(lab: Api, project: Any, mission: Any) -> dict[str, Any]:
    """Return everything that adds up what a mission recorded."""
    query = {"by": "mission", "project_id": project["id"]}
    (row,) = lab.get("/stats", query).ok()["rows"]
    seen = lab.get(f"/missions/{mission['id']}").ok()
    buckets = lab.get(f"/projects/{project['id']}/stats").ok()["total"]
    topics = lab.all(f"/missions/{mission['id']}/topics")
    whole = lab.get(f"/projects/{project['id']}").ok()
    return {
        "stats": row,
        "mission": [seen[name] for name in ("message_count", "start_ns", "end_ns")],
        "by month": buckets,
        "project": whole["duration_ns"],
        "topics": [(topic["name"], topic["count"], topic["file_count"]) for topic in topics],
    }


def test_a_converted_recording_counts_once(lab: Api, runner: FakeRunner, bodies: tuple[bytes, bytes]) -> None:
    project = lab.project()
    mission = lab.mission(project["id"])
    upload(lab, mission["id"], "drive.mcap", bodies[0])
    run_jobs(lab)
    before = sums(lab, project, mission)
    assert before["stats"]["duration_ns"] > 0
    assert before["mission"][0] > 0
    convert(lab, runner, mission, bodies[1], "mcap/drive.mcap")
    assert sums(lab, project, mission) == before
    (everything,) = lab.get("/stats", {"by": "mission", "project_id": project["id"], "derived": "true"}).ok()["rows"]
    assert (everything["recordings"], everything["files"]) == (2, 2)
    assert everything["duration_ns"] > before["stats"]["duration_ns"]
    files = {file["path"]: file["origin"] for file in lab.all("/files", {"mission_id": mission["id"]})}
    assert files == {"drive.mcap": "upload", "mcap/drive.mcap": "run"}
    recordings = {row["name"]: row["is_derived"] for row in lab.all(f"/missions/{mission['id']}/recordings")}
    assert recordings == {"drive.mcap": False, "mcap/drive.mcap": True}
    timeline = {file["path"]: file["is_derived"] for file in lab.all(f"/missions/{mission['id']}/timeline")}
    assert timeline == {"drive.mcap": False, "mcap/drive.mcap": True}
    # While nothing is stored, the sums are added up from the files.
    lab.sql("UPDATE mission SET file_count = NULL, duration_ns = NULL WHERE id = %s", uuid.UUID(mission["id"]))
    lab.sql("DELETE FROM mission_topics WHERE mission_id = %s", uuid.UUID(mission["id"]))
    assert sums(lab, project, mission) == before


def test_derived_files_never_join_a_recorded_split_set(
    lab: Api, runner: FakeRunner, bodies: tuple[bytes, bytes]
) -> None:
    mission = lab.mission(lab.project()["id"])
    upload(lab, mission["id"], "drive_0.mcap", bodies[0])
    convert(lab, runner, mission, bodies[1], "drive_1.mcap")
    rows = lab.all(f"/missions/{mission['id']}/recordings")
    assert sorted((row["is_derived"], row["paths"]) for row in rows) == [
        (False, ["drive_0.mcap"]),
        (True, ["drive_1.mcap"]),
    ]


def test_derived_files_are_inputs_only_where_an_action_asks(
    lab: Api, runner: FakeRunner, bodies: tuple[bytes, bytes]
) -> None:
    mission = lab.mission(lab.project()["id"])
    upload(lab, mission["id"], "drive.mcap", bodies[0])
    convert(lab, runner, mission, bodies[1], "converted.mcap")
    recorded = launch(lab, runner, mission, inputs={"paths": ["*.mcap"]})
    assert [entry["path"] for entry in lab.all(f"/runs/{recorded['id']}/inputs")] == ["drive.mcap"]
    both = launch(lab, runner, mission, inputs={"paths": ["*.mcap"], "derived": True})
    assert [entry["path"] for entry in lab.all(f"/runs/{both['id']}/inputs")] == ["converted.mcap", "drive.mcap"]
    body = {"mission_ids": [mission["id"]], "definition": definition(runner, inputs={"paths": ["converted*"]})}
    (refused,) = lab.post("/runs", body).ok()["items"]
    assert refused["outcome"] == "refused"
    assert "files that runs made are inputs only with `derived: true`" in refused["problem"]["detail"]
