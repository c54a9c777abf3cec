"""Runs that no runner can start are refused or shown; failed runs are listed as needing attention."""

from __future__ import annotations

from typing import Any

import pytest

from kleinkram.contract.access import Right, Scope, TokenKind
from kleinkram.server.access.builtin_groups import OWNER_ID
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.runs.conftest import FakeRunner, Place, definition, launch
from tests.integration.upload_client import upload


@pytest.fixture
def single(start_api: StartApi) -> Api:
    """A server with a single account."""
    return start_api()


@pytest.fixture
def own_runner(single: Api) -> FakeRunner:
    """A runner as `klein up` starts it on a machine without Docker."""
    secret = people.token(single, str(OWNER_ID), [Scope.run], kind=TokenKind.runner).secret
    fake_runner = FakeRunner(single.as_(secret), labels=[])
    fake_runner.register(executor="process", isolation="namespaces", images=False)
    return fake_runner


@pytest.fixture
def mission(single: Api) -> Any:
    made = single.mission(single.project()["id"])
    upload(single, made["id"], "drive.bin", b"a drive")
    return made


def test_a_second_account_makes_script_runs_refused_with_the_remedy(
    single: Api, own_runner: FakeRunner, mission: Any
) -> None:
    assert launch(single, own_runner, mission)["waits_for"].startswith("It is queued for ")
    invited = single.post("/people/invitations", {"email": "second@lab.example"}).ok(201)
    remedy = "--isolation namespaces`. Otherwise, install Docker or Podman"
    assert remedy in invited["warning"], "the warning comes before it happens"
    assert remedy in single.get("/admin/health").ok()["invitation_warning"]

    people.person(single)
    expected = {"mission_ids": [mission["id"]], "definition": definition(own_runner), "force": True}
    (item,) = single.post("/runs", expected).ok()["items"]
    assert (item["outcome"], item["problem"]["code"]) == ("refused", "no_runner")
    assert "in namespaces, without containers, which the project does not allow" in item["problem"]["detail"]
    of_project = f"`klein project update {mission['project']['id']} {remedy}"
    assert of_project in item["problem"]["detail"]

    (queued,) = single.get("/runs").ok()["items"]
    assert of_project in queued["waits_for"]
    assert own_runner.claim() is None
    retried = single.post(f"/runs/{queued['id']}/retry?force=true").refused(409, "no_runner")
    assert of_project in retried["detail"]
    health = single.get("/admin/health").ok()
    assert health["runs_problem"].startswith("1 queued run can never start.")
    assert health["invitation_warning"] is None, "a second person has an account already"
    needs = [(entry["kind"], entry["count"], entry["mission"]["id"]) for entry in single.get("/home").ok()["attention"]]
    assert needs == [("runs_cannot_start", 1, mission["id"])]

    single.post(f"/runs/{queued['id']}/cancel").ok()
    assert "Actions cannot be run" in single.get("/admin/health").ok()["runs_problem"], "with nothing queued, too"
    assert single.get("/home").ok()["attention"] == []


def test_a_runner_with_containers_ends_the_problem(single: Api, own_runner: FakeRunner, mission: Any) -> None:
    people.person(single)
    own_runner.register()
    assert launch(single, own_runner, mission)["waits_for"].startswith("It is queued for ")
    health = single.get("/admin/health").ok()
    assert (health["runs_problem"], health["invitation_warning"]) == (None, None)
    assert single.post("/people/invitations", {"email": "third@lab.example"}).ok(201)["warning"] is None


def test_runs_wait_for_a_runner_that_is_temporarily_off(single: Api, own_runner: FakeRunner, mission: Any) -> None:
    single.sql("UPDATE runner SET last_seen_at = now() - interval '1 day'")
    waits = launch(single, own_runner, mission)["waits_for"]
    assert "which is not running" in waits
    assert single.get("/admin/health").ok()["runs_problem"] is None


@pytest.mark.parametrize(
    ("expected", "why"),
    [
        ({"resources": {"cores": 64}}, "it has 4 cores and 64 are asked for"),
        ({"resources": {"gpus": 1}}, "it gives no GPUs"),
        ({"resources": {"labels": ["lidar-box"]}}, "it has no label lidar-box"),
        ({"script": None, "image": "lab/slam", "command": ["slam"]}, "the action is an image"),
    ],
)
def test_requirements_that_no_runner_meets_are_refused(
    single: Api, own_runner: FakeRunner, mission: Any, expected: dict[str, Any], why: str
) -> None:
    action = {key: value for key, value in (definition(own_runner) | expected).items() if value is not None}
    (item,) = single.post("/runs", {"mission_ids": [mission["id"]], "definition": action}).ok()["items"]
    assert item["problem"]["code"] == "no_runner"
    assert why in item["problem"]["detail"]
    assert "klein runner start" in item["problem"]["detail"]


def test_reused_results_need_no_runner(single: Api, own_runner: FakeRunner, mission: Any) -> None:
    launch(single, own_runner, mission)
    claim = own_runner.claim()
    own_runner.heartbeat(claim, image_digest="sha256:stock")
    own_runner.finish(claim).ok()
    people.person(single)
    assert launch(single, own_runner, mission, force=False)["state"] == "done"


def test_failed_runs_need_attention_until_the_same_action_succeeds(lab: Api, runner: FakeRunner, place: Place) -> None:
    member = people.person(lab)
    people.grant(lab, member, Right.read, mission_id=place.mission["id"])
    stranger = lab.as_(people.person(lab).token)

    def needs() -> list[tuple[str, int]]:
        reported = lab.as_(member.token).get("/home").ok()["attention"]
        return [(entry["kind"], entry["count"]) for entry in reported]

    def ended(reason: str, **action: Any) -> Any:
        launch(lab, runner, place.mission, **action)
        claim = runner.claim()
        runner.finish(claim, reason, exit_code=int(reason != "done")).ok()
        return claim["run_id"]

    ended("exit_code")
    ended("exit_code")
    assert needs() == [("runs_failed", 1)], "the same action failed twice: one thing to mend"
    ended("exit_code", name="other")
    assert needs() == [("runs_failed", 2)]
    assert stranger.get("/home").ok()["attention"] == []
    ended("done", script="print('mended')\n")
    assert needs() == [("runs_failed", 1)], "run again from its folder, mended"
    ended("done", name="other")
    assert needs() == []
    old = ended("exit_code")
    lab.sql("UPDATE run SET ended_at = now() - interval '30 days' WHERE id = %s", old)
    assert needs() == []
