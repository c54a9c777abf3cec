"""Inputs and artifacts that moved to a hidden project: their names and ids are hidden too."""

import json
import uuid
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, launch
from tests.integration.upload_client import sha256, upload

_OPENAPI = Path(__file__).parents[3] / "docs" / "openapi.json"
_INPUT, _OUTPUT = b"an input that moves away", b"an output that moves away"


class World(NamedTuple):
    """A run of which one input and one output moved to a project that the reader may not see."""

    reader: Api
    outsider: Api
    ids: dict[str, list[str]]
    secrets: list[str]
    elsewhere: list[str]
    run_id: str
    visible_file_id: str


@pytest.fixture(name="world")
def _world(lab: Api, runner: FakeRunner, place: Place) -> World:
    hidden = lab.project()
    vault = lab.mission(hidden["id"], name="vault mission")
    mission = place.mission["id"]
    moving = upload(lab, mission, "wexford-input.bin", _INPUT)
    launch(lab, runner, place.mission, right="CREATE")
    claim = runner.claim()
    runner.upload_artifact(claim, "result.bin", _OUTPUT)
    runner.upload_artifact(claim, ".kleinkram/log", b"a line\n")
    values = {"file": "wexford-input.bin", "message": "odd", "code": "odd", "severity": "warning"}
    metric = {"name": "rate", "value": 1, "unit": None, "file": "wexford-input.bin"}
    mission_files = [
        {"path": "result.bin", "to": "wexford-output.bin", "derived_from": ["drive.bin", "wexford-input.bin"]}
    ]
    check = {"name": "file.size", "status": "error", "message": "odd", "file": "wexford-input.bin"}
    report = {"mission_files": mission_files, "findings": [values], "metrics": [metric], "checks": [check]}
    runner.finish(claim, report=report).ok()
    made = {entry["path"]: entry["id"] for entry in lab.all("/files", {"mission_id": mission})}["wexford-output.bin"]
    for file_id, path in ((moving["id"], "wexford-input.bin"), (made, "renamed-zanzibar.bin")):
        lab.patch(f"/files/{file_id}", {"mission_id": vault["id"], "path": path}).ok()
    member, outsider = people.person(lab), people.person(lab, email=f"{uuid.uuid4().hex}@elsewhere.test")
    people.grant(lab, member, Right.delete, project_id=place.project["id"])
    ids = {
        "run_id": [claim["run_id"]],
        "file_id": [place.files["drive.bin"]["id"], moving["id"], made],
        "mission_id": [mission, vault["id"]],
        "project_id": [place.project["id"], hidden["id"]],
        "person_id": [member.id],
    }
    elsewhere = ["renamed-zanzibar", "vault mission", hidden["name"], vault["id"], hidden["id"]]
    secrets = [*elsewhere, "wexford-output", "wexford-input", moving["id"], made, sha256(_INPUT)]
    stored = place.files["drive.bin"]["id"]
    return World(lab.as_(member.token), lab.as_(outsider.token), ids, secrets, elsewhere, claim["run_id"], stored)


def _reported(answer: Any, requested: str) -> str:
    """Return the body of a response without the names that the request contained."""
    stored = {**answer.body, "detail": "", "ref": ""} if isinstance(answer.body, dict) else answer.body
    return json.dumps(stored).replace(requested, "")


def _addresses(ids: dict[str, list[str]]) -> list[tuple[str, str, dict[str, str]]]:
    """Return every GET route with every id that fits, as path, the id and the query."""
    match: list[tuple[str, str, dict[str, str]]] = []
    for path, operations in json.loads(_OPENAPI.read_text())["paths"].items():
        if "get" not in operations or path.endswith("/events"):
            continue
        names = [entry["name"] for entry in operations["get"].get("parameters", []) if entry["in"] == "path"]
        if len(names) == 1 and names[0] in ids:
            match += [(path.replace(f"{{{names[0]}}}", entry), entry, {}) for entry in ids[names[0]]]
        elif not names:
            match.append((path, "-", {}))
            queries = [entry["name"] for entry in operations["get"].get("parameters", []) if entry["in"] == "query"]
            match += [(path, entry, {name: entry}) for name in queries if name in ids for entry in ids[name]]
    return match


