"""Results depend on the metadata and checks that an action declares as inputs, and on no others."""

import uuid
from typing import Any

import pytest

from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.runs.conftest import FakeRunner, Place, launch
from tests.integration.runs.test_automatic_runs import add, complete, maintain, publish, runs
from tests.integration.runs.test_project_results import finish, verdict

RULES = "version: 1\nprofiles:\n- name: all\n  files: {'*': {}}\n"
OTHER_RULES = RULES.replace("name: all", "name: other")


@pytest.fixture(autouse=True)
def _files_are_read(lab: Api, place: Place) -> None:
    run_jobs(lab)


def set_metadata(api: Api, mission: Any, **metadata: Any) -> None:
    """Set values of a mission's metadata; None removes one."""
    api.patch(f"/missions/{mission['id']}", {"metadata": metadata}).ok()


def set_rules(lab: Api, project: Any, text: str) -> None:
    lab.call("PUT", f"/projects/{project['id']}/checks", {"text": text}).ok()


def context_of(runner: FakeRunner, claim: Any) -> Any:
    return runner.api.get(f"/runner/runs/{claim['run_id']}/context", {"attempt": claim["attempt"]}).ok()


def started(lab: Api, mission: Any) -> int:
    """Return how many runs there are, after all jobs of two rounds of maintenance."""
    maintain(lab)
    maintain(lab)
    return len(runs(lab, mission))


def test_a_declared_value_that_changes_outdates_results_and_starts_the_action_once(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    set_metadata(lab, place.mission, reference="/odom")
    add(lab, place.project, publish(lab, runner, place.project, inputs={"metadata": ["reference"]}))
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, verdict="good")
    assert verdict(lab, place.mission)[0] == "good"

    set_metadata(lab, place.mission, operator="Ada")
    assert (verdict(lab, place.mission)[0], started(lab, place.mission)) == ("good", 1)

    set_metadata(lab, place.mission, reference="tf:map->base_link")
    assert verdict(lab, place.mission)[0] == "running", "it started by itself"
    assert started(lab, place.mission) == 2
    finish(runner, verdict="bad")
    assert verdict(lab, place.mission)[0] == "bad"

    set_metadata(lab, place.mission, reference="/odom")
    assert (verdict(lab, place.mission)[0], started(lab, place.mission)) == ("good", 2), "the first result counts"
    set_metadata(lab, place.mission, reference=None)
    assert started(lab, place.mission) == 3


def test_what_declares_nothing_is_reused_and_not_run_again(lab: Api, runner: FakeRunner, place: Place) -> None:
    add(lab, place.project, publish(lab, runner, place.project))
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, verdict="good")
    set_metadata(lab, place.mission, reference="/odom")
    set_rules(lab, place.project, RULES)
    assert (verdict(lab, place.mission)[0], started(lab, place.mission)) == ("good", 1)


def test_a_result_is_reused_only_with_the_same_values(lab: Api, runner: FakeRunner, place: Place) -> None:
    set_metadata(lab, place.mission, reference="/odom", robot="spot")
    inputs = {"metadata": ["reference", "unset"]}
    launch(lab, runner, place.mission, force=False, inputs=inputs)
    finish(runner, verdict="good")
    set_metadata(lab, place.mission, robot="anymal")
    again = launch(lab, runner, place.mission, force=False, inputs=inputs)
    assert (again["state"], again["reuses_id"] is not None) == ("done", True)
    set_metadata(lab, place.mission, reference=1)
    launch(lab, runner, place.mission, force=False, inputs=inputs)
    finish(runner, verdict="good")
    set_metadata(lab, place.mission, reference=2)
    other = launch(lab, runner, place.mission, force=False, inputs=inputs)
    assert (other["state"], other["reuses_id"]) == ("queued", None)
    finish(runner)


