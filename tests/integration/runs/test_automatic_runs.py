"""Actions that a project names run by themselves: once on the same files with the same version, for who added them."""

import uuid
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from kleinkram.contract.access import Right
from kleinkram.contract.isolation import Isolation
from kleinkram.server.context import AppContext
from kleinkram.server.maintenance import maintain_runs
from kleinkram.server.runs.automatic import start_due_runs
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.jobs import in_worker, on_site, run_jobs
from tests.integration.runs.conftest import FakeRunner, Place, definition
from tests.integration.upload_client import upload


def publish(lab: Api, runner: FakeRunner, project: Any, **values: Any) -> Any:
    """Publish an action in a project."""
    body = {
        "project_id": project["id"],
        "definition": definition(runner, name=f"verify-{uuid.uuid4().hex[:6]}", **values),
    }
    return lab.post("/actions", body).ok(201)


def add(api: Api, project: Any, action: Any, on: str = "complete", **values: Any) -> Any:
    return api.post(f"/projects/{project['id']}/actions", {"action_id": action["id"], "on": on, **values}).ok(201)


def complete(lab: Api, mission: Any, completed: bool = True) -> None:
    lab.patch(f"/missions/{mission['id']}", {"completed": completed}).ok()


def runs(lab: Api, mission: Any) -> list[Any]:
    return lab.all("/runs", {"mission_id": mission["id"]})


def maintain(lab: Api) -> None:
    """Do what the maintenance does each minute, and all jobs."""
    run_jobs(lab)
    in_worker(lab, lambda resources: maintain_runs(resources.context))
    run_jobs(lab)


