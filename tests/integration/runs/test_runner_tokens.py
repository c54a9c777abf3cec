"""The token of a runner: valid for one runner, and for its projects and labels."""

import uuid
from typing import Any

import pytest

from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, definition, launch


def _token(lab: Api, **expected: Any) -> Any:
    return lab.post("/tokens", {"name": "for a runner", "kind": "runner", **expected}).ok(201)


def _runner(lab: Api, made: Any, **values: Any) -> FakeRunner:
    return FakeRunner(lab.as_(made["secret"]), **values)


def test_the_first_runner_that_uses_a_token_is_the_only_one(lab: Api) -> None:
    made = _token(lab)
    first, second = _runner(lab, made), _runner(lab, made)
    first.register()
    refused = second.api.post("/runners", second.registration()).refused(403, "forbidden")
    assert "klein token create" in refused["detail"]
    first.register()
    (listed,) = [entry for entry in lab.all("/tokens") if entry["id"] == made["token"]["id"]]
    assert listed["runner"] == {"id": first.id, "name": f"runner {first.id[:4]}"}
    (shown,) = [entry for entry in lab.all("/runners") if entry["id"] == first.id]
    assert shown["token"]["id"] == made["token"]["id"]
    assert "token.bind" in [event["operation"] for event in lab.events(made["token"]["id"])]


def test_a_token_of_the_same_person_reaches_no_runs_of_another_runner(lab: Api, place: Place) -> None:
    runner, other = (_runner(lab, _token(lab)) for _ in range(2))
    runner.register()
    other.register()
    launch(lab, runner, place.mission)
    claim = runner.claim()
    attempt = {"attempt": str(claim["attempt"])}
    other.api.get(f"/runner/runs/{claim['run_id']}/context", attempt).refused(409, "run_gone")
    other.finish(claim).refused(409, "run_gone")
    other.api.post(f"/runners/{runner.id}/claims", {"free": other.registration()["capacity"]}).refused(403, "forbidden")
    other.api.post(f"/runners/{runner.id}/heartbeats", {"runs": []}).refused(403, "forbidden")
    assert runner.heartbeat(claim) == "active"


def test_a_token_that_names_its_runner_is_for_no_other(lab: Api) -> None:
    mine, other = (FakeRunner(lab) for _ in range(2))
    made = _token(lab, runner_id=mine.id)
    lab.as_(made["secret"]).post("/runners", other.registration()).refused(403, "forbidden")
    lab.as_(made["secret"]).post("/runners", mine.registration()).ok()


def test_a_new_token_cannot_replace_the_valid_token_of_a_runner(lab: Api) -> None:
    made = _token(lab)
    runner = _runner(lab, made)
    runner.register()
    lab.as_(_token(lab)["secret"]).post("/runners", runner.registration()).refused(403, "forbidden")
    lab.delete(f"/tokens/{made['token']['id']}").ok(204)
    lab.as_(_token(lab)["secret"]).post("/runners", runner.registration()).ok()


def test_a_token_of_some_projects_gets_only_runs_on_these(lab: Api, place: Place) -> None:
    elsewhere = lab.project()
    runner = _runner(lab, _token(lab, project_ids=[elsewhere["id"]]))
    runner.register()
    expected = {"mission_ids": [place.mission["id"]], "definition": definition(runner), "force": True}
    (refused,) = lab.post("/runs", expected).ok()["items"]
    assert refused["problem"]["code"] == "no_runner"
    assert f"{runner.registration()['name']}: its token is limited to other projects" in refused["problem"]["detail"]
    allowed = _runner(lab, _token(lab, project_ids=[place.project["id"]]), labels=runner.labels)
    allowed.register()
    made = launch(lab, runner, place.mission)
    assert runner.claim() is None
    assert allowed.claim()["run_id"] == made["id"]


def test_a_token_of_some_labels_gets_only_runs_that_ask_for_one(lab: Api, place: Place) -> None:
    label = f"gpu-{uuid.uuid4().hex[:6]}"
    runner = _runner(lab, _token(lab, runner_labels=[label]), labels=[label])
    runner.register()
    plain = lab.post("/runs", _run(place, [])).ok()["items"][0]["run"]
    assert runner.claim() is None
    requested = lab.post("/runs", _run(place, [label])).ok()["items"][0]["run"]
    assert runner.claim()["run_id"] == requested["id"]
    lab.post(f"/runs/{plain['id']}/cancel").ok()
    greedy = FakeRunner(runner.api, id=runner.id, labels=[label, "another"])
    refused = greedy.api.post("/runners", greedy.registration()).refused(403, "forbidden")
    assert "another" in refused["detail"]


@pytest.mark.parametrize(
    "expected",
    [
        {"kind": "runner", "mission_ids": [str(uuid.uuid4())]},
        {"kind": "runner", "scopes": ["read"]},
        {"kind": "personal", "runner_id": str(uuid.uuid4())},
        {"kind": "personal", "runner_labels": ["gpu"]},
    ],
)
def test_invalid_token_limits_are_refused(lab: Api, expected: dict[str, Any]) -> None:
    lab.post("/tokens", {"name": "odd", **expected}).refused(422, "invalid_request")


def _run(place: Place, labels: list[str]) -> dict[str, Any]:
    action = {"name": "count", "script": "print('hello')\n", "resources": {"labels": labels}}
    return {"mission_ids": [place.mission["id"]], "definition": action, "force": True}