def test_new_rules_start_the_actions_that_read_them(lab: Api, runner: FakeRunner, place: Place) -> None:
    add(lab, place.project, publish(lab, runner, place.project, inputs={"checks": True}))
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, verdict="good")
    set_rules(lab, place.project, RULES)
    assert [run["state"] for run in runs(lab, place.mission)] == ["done"]
    run_jobs(lab)
    assert started(lab, place.mission) == 2
    assert verdict(lab, place.mission)[0] == "running"
    finish(runner, verdict="good")
    assert (verdict(lab, place.mission)[0], started(lab, place.mission)) == ("good", 2)
    set_metadata(lab, place.mission, robot="spot")
    assert started(lab, place.mission) == 3, "profiles are chosen by all metadata"
    finish(runner, verdict="good")
    set_rules(lab, place.project, "")
    assert started(lab, place.mission) == 4
    finish(runner, verdict="good")


def test_new_rules_start_nothing_on_missions_that_are_not_due(lab: Api, runner: FakeRunner, place: Place) -> None:
    complete(lab, place.mission)
    add(lab, place.project, publish(lab, runner, place.project, inputs={"checks": True}))
    set_rules(lab, place.project, RULES)
    set_metadata(lab, place.mission, robot="spot")
    assert started(lab, place.mission) == 0


def test_a_run_reads_rules_and_metadata_as_at_its_launch(lab: Api, runner: FakeRunner, place: Place) -> None:
    set_rules(lab, place.project, RULES)
    set_metadata(lab, place.mission, reference="/odom", robot="spot")
    launch(lab, runner, place.mission, inputs={"checks": True})
    launch(lab, runner, place.mission, inputs={"metadata": ["reference", "unset"]})
    launch(lab, runner, place.mission)
    set_rules(lab, place.project, OTHER_RULES)
    set_metadata(lab, place.mission, reference="/other", robot="anymal", unset="set")
    checking, reading, plain = (context_of(runner, runner.claim()) for _ in range(3))
    assert (checking["checks"]["version"], checking["checks"]["text"]) == (1, RULES)
    assert checking["mission"]["metadata"] == {"reference": "/odom", "robot": "spot"}
    assert reading["mission"]["metadata"] == {"reference": "/odom", "robot": "anymal"}
    assert plain["mission"]["metadata"] == {"reference": "/other", "robot": "anymal", "unset": "set"}
    assert reading["checks"] is plain["checks"] is None


REFERENCES = """
version: 1
profiles:
- {name: vicon, when: {place: hall}, reference: /vicon/pose}
- {name: others, reference: truth.tum}
"""


def test_only_another_reference_starts_an_evaluation_again(lab: Api, runner: FakeRunner, place: Place) -> None:
    add(lab, place.project, publish(lab, runner, place.project, inputs={"reference": True}))
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, verdict="good")

    set_rules(lab, place.project, RULES)
    set_metadata(lab, place.mission, operator="Ada")
    assert started(lab, place.mission) == 1, "neither names a reference"
    assert verdict(lab, place.mission)[0] == "good"

    set_rules(lab, place.project, REFERENCES)
    assert (started(lab, place.mission), verdict(lab, place.mission)[0]) == (2, "running")
    finish(runner, verdict="good")
    set_rules(lab, place.project, REFERENCES.replace("name: others", "name: every mission"))
    set_metadata(lab, place.mission, operator="Grace", reference=" ")
    assert (started(lab, place.mission), verdict(lab, place.mission)[0]) == (2, "good")

    set_metadata(lab, place.mission, place="hall")
    assert started(lab, place.mission) == 3, "another profile"
    finish(runner, verdict="good")
    set_metadata(lab, place.mission, reference="/odom")
    assert started(lab, place.mission) == 4, "the mission comes first"
    finish(runner, verdict="bad")
    set_rules(lab, place.project, REFERENCES.replace("/vicon/pose", "/vicon/other"))
    assert (started(lab, place.mission), verdict(lab, place.mission)[0]) == (4, "bad"), "which it still does"
    set_rules(lab, place.project, "")
    set_metadata(lab, place.mission, reference=None)
    assert (started(lab, place.mission), verdict(lab, place.mission)[0]) == (4, "good"), "as at first"


