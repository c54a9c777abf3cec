"""Runs that were executed elsewhere are recorded with their results, and are like any run from then on."""

import uuid
from typing import Any

from kleinkram.contract.access import Right, Scope
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, launch
from tests.integration.upload_client import upload

_REPORT = {
    "metrics": [{"name": "ate_rmse", "value": 0.25, "unit": "m"}],
    "findings": [{"severity": "warning", "code": "gap", "message": "No odometry for 2 s."}],
    "checks": [{"name": "topic.rate", "status": "ok", "message": "200 Hz"}],
    "metadata": {"length": 12.5},
}


def record(api: Api, place: Place, **values: Any) -> Any:
    """Record a run that read both files of a mission."""
    body = {
        "mission_id": place.mission["id"],
        "name": "odometry",
        "script": "rule odometry: ...",
        "inputs": ["drive.bin", "notes/day.txt"],
    }
    return api.post("/runs/recorded", body | values)


def test_a_recorded_run_has_its_results_and_their_lineage(lab: Api, place: Place) -> None:
    made = upload(lab, place.mission["id"], "derived/odometry.tum", uuid.uuid4().bytes)
    run = record(lab, place, outputs=["derived/odometry.tum"], report=_REPORT, parameters={"voxel": 0.5}).ok(201)
    assert (run["state"], run["reason"], run["verdict"]) == ("done", "done", "warnings")
    assert (run["is_recorded"], run["runner"], run["parameters"]) == (True, None, {"voxel": 0.5})
    assert "executed elsewhere" in run["message"]
    assert [entry["path"] for entry in lab.all(f"/runs/{run['id']}/inputs")] == ["drive.bin", "notes/day.txt"]
    (metric,) = lab.all("/run-metrics", {"run_id": run["id"]})
    assert (metric["metric"]["name"], metric["metric"]["value"]) == ("ate_rmse", 0.25)
    assert lab.get(f"/runs/{run['id']}").ok()["metadata"] == {"length": 12.5}
    lineage = lab.get(f"/files/{made['id']}/lineage").ok()
    assert lineage["made_by"]["run"]["id"] == run["id"]
    assert {entry["path"] for entry in lineage["made_by"]["inputs"]} == {"drive.bin", "notes/day.txt"}
    source = lab.get(f"/files/{place.files['drive.bin']['id']}/lineage").ok()
    assert [entry["path"] for entry in source["read_by"][0]["files"]] == ["derived/odometry.tum"]
    assert lab.get(f"/files/{made['id']}").ok()["origin"] == "run"


def test_the_same_again_is_the_same_run_and_other_bytes_are_another(lab: Api, place: Place) -> None:
    upload(lab, place.mission["id"], "derived/first.csv", uuid.uuid4().bytes)
    first = record(lab, place, outputs=["derived/first.csv"]).ok(201)
    assert record(lab, place, outputs=["derived/first.csv"]).ok(201)["id"] == first["id"]
    upload(lab, place.mission["id"], "derived/second.csv", uuid.uuid4().bytes)
    assert record(lab, place, outputs=["derived/second.csv"]).ok(201)["id"] != first["id"]
    assert record(lab, place, parameters={"voxel": 1}).ok(201)["id"] != first["id"]
    assert lab.get("/runs", {"mission_id": place.mission["id"], "count": "true"}).ok()["total"] == 3


def test_files_that_are_not_there_or_not_ones_own_are_refused(lab: Api, place: Place) -> None:
    missing = record(lab, place, outputs=["derived/none.csv"])
    assert (missing.status, missing.body["code"]) == (404, "not_found")
    upload(lab, place.mission["id"], "derived/a.csv", uuid.uuid4().bytes)
    record(lab, place, outputs=["derived/a.csv"]).ok(201)
    taken = record(lab, place, outputs=["derived/a.csv"], parameters={"again": 1})
    assert "was made by another run" in taken.body["problems"][0]["message"]
    other = people.person(lab)
    people.grant(lab, other, Right.create, project_id=place.project["id"])
    stranger = lab.as_(people.token(lab, other, [Scope.read, Scope.upload]).secret)
    upload(lab, place.mission["id"], "derived/b.csv", uuid.uuid4().bytes)
    foreign = record(stranger, place, outputs=["derived/b.csv"])
    assert "uploaded by another person" in foreign.body["problems"][0]["message"]
    both = record(lab, place, outputs=["drive.bin"])
    assert "both an input and an output" in str(both.body)
    assert lab.get("/runs", {"mission_id": place.mission["id"], "count": "true"}).ok()["total"] == 1


def test_its_results_are_neither_reused_nor_retried_here(lab: Api, place: Place, runner: FakeRunner) -> None:
    script = {"script": "print('hello')\n", "name": "count"}
    recorded = record(lab, place, **script).ok(201)
    queued = launch(lab, runner, place.mission, force=False)
    assert (queued["state"], queued["reuses_id"]) == ("queued", None)
    retried = lab.post(f"/runs/{recorded['id']}/retry")
    assert "executed elsewhere" in retried.body["problems"][0]["message"]
    lab.post(f"/runs/{queued['id']}/cancel").ok()
