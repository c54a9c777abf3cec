"""Results of the actions that a project names, and the verdicts that they make."""

import asyncio
import uuid
from typing import Any

from sqlalchemy import text

from kleinkram.contract.access import Right
from kleinkram.contract.project_actions import ProjectActionAdd, RunTrigger
from kleinkram.server.access.actor import find_person
from kleinkram.server.checks.judge import judge_missions
from kleinkram.server.context import AppContext
from kleinkram.server.runs import project_actions
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.jobs import on_site, run_jobs
from tests.integration.runs.conftest import FakeRunner, Place
from tests.integration.runs.test_automatic_runs import add, complete, maintain, publish, runs
from tests.integration.upload_client import upload

GAP = {"severity": "error", "code": "topic.gap", "message": "2 s without a message", "topic": "/imu"}
GRAVITY = {"name": "imu.gravity", "status": "warning", "message": "9.1 instead of 9.81 m/s²", "topic": "/imu"}


def verdict(lab: Api, mission: Any) -> tuple[str, dict[str, str]]:
    """Return the verdict of a mission, and the statuses of its checks by name."""
    run_jobs(lab)
    read = lab.get(f"/missions/{mission['id']}/checks").ok()
    assert lab.get(f"/missions/{mission['id']}").ok()["verdict"] == read["verdict"]
    return read["verdict"], {check["name"]: check["status"] for check in read["checks"]}


def finish(runner: FakeRunner, reason: str = "done", **report: Any) -> None:
    runner.finish(runner.claim(), reason, report=report, image_digest="sha256:stock").ok()