def test_a_run_reads_the_reference_as_at_its_launch(lab: Api, runner: FakeRunner, place: Place) -> None:
    set_rules(lab, place.project, REFERENCES)
    set_metadata(lab, place.mission, place="hall")
    shown = f"/missions/{place.mission['id']}/checks"
    assert lab.get(shown).ok()["reference"] == "/vicon/pose"
    launch(lab, runner, place.mission, inputs={"reference": True})
    launch(lab, runner, place.mission)
    set_metadata(lab, place.mission, reference="/odom")
    assert lab.get(shown).ok()["reference"] == "/odom"
    launch(lab, runner, place.mission, inputs={"reference": True, "checks": True})
    set_metadata(lab, place.mission, reference=None, place="field")
    set_rules(lab, place.project, OTHER_RULES)
    assert lab.get(shown).ok()["reference"] is None
    of_profile, undeclared, of_mission = (context_of(runner, runner.claim()) for _ in range(3))
    assert (of_profile["reference"], of_profile["checks"]) == ("/vicon/pose", None)
    assert of_profile["mission"]["metadata"] == {"place": "hall"}, "which chose the profile"
    assert undeclared["reference"] is None
    assert (of_mission["reference"], of_mission["checks"]["text"]) == ("/odom", REFERENCES)


def test_rules_that_cannot_be_read_any_more_name_no_reference(lab: Api, runner: FakeRunner, place: Place) -> None:
    set_rules(lab, place.project, REFERENCES + "# of this project alone\n")
    lab.sql("UPDATE project_checks SET text = 'version: 0' WHERE project_id = %s", place.project["id"])
    launch(lab, runner, place.mission, inputs={"reference": True})
    assert context_of(runner, runner.claim())["reference"] is None


def test_a_project_without_rules_gives_none(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission, inputs={"checks": True})
    set_rules(lab, place.project, RULES)
    assert context_of(runner, runner.claim())["checks"] is None


@pytest.mark.parametrize(
    ("inputs", "count"), [({"metadata": ["robot"]}, 1), ({"checks": True}, 1), ({"reference": True}, 1), ({}, 3)]
)
def test_runs_that_change_metadata_start_no_circle(
    lab: Api, runner: FakeRunner, place: Place, inputs: Any, count: int
) -> None:
    writes = {"right": "WRITE", "network": "api"}
    add(lab, place.project, publish(lab, runner, place.project, inputs={"metadata": ["robot"]}))
    add(lab, place.project, publish(lab, runner, place.project, inputs=inputs, **writes))
    complete(lab, place.mission)
    run_jobs(lab)
    claims = [runner.claim(), runner.claim()]
    (writing,) = [claim for claim in claims if claim["token"]]
    set_metadata(lab.as_(writing["token"]), place.mission, robot=uuid.uuid4().hex)
    assert started(lab, place.mission) == max(2, count), "only what a run without declared metadata changes starts one"


def test_a_new_version_that_reads_rules_runs_when_they_change(lab: Api, runner: FakeRunner, place: Place) -> None:
    action = publish(lab, runner, place.project)
    add(lab, place.project, action)
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, verdict="good")
    reading = action["latest"]["definition"] | {"inputs": {"checks": True}}
    lab.post(f"/actions/{action['id']}/versions", {"definition": reading}).ok(201)
    assert started(lab, place.mission) == 1
    set_rules(lab, place.project, RULES)
    assert started(lab, place.mission) == 2


@pytest.mark.parametrize("name", ["", "x" * 201])
def test_names_of_metadata_are_checked(lab: Api, runner: FakeRunner, place: Place, name: str) -> None:
    body = {
        "project_id": place.project["id"],
        "definition": {"name": "a", "script": "x", "inputs": {"metadata": [name]}},
    }
    problem = lab.post("/actions", body).refused(422, "invalid_request")
    assert problem["problems"][0]["field"] == "body.definition.inputs.metadata.0"