def test_an_action_runs_once_when_a_mission_is_complete(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    action = publish(lab, runner, place.project)
    added = add(lab, place.project, action)
    assert (added["on"], added["idle_s"], added["action"]["version"]) == ("complete", None, 1)
    assert lab.get(f"/projects/{place.project['id']}/actions").ok()["items"] == [added]
    maintain(lab)
    assert runs(lab, place.mission) == [], "it is not complete"
    complete(lab, place.mission)
    run_jobs(lab)
    (made,) = runs(lab, place.mission)
    assert (made["action"]["id"], made["state"], made["cause"]["person"]["name"]) == (
        action["id"],
        "queued",
        added["added_by"]["name"],
    )
    maintain(lab)
    complete(lab, place.mission, False)
    complete(lab, place.mission)
    maintain(lab)
    assert [run["id"] for run in runs(lab, place.mission)] == [made["id"]], "the same files, the same version"
    upload(lab, place.mission["id"], "more.bin", b"more")
    run_jobs(lab)
    assert len(runs(lab, place.mission)) == 2, "other files"


def test_a_new_version_runs_on_demand_only(lab: Api, runner: FakeRunner, place: Place) -> None:
    action = publish(lab, runner, place.project)
    add(lab, place.project, action)
    complete(lab, place.mission)
    run_jobs(lab)
    changed = action["latest"]["definition"] | {"description": "better"}
    lab.post(f"/actions/{action['id']}/versions", {"definition": changed}).ok(201)
    maintain(lab)
    assert [run["action"]["version"] for run in runs(lab, place.mission)] == [1]


@pytest.mark.parametrize(("changes", "text"), [({"right": "DELETE"}, "DELETE"), ({"network": "open"}, "open")])
def test_a_version_that_asks_for_more_does_not_run_until_it_is_added_again(
    lab: Api, runner: FakeRunner, place: Place, changes: Any, text: str
) -> None:
    action = publish(lab, runner, place.project)
    add(lab, place.project, action)
    changed = action["latest"]["definition"] | changes
    lab.post(f"/actions/{action['id']}/versions", {"definition": changed}).ok(201)
    complete(lab, place.mission)
    run_jobs(lab)
    maintain(lab)
    assert runs(lab, place.mission) == []
    (listed,) = lab.get(f"/projects/{place.project['id']}/actions").ok()["items"]
    assert f"{action['name']}@2 asks for" in listed["problem"]
    assert text in listed["problem"]
    add(lab, place.project, action)
    complete(lab, place.mission, False)
    complete(lab, place.mission)
    lab.sql("UPDATE project_action_mission SET retry_at = now()")
    maintain(lab)
    assert [run["action"]["version"] for run in runs(lab, place.mission)] == [2]


def test_missions_that_were_complete_before_are_left_alone(lab: Api, runner: FakeRunner, place: Place) -> None:
    complete(lab, place.mission)
    run_jobs(lab)
    add(lab, place.project, publish(lab, runner, place.project))
    maintain(lab)
    assert runs(lab, place.mission) == []


def test_an_action_runs_once_files_are_idle(lab: Api, runner: FakeRunner, place: Place) -> None:
    add(lab, place.project, publish(lab, runner, place.project), on="idle", idle_s=60)
    mission = lab.mission(place.project["id"])
    upload(lab, mission["id"], "a.bin", uuid.uuid4().bytes)
    run_jobs(lab)
    maintain(lab)
    assert runs(lab, mission) == []
    later = "UPDATE file SET created_at = created_at - interval '61 seconds' WHERE mission_id = %s"
    lab.sql(later, uuid.UUID(mission["id"]))
    lab.sql("UPDATE project_action SET created_at = created_at - interval '90 seconds'")
    maintain(lab)
    maintain(lab)
    assert len(runs(lab, mission)) == 1
    assert runs(lab, place.mission) == []


def put_back(runner: FakeRunner, name: str) -> Any:
    """Claim a run and end it with a file that becomes one of the mission; return the claim."""
    claim = runner.claim()
    runner.upload_artifact(claim, name, name.encode())
    runner.finish(claim, report={"mission_files": [{"path": name, "to": f"derived/{name}"}]}).ok()
    return claim


def names(lab: Api, mission: Any) -> list[str]:
    """Return the actions of the runs on a mission, latest first."""
    return [run["action"]["name"] for run in runs(lab, mission)]


def test_what_reads_derived_files_runs_after_what_makes_them(lab: Api, runner: FakeRunner, place: Place) -> None:
    reads = publish(lab, runner, place.project, right="CREATE", inputs={"derived": True})
    makes = publish(lab, runner, place.project, right="CREATE")
    for action in (reads, makes):
        add(lab, place.project, action)
    run_jobs(lab)
    complete(lab, place.mission)
    run_jobs(lab)
    maintain(lab)
    assert names(lab, place.mission) == [makes["name"]], "what reads its files waits"
    put_back(runner, "path.tum")
    run_jobs(lab)
    assert names(lab, place.mission) == [reads["name"], makes["name"]]
    claim = put_back(runner, "errors.csv")
    assert "derived/path.tum" in {entry["path"] for entry in lab.all(f"/runs/{claim['run_id']}/inputs")}
    maintain(lab)
    maintain(lab)
    assert len(runs(lab, place.mission)) == 2, "it does not start itself, nor what reads no derived files"

    body = {"mission_ids": [place.mission["id"]], "action_id": makes["id"], "force": True}
    assert lab.post("/runs", body).ok()["items"][0]["outcome"] == "created"
    put_back(runner, "other.tum")
    run_jobs(lab)
    assert names(lab, place.mission)[0] == reads["name"], "there is another file to read"
    runner.finish(runner.claim()).ok()
    maintain(lab)
    assert len(runs(lab, place.mission)) == 4


def test_what_reads_derived_files_runs_also_if_none_are_made(lab: Api, runner: FakeRunner, place: Place) -> None:
    makes = publish(lab, runner, place.project)
    reads = publish(lab, runner, place.project, inputs={"derived": True})
    for action in (makes, reads):
        add(lab, place.project, action)
    run_jobs(lab)
    complete(lab, place.mission)
    run_jobs(lab)
    runner.finish(runner.claim(), "exit_code", exit_code=1).ok()
    maintain(lab)
    assert names(lab, place.mission) == [reads["name"], makes["name"]]


def test_what_a_run_put_back_does_not_start_it_again(lab: Api, runner: FakeRunner, place: Place) -> None:
    # Also where an action reads derived files.
    action = publish(lab, runner, place.project, right="CREATE", inputs={"derived": True})
    add(lab, place.project, action)
    run_jobs(lab)
    complete(lab, place.mission)
    run_jobs(lab)
    claim = runner.claim()
    runner.upload_artifact(claim, "clean.bin", b"cleaned")
    runner.finish(claim, report={"mission_files": [{"path": "clean.bin", "to": "clean/drive.bin"}]}).ok()
    run_jobs(lab)
    maintain(lab)
    assert len(runs(lab, place.mission)) == 1
    assert len(lab.all("/files", {"mission_id": place.mission["id"]})) == 3


def test_it_acts_for_who_added_it_and_says_so_once_they_may_not(lab: Api, runner: FakeRunner, place: Place) -> None:
    member = people.person(lab)
    people.grant(lab, member, Right.write, project_id=place.project["id"])
    action = publish(lab, runner, place.project)
    added = add(lab.as_(member.token), place.project, action)
    lab.sql(
        "DELETE FROM access_grant WHERE project_id = %s AND group_id IN (SELECT group_id FROM membership"
        " WHERE person_id = %s)",
        uuid.UUID(place.project["id"]),
        uuid.UUID(member.id),
    )
    complete(lab, place.mission)
    run_jobs(lab)
    assert runs(lab, place.mission) == []
    (listed,) = lab.get(f"/projects/{place.project['id']}/actions").ok()["items"]
    assert listed["problem_count"] == 1
    assert listed["problem"].startswith(f"{added['added_by']['name']}, who added {action['name']}, may not run it here")
    people.grant(lab, member, Right.write, project_id=place.project["id"])
    lab.sql("UPDATE project_action_mission SET retry_at = now()")
    maintain(lab)
    (made,) = runs(lab, place.mission)
    assert made["cause"]["person"]["id"] == member.id
    assert lab.get(f"/projects/{place.project['id']}/actions").ok()["items"][0]["problem"] is None


def test_several_workers_at_once_start_one_run(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_jobs(lab)
    add(lab, place.project, publish(lab, runner, place.project))
    complete(lab, place.mission)

    async def start(context: AppContext) -> None:
        async with context.database.begin() as db:
            await start_due_runs(db, uuid.UUID(place.mission["id"]), weakest=Isolation.namespaces)

    with ThreadPoolExecutor(6) as threads:
        for future in [threads.submit(on_site, lab, start) for _ in range(6)]:
            future.result(60)
    assert len(runs(lab, place.mission)) == 1


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"on": "complete", "idle_s": 60}, ""),
        ({"on": "idle", "idle_s": 0}, "idle_s"),
        ({"on": "often"}, "on"),
        ({"on": "complete", "parameters": {"unknown": 1}}, "parameters.unknown"),
    ],
)
def test_invalid_additions_are_refused(
    lab: Api, runner: FakeRunner, place: Place, body: dict[str, Any], field: str
) -> None:
    action = publish(lab, runner, place.project)
    path = f"/projects/{place.project['id']}/actions"
    problem = lab.post(path, {"action_id": action["id"], **body}).refused(422, "invalid_request")
    assert field in problem["problems"][0]["field"]
    assert lab.get(path).ok()["items"] == []


def test_actions_of_other_projects_cannot_be_named(lab: Api, runner: FakeRunner, place: Place) -> None:
    action = publish(lab, runner, lab.project())
    body = {"action_id": action["id"], "on": "complete"}
    problem = lab.post(f"/projects/{place.project['id']}/actions", body).refused(422, "invalid_request")
    assert "an action of another project" in problem["problems"][0]["message"]


def test_a_removed_action_runs_no_more(lab: Api, runner: FakeRunner, place: Place) -> None:
    action = publish(lab, runner, place.project)
    add(lab, place.project, action)
    lab.delete(f"/projects/{place.project['id']}/actions/{action['id']}").ok(204)
    complete(lab, place.mission)
    maintain(lab)
    assert runs(lab, place.mission) == []
    operations = [event["operation"] for event in lab.events(place.project["id"])]
    assert operations[:2] == ["project.remove_action", "project.add_action"]
