"""A run that sends the checks of its mission: they count as the project's checks, once, while nothing has changed."""

import hashlib
import uuid
from typing import Any

import pytest

from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Answer, Api
from tests.integration.checks.judged import put_file, topic
from tests.integration.jobs import run_jobs
from tests.integration.runs.conftest import FakeRunner, Place, definition
from tests.integration.runs.test_automatic_runs import add, complete, maintain, publish, runs
from tests.integration.runs.test_declared_inputs import context_of, set_rules
from tests.integration.runs.test_project_results import verdict
from tests.integration.upload_client import upload

RULES = """
version: 1
profiles:
- name: all
  files: {"*": {}}
  images: {/camera: {min_brightness: 12}}
"""
OTHER_RULES = RULES.replace("12", "20")
VERIFY = {"inputs": {"checks": True}, "right": "CREATE", "network": "api"}
GOOD = {"name": "image.black", "status": "ok", "message": "no picture is black", "topic": "/camera"}
BLACK = {**GOOD, "status": "error", "message": "all pictures are black"}
OTHERS = [
    {"name": "file.missing", "status": "ok", "message": "3 files match *"},
    {**GOOD, "name": "image.overexposed"},
    {**GOOD, "name": "image.frozen"},
]


@pytest.fixture(name="action")
def _action(lab: Api, runner: FakeRunner, place: Place) -> Any:
    """An action that makes the checks of its mission by itself, and a mission that awaits it."""
    camera = topic("/camera", rate_hz=10) | {"message_type": "sensor_msgs/msg/CompressedImage"}
    put_file(lab, place.mission["id"], "run.mcap", (camera,))
    run_jobs(lab)
    set_rules(lab, place.project, RULES)
    action = publish(lab, runner, place.project, **VERIFY)
    add(lab, place.project, action)
    complete(lab, place.mission)
    run_jobs(lab)
    return action


def report_of(runner: FakeRunner, claim: Any, *checks: Any, **values: Any) -> dict[str, Any]:
    """Return the report of the checks that a run made, from what it was given."""
    context = context_of(runner, claim)
    report = {"checks": [*OTHERS, *checks], "depth": "content", "document_sha256": context["checks"]["sha256"]}
    files = {file["path"]: file["sha256"] for file in context["files"]}
    return report | {"profiles_applied": ["all"], "files": files} | values


def send(lab: Api, runner: FakeRunner, claim: Any, *checks: Any, **values: Any) -> Answer:
    path = f"/missions/{claim['mission_id']}/check-reports"
    return lab.as_(claim["token"]).post(path, report_of(runner, claim, *checks, **values))


def finish(runner: FakeRunner, claim: Any, *checks: Any, **report: Any) -> None:
    body = {"checks": [*OTHERS, *checks], **report}
    runner.finish(claim, "done", report=body, image_digest="sha256:stock").ok()


def sources(lab: Api, mission: Any, name: str = "image.black") -> list[tuple[str, str]]:
    checks = lab.get(f"/missions/{mission['id']}/checks").ok()["checks"]
    return [(check["status"], check["source"]) for check in checks if check["name"] == name]


@pytest.mark.parametrize(("check", "expected"), [(GOOD, "good"), (BLACK, "bad")])
def test_the_checks_of_a_run_make_the_verdict_once(
    lab: Api, runner: FakeRunner, place: Place, action: Any, check: Any, expected: str
) -> None:
    assert verdict(lab, place.mission)[0] == "running"
    claim = runner.claim()
    made = send(lab, runner, claim, check).ok(201)
    assert (made["run_id"], made["is_current"], made["verdict"]) == (claim["run_id"], True, expected)
    finish(runner, claim, check, verdict=expected)
    assert verdict(lab, place.mission)[0] == expected
    assert sources(lab, place.mission) == [(check["status"], "report")]
    assert sources(lab, place.mission, "file.missing") == [("ok", "server")]
    assert sources(lab, place.mission, "results.verdict") == [("ok", "action")]
    maintain(lab)
    assert len(runs(lab, place.mission)) == 1, "the report starts nothing"


def test_accepting_a_check_covers_what_the_run_found(lab: Api, runner: FakeRunner, place: Place, action: Any) -> None:
    claim = runner.claim()
    send(lab, runner, claim, BLACK).ok(201)
    finish(runner, claim, BLACK, verdict="bad")
    assert verdict(lab, place.mission)[0] == "bad"
    accepted = {"check": "image.black", "because": "The lens was covered."}
    lab.post(f"/missions/{place.mission['id']}/check-acceptances", accepted).ok(201)
    assert verdict(lab, place.mission)[0] == "good"


