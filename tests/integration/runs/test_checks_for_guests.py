"""What people without an account see of checks: by a link to a whole mission, or in a public project."""

import json
import uuid
from dataclasses import dataclass
from typing import Any

import pytest

from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.runs.conftest import FakeRunner, Place
from tests.integration.runs.test_automatic_runs import add, complete, publish, runs
from tests.integration.runs.test_project_results import GAP, GRAVITY

_RULES = "version: 1\nprofiles:\n- name: all\n  files: {'*.bag': {}}\n- when: {robot: spot}\n  files: {'*': {}}\n"


@dataclass
class _World:
    """A mission with checks of all sources: of the index, of two actions, and what people added."""

    mission_id: str
    project_id: str
    person: people.Person
    hidden: dict[str, str]


@pytest.fixture(name="world")
def _world(lab: Api, runner: FakeRunner, place: Place) -> _World:
    address = f"zoe-{uuid.uuid4().hex[:8]}@example.org"
    person = people.person(lab, "Zoë Unnamed", email=address)
    people.grant(lab, person.group_id, Right.delete, project_id=place.project["id"])
    api, mission_id, project_id = lab.as_(person.token), place.mission["id"], place.project["id"]
    run_jobs(lab)
    verify, crash = (publish(api, runner, place.project) for _ in range(2))
    for action in (verify, crash):
        add(api, place.project, action)
    api.call("PUT", f"/projects/{project_id}/checks", {"text": _RULES}).ok()
    complete(api, place.mission)
    run_jobs(lab)
    for _ in range(2):
        claim = runner.claim()
        failed = claim["action"] is not None and claim["action"]["id"] == crash["id"]
        report = {} if failed else {"checks": [GRAVITY], "findings": [GAP]}
        message = {"message": "the key of Zoë Unnamed is wrong"} if failed else {}
        reason = "exit_code" if failed else "done"
        runner.finish(claim, reason, report=report, image_digest="sha256:stock", **message).ok()
    run_jobs(lab)
    checks = f"/missions/{mission_id}"
    for body in ({"check": "file.missing", "because": "Recorded as MCAP."}, {"check": "topic.gap", "because": "Old."}):
        accepted = api.post(f"{checks}/check-acceptances", body).ok(201)
    api.delete(f"{checks}/check-acceptances/{accepted['id']}").ok()
    note = api.post(f"{checks}/check-notes", {"check": "topic.gap", "text": "Ask the driver."}).ok(201)
    rows = lab.sql(
        "SELECT path, encode(sha256, 'hex') FROM file JOIN blob ON blob.id = blob_id WHERE mission_id = %s", mission_id
    )
    ok = {"name": "image.black", "status": "ok", "message": "No picture is black."}
    sent: dict[str, Any] = {"checks": [ok], "depth": "content", "document_sha256": "0" * 64, "profiles_applied": []}
    sent["files"] = dict(rows)
    report_id = api.post(f"{checks}/check-reports", sent).ok(201)["id"]
    run_jobs(lab)
    hidden = {
        "a name": person.name,
        "a person": person.id,
        "an address": address,
        "a reason that was withdrawn": "Old.",
        "a note": "Ask the driver.",
        "the id of a note": note["id"],
        "a report": report_id,
        "why a run failed": "the key of",
    }
    hidden |= {f"run {number}": run["id"] for number, run in enumerate(runs(lab, place.mission))}
    return _World(mission_id, project_id, person, hidden)


def _of_checks(guest: Api, world: _World) -> dict[str, Any]:
    """Return everything that a link answers about checks, by path."""
    mission = f"/missions/{world.mission_id}"
    answers = {path: guest.get(path).ok() for path in (f"{mission}/checks", f"{mission}/checks?all=true", "/missions")}
    answers["search"] = guest.get("/search", {"query": "check:topic.gap verdict:bad"}).ok()
    answers["facets"] = guest.get("/search/facets").ok()
    return answers


def test_a_link_shows_verdict_checks_and_reasons_and_no_people_notes_runs_and_reports(lab: Api, world: _World) -> None:
    answers = _of_checks(lab.as_(world.person.token), world)
    assert answers["search"]["missions"]["total"] == 1
    person = answers[f"/missions/{world.mission_id}/checks?all=true"]
    assert [len(person[name]) for name in ("acceptances", "notes", "reports")] == [2, 1, 1]
    seen = json.dumps(person, ensure_ascii=False)
    assert [name for name, text in world.hidden.items() if text not in seen] == ["an address"]

    guest = lab.as_(people.share(lab, world.mission_id).secret)
    shown = _of_checks(guest, world)
    assert (shown["search"]["missions"]["total"], shown["/missions"]["items"][0]["verdict"]) == (1, "bad")
    for path, answer in shown.items():
        text = json.dumps(answer, ensure_ascii=False)
        known = {name for name, value in world.hidden.items() if value in text}
        assert not known, f"{path} shows {known}"

    read = guest.get(f"/missions/{world.mission_id}/checks", {"all": "true"}).ok()
    checks = {check["name"]: check for check in read["checks"]}
    assert read["verdict"] == "bad"
    assert read["counts"] == person["counts"]
    assert [one["name"] for one in read["checks"]] == [one["name"] for one in person["checks"]]
    for name in ("profiles_applied", "profiles_left_out", "checks_number", "is_current", "evaluated_at", "bad_since"):
        assert read[name] == person[name]
    (acceptance,) = read["acceptances"]
    assert (acceptance["because"], acceptance["created_by"], acceptance["ended_by"]) == (
        "Recorded as MCAP.",
        None,
        None,
    )
    assert checks["file.missing"]["acceptance_id"] == acceptance["id"]
    assert (read["notes"], read["reports"]) == ([], [])
    assert (checks["topic.gap"]["message"], checks["topic.gap"]["topic"]) == (GAP["message"], "/imu")
    assert checks["topic.gap"]["run_id"] is None
    assert checks["results.failed"]["message"].endswith(" failed")


def test_visitors_of_a_public_project_see_the_same_as_with_a_link(lab: Api, world: _World) -> None:
    path = f"/missions/{world.mission_id}/checks"
    by_link = lab.as_(people.share(lab, world.mission_id).secret).get(path).ok()
    lab.sql("UPDATE project SET is_public = true WHERE id = %s", world.project_id)
    assert lab.as_(None).get(path).ok() == by_link


def test_a_link_shows_nothing_else_of_checks(lab: Api, world: _World) -> None:
    guest = lab.as_(people.share(lab, world.mission_id).secret)
    for path in ("checks", "checks/versions", "checks/versions/1", "checks/matrix", "checks/trend"):
        guest.get(f"/projects/{world.project_id}/{path}").refused(404, "not_found")
    for path in ("/run-checks", "/findings", "/run-metrics"):
        guest.get(path, {"mission_id": world.mission_id}).refused(403, "scope_missing")
    for text in ("finding:topic.gap", "metric.ate_rmse>0.5"):
        guest.get("/search", {"query": text}).refused(422, "invalid_query")