def test_no_route_shows_files_that_moved_out_of_sight(world: World) -> None:
    seen = 0
    for api in (world.reader, world.outsider):
        for path, requested, query in _addresses(world.ids):
            answer = api.get(path.removeprefix("/api/v1"), query)
            seen += answer.status == 200
            reported = _reported(answer, requested)
            # To its owners, the audit log of a project keeps what happened to the file while it was there.
            secrets = world.elsewhere if "/audit" in path else world.secrets
            leaked = [secret for secret in secrets if secret in reported]
            assert not leaked, (path, query, leaked, reported[:2000])
    assert seen > 50, "the sweep met too few answers to be one"


def test_lineage_still_shows_visible_files(world: World) -> None:
    (reader,) = world.reader.get(f"/files/{world.visible_file_id}/lineage").ok()["read_by"]
    assert (reader["run"]["id"], reader["artifact_count"]) == (world.run_id, 1)
    assert [entry["path"] for entry in reader["inputs"]] == ["drive.bin", "notes/day.txt"]
    assert reader["files"] == []
    (artifact,) = world.reader.all(f"/runs/{world.run_id}/artifacts")
    assert (artifact["path"], artifact["file_id"]) == ("result.bin", None)
    (finding,) = world.reader.get("/findings", {"run_id": world.run_id}).ok()["items"]
    assert (finding["finding"]["message"], finding["finding"]["file"]) == ("odd", None)
    (check,) = world.reader.get("/run-checks", {"run_id": world.run_id}).ok()["items"]
    assert (check["check"]["message"], check["check"]["file"]) == ("odd", None)
    deleted = world.reader.delete(f"/files/{world.visible_file_id}", {"dry_run": "true"}).ok()
    assert (deleted["read_by_runs"], deleted["made_from_it"]) == (1, [])


def test_owners_of_both_places_see_both(world: World, lab: Api) -> None:
    inputs = lab.all(f"/runs/{world.run_id}/inputs")
    assert "wexford-input.bin" in [entry["path"] for entry in inputs]
    (artifact,) = lab.all(f"/runs/{world.run_id}/artifacts")
    assert artifact["file_id"] == world.ids["file_id"][2]
    (reader,) = lab.get(f"/files/{world.visible_file_id}/lineage").ok()["read_by"]
    assert [entry["path"] for entry in reader["files"]] == ["renamed-zanzibar.bin"]
    (metric,) = lab.get("/run-metrics", {"run_id": world.run_id}).ok()["items"]
    assert metric["metric"]["file"] == "wexford-input.bin"


def test_an_input_in_the_trash_of_its_own_mission_is_still_named(world: World, lab: Api, runner: FakeRunner) -> None:
    # Another mission with a run: where a file lies is compared with the mission of its own run, not of any.
    mission = lab.mission(lab.project()["id"])
    stored = upload(lab, mission["id"], "trashed.bin", b"an input that goes to the trash")
    launch(lab, runner, mission, right="READ")
    claim = runner.claim()
    finding = {"file": "trashed.bin", "message": "odd", "code": "odd", "severity": "warning"}
    metric = {"name": "rate", "value": 1, "unit": None, "file": "trashed.bin"}
    runner.finish(claim, report={"findings": [finding], "metrics": [metric]}).ok()
    lab.delete(f"/files/{stored['id']}").ok()
    (reported,) = lab.get("/findings", {"run_id": claim["run_id"]}).ok()["items"]
    assert reported["finding"]["file"] == "trashed.bin"
    assert [entry["file"] for entry in lab.get(f"/runs/{claim['run_id']}").ok()["metrics"]] == ["trashed.bin"]