def test_the_latest_result_on_the_present_files_makes_the_verdict(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    action = publish(lab, runner, place.project)
    assert verdict(lab, place.mission) == ("unchecked", {})
    add(lab, place.project, action)
    assert verdict(lab, place.mission) == ("unchecked", {"results.missing": "needs_content"})
    complete(lab, place.mission)
    assert verdict(lab, place.mission) == ("running", {})
    finish(runner, checks=[GRAVITY], findings=[GAP, GAP | {"severity": "info", "code": "note"}])
    assert verdict(lab, place.mission) == (
        "bad",
        {"topic.gap": "error", "imu.gravity": "warning", "results.verdict": "ok"},
    )
    (check,) = [
        check
        for check in lab.get(f"/missions/{place.mission['id']}/checks").ok()["checks"]
        if check["name"] == "topic.gap"
    ]
    (made,) = runs(lab, place.mission)
    assert (check["source"], check["action"], check["run_id"]) == ("action", action["name"], made["id"])
    assert [row["id"] for row in lab.all("/missions", {"project_id": place.project["id"]})] == [place.mission["id"]]

    # Other runs on the mission, of another action or with other parameters, do not count.
    changed = action["latest"]["definition"] | {"description": "better"}
    lab.post(f"/actions/{action['id']}/versions", {"definition": changed}).ok(201)
    assert verdict(lab, place.mission) == ("outdated", {})
    body = {"mission_ids": [place.mission["id"]], "action_id": action["id"]}
    lab.post("/runs", body).ok()
    assert verdict(lab, place.mission)[0] == "running"
    finish(runner, verdict="good")
    assert verdict(lab, place.mission) == ("good", {"results.verdict": "ok"})

    lab.post("/runs", body | {"force": True}).ok()
    assert verdict(lab, place.mission) == ("running", {"results.verdict": "ok"})
    finish(runner, "exit_code")
    assert verdict(lab, place.mission) == ("good", {"results.verdict": "ok"})

    complete(lab, place.mission, False)
    upload(lab, place.mission["id"], "more.bin", b"more")
    assert verdict(lab, place.mission) == ("outdated", {})
    lab.delete(f"/projects/{place.project['id']}/actions/{action['id']}").ok(204)
    assert verdict(lab, place.mission) == ("unchecked", {})


def test_the_reported_verdict_counts_without_checks(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    add(lab, place.project, publish(lab, runner, place.project))
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, verdict="bad")
    assert verdict(lab, place.mission) == ("bad", {"results.verdict": "error"})


def test_an_action_without_inputs_in_a_complete_mission_is_not_made(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    add(lab, place.project, publish(lab, runner, place.project, inputs={"paths": ["*.mcap"]}))
    assert verdict(lab, place.mission) == ("unchecked", {"results.missing": "needs_content"})
    complete(lab, place.mission)
    assert verdict(lab, place.mission) == ("warnings", {"results.missing": "not_made"})
    (check,) = lab.get(f"/missions/{place.mission['id']}/checks").ok()["checks"]
    assert "no file of the mission is its input" in check["message"]
    empty = lab.mission(place.project["id"])
    complete(lab, empty)
    assert verdict(lab, empty) == ("unchecked", {})


def test_a_run_that_fails_counts_only_without_an_earlier_result(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    action = publish(lab, runner, place.project)
    add(lab, place.project, action)
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, "exit_code")
    assert verdict(lab, place.mission) == ("warnings", {"results.failed": "not_made"})
    again = {"mission_ids": [place.mission["id"]], "action_id": action["id"], "force": True}
    for ending, report in (("done", {"findings": [GAP]}), ("exit_code", {})):
        lab.post("/runs", again).ok()
        finish(runner, ending, **report)
        assert verdict(lab, place.mission) == ("bad", {"topic.gap": "error", "results.verdict": "ok"})


def test_a_bad_mission_stays_bad_while_the_action_runs_again(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    action = publish(lab, runner, place.project)
    add(lab, place.project, action)
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, findings=[GAP])
    lab.post("/runs", {"mission_ids": [place.mission["id"]], "action_id": action["id"], "force": True}).ok()
    assert verdict(lab, place.mission) == ("bad", {"topic.gap": "error", "results.verdict": "ok"})


def test_a_finding_with_any_code_can_be_accepted(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    add(lab, place.project, publish(lab, runner, place.project))
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, findings=[GAP | {"code": "gap"}])
    assert verdict(lab, place.mission)[0] == "bad"
    accepted = {"check": "gap", "topic": "/imu", "because": "Known."}
    lab.post(f"/missions/{place.mission['id']}/check-acceptances", accepted).ok(201)
    lab.post(f"/missions/{place.mission['id']}/check-notes", {"check": "gap", "text": "See the log."}).ok(201)
    assert verdict(lab, place.mission)[0] == "good"


def test_an_action_that_could_not_start_is_a_check_that_was_not_made(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    run_jobs(lab)
    action = publish(lab, runner, place.project)
    member = people.person(lab)
    people.grant(lab, member, Right.write, project_id=place.project["id"])
    add(lab.as_(member.token), place.project, action, on="idle", idle_s=60)
    lab.sql("UPDATE project_action SET created_at = created_at - interval '1 day'")
    lab.sql("UPDATE file SET created_at = created_at - interval '1 hour'")
    memberships = "SELECT group_id FROM membership WHERE person_id = %s"
    lab.sql(f"DELETE FROM access_grant WHERE group_id IN ({memberships})", uuid.UUID(member.id))
    maintain(lab)
    assert verdict(lab, place.mission) == ("warnings", {"results.missing": "not_made"})
    (check,) = lab.get(f"/missions/{place.mission['id']}/checks").ok()["checks"]
    assert check["message"].startswith(f"{action['name']}@1 has not run on these files: {member.name}")


def test_a_run_that_judges_nothing_makes_no_mission_good(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    add(lab, place.project, publish(lab, runner, place.project))
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, metrics=[{"name": "messages", "value": 3}])
    assert verdict(lab, place.mission) == ("unchecked", {})


def test_an_acceptance_does_not_cover_what_a_later_run_finds(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    action = publish(lab, runner, place.project)
    add(lab, place.project, action)
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, findings=[GAP])
    assert verdict(lab, place.mission)[0] == "bad"
    accepted = {"check": "topic.gap", "because": "Known."}
    lab.post(f"/missions/{place.mission['id']}/check-acceptances", accepted).ok(201)
    assert verdict(lab, place.mission)[0] == "good"
    lab.post("/runs", {"mission_ids": [place.mission["id"]], "action_id": action["id"], "force": True}).ok()
    finish(runner, findings=[GAP, GAP | {"message": "40 s without a message"}])
    assert verdict(lab, place.mission)[0] == "bad"


def test_the_results_of_an_archived_action_count(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    action = publish(lab, runner, place.project)
    add(lab, place.project, action)
    complete(lab, place.mission)
    run_jobs(lab)
    finish(runner, findings=[GAP])
    assert verdict(lab, place.mission)[0] == "bad"
    lab.patch(f"/actions/{action['id']}", {"archived": True}).ok()
    assert verdict(lab, place.mission)[0] == "bad", "who archives an action of the lab does not decide over projects"
    lab.delete(f"/projects/{place.project['id']}/actions/{action['id']}").ok(204)
    assert verdict(lab, place.mission)[0] == "unchecked"


def test_an_action_added_while_a_mission_is_judged_counts(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    action = publish(lab, runner, place.project)
    complete(lab, place.mission)
    run_jobs(lab)
    mission_id, project_id = uuid.UUID(place.mission["id"]), uuid.UUID(place.project["id"])
    requested = ProjectActionAdd(action_id=uuid.UUID(action["id"]), on=RunTrigger.complete)

    async def add_while_judging(context: AppContext) -> None:
        (person_id,) = (await _rows(context, "SELECT id FROM person ORDER BY created_at LIMIT 1"))[0]
        async with context.database.begin() as db:
            person = await find_person(db, person_id)
            assert person is not None
            actor = person.for_request("add_project_action", request_id=None, address=None)
            await project_actions.add_project_action(db, actor, project_id=project_id, requested=requested)
            judging = asyncio.create_task(_judge(context, mission_id))
            while not await _rows(context, "SELECT FROM pg_locks WHERE locktype = 'advisory' AND NOT granted"):
                assert not judging.done(), "it did not wait for the action"
                await asyncio.sleep(0.01)
        await judging

    on_site(lab, add_while_judging)
    assert verdict(lab, place.mission) == ("warnings", {"results.missing": "not_made"})


async def _judge(context: AppContext, mission_id: uuid.UUID) -> None:
    async with context.database.begin() as db:
        await judge_missions(db, [mission_id])


async def _rows(context: AppContext, statement: str) -> Any:
    async with context.database.begin() as db:
        return (await db.execute(text(statement))).all()