def test_findings_of_the_run_count_beside_its_report(lab: Api, runner: FakeRunner, place: Place, action: Any) -> None:
    claim = runner.claim()
    send(lab, runner, claim, GOOD).ok(201)
    finding = {"severity": "error", "code": "disk.full", "message": "the recorder stopped"}
    finish(runner, claim, GOOD, findings=[finding])
    assert verdict(lab, place.mission)[0] == "bad"


def test_without_a_report_the_checks_of_the_run_count(lab: Api, runner: FakeRunner, place: Place, action: Any) -> None:
    finish(runner, runner.claim(), BLACK)
    assert verdict(lab, place.mission)[0] == "bad"
    assert ("error", "action") in sources(lab, place.mission)


def test_changed_rules_make_a_report_outdated_until_it_is_made_again(
    lab: Api, runner: FakeRunner, place: Place, action: Any
) -> None:
    claim = runner.claim()
    send(lab, runner, claim, GOOD).ok(201)
    finish(runner, claim, GOOD)
    assert verdict(lab, place.mission)[0] == "good"
    set_rules(lab, place.project, OTHER_RULES)
    assert lab.get(f"/missions/{place.mission['id']}").ok()["verdict"] == "outdated"
    maintain(lab)
    assert verdict(lab, place.mission)[0] == "running"
    again = runner.claim()
    assert again["run_id"] != claim["run_id"]
    send(lab, runner, again, BLACK).ok(201)
    finish(runner, again, BLACK)
    assert verdict(lab, place.mission)[0] == "bad"
    set_rules(lab, place.project, RULES)
    maintain(lab)
    assert verdict(lab, place.mission)[0] == "good", "the first report is by these rules"
    assert len(runs(lab, place.mission)) == 2


@pytest.mark.parametrize("change", ["rules", "files"])
def test_a_report_of_a_run_that_saw_something_else_does_not_count(
    lab: Api, runner: FakeRunner, place: Place, action: Any, change: str
) -> None:
    claim = runner.claim()
    report = report_of(runner, claim, GOOD)
    if change == "rules":
        set_rules(lab, place.project, OTHER_RULES)
    else:
        lab.delete(f"/files/{place.files['drive.bin']['id']}").ok()
    run_jobs(lab)
    made = lab.as_(claim["token"]).post(f"/missions/{claim['mission_id']}/check-reports", report).ok(201)
    assert not made["is_current"]
    finish(runner, claim, GOOD)
    assert verdict(lab, place.mission)[0] == "running", "it runs again by itself"
    assert ("ok", "report") not in sources(lab, place.mission)


def test_a_report_of_other_rules_does_not_hide_the_checks_of_its_run(
    lab: Api, runner: FakeRunner, place: Place, action: Any
) -> None:
    claim = runner.claim()
    send(lab, runner, claim, GOOD, document_sha256=hashlib.sha256(b"others").hexdigest()).ok(201)
    finish(runner, claim, BLACK)
    assert verdict(lab, place.mission)[0] == "bad"


def test_a_report_by_hand_does_not_count_the_run_twice(lab: Api, runner: FakeRunner, place: Place, action: Any) -> None:
    claim = runner.claim()
    report = report_of(runner, claim, BLACK)
    send(lab, runner, claim, BLACK).ok(201)
    finish(runner, claim, BLACK)
    made = lab.post(f"/missions/{place.mission['id']}/check-reports", report).ok(201)
    assert made["run_id"] is None
    assert verdict(lab, place.mission)[0] == "bad"
    assert sources(lab, place.mission) == [("error", "report")]
    reports = lab.get(f"/missions/{place.mission['id']}/checks").ok()["reports"]
    assert [one["run_id"] for one in reports] == [None, claim["run_id"]]


def test_a_run_reports_on_its_own_mission_with_the_right_to_create(lab: Api, runner: FakeRunner, place: Place) -> None:
    other = lab.mission(place.project["id"])
    upload(lab, other["id"], "a.bin", uuid.uuid4().bytes)
    set_rules(lab, place.project, RULES)
    for values, mission, status, code in (
        (VERIFY, other, 404, "not_found"),
        (VERIFY | {"right": "READ"}, place.mission, 403, "scope_missing"),
    ):
        body = {"mission_ids": [place.mission["id"]], "definition": definition(runner, **values), "force": True}
        lab.post("/runs", body).ok()
        claim = runner.claim()
        report = report_of(runner, claim, GOOD)
        lab.as_(claim["token"]).post(f"/missions/{mission['id']}/check-reports", report).refused(status, code)


def test_a_reader_cannot_launch_it(lab: Api, runner: FakeRunner, place: Place, action: Any) -> None:
    reader = people.person(lab)
    people.grant(lab, reader, Right.read, project_id=place.project["id"])
    body = {"mission_ids": [place.mission["id"]], "action_id": action["id"]}
    (refused,) = lab.as_(reader.token).post("/runs", body).ok()["items"]
    assert (refused["outcome"], refused["problem"]["code"]) == ("refused", "forbidden")
