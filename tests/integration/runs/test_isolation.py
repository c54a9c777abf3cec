"""The owner of a project allows a class of isolation: which runners get its runs, and who may change that."""

from __future__ import annotations

from typing import Any

import pytest

from kleinkram.contract.access import Right, Scope, TokenKind
from kleinkram.server.access.builtin_groups import OWNER_ID
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.runs.conftest import FakeRunner, Place, another, launch
from tests.integration.upload_client import upload


def _weak(lab: Api, isolation: str) -> FakeRunner:
    """Return a further runner, of processes with this isolation, on a server with several accounts."""
    people.person(lab)
    return _owners_runner(lab, isolation)


def _owners_runner(api: Api, isolation: str) -> FakeRunner:
    """Return a runner of the owner, as that of `klein up`."""
    secret = people.token(api, str(OWNER_ID), [Scope.run], kind=TokenKind.runner).secret
    weak = FakeRunner(api.as_(secret))
    weak.register(executor="process", isolation=isolation, images=False)
    return weak


def _allow(api: Api, project: Any, isolation: str) -> None:
    api.patch(f"/projects/{project['id']}", {"isolation": isolation}).ok()


def test_the_owner_of_a_project_lets_its_runs_start_without_containers(lab: Api, place: Place) -> None:
    weak = _weak(lab, "namespaces")
    assert lab.get(f"/projects/{place.project['id']}").ok()["isolation"] == "container"
    _allow(lab, place.project, "namespaces")
    queued = launch(lab, weak, place.mission)
    assert queued["waits_for"].startswith("It is queued for ")
    assert queued["isolation"] is None

    other = lab.mission(lab.project()["id"])
    upload(lab, other["id"], "drive.bin", b"of another project")
    (refused,) = _launch_refused(lab, weak, other)
    assert "which the project does not allow" in refused["detail"], "projects do not allow it for each other"

    claimed = weak.claim()
    assert claimed["run_id"] == queued["id"]
    weak.heartbeat(claimed, image_digest="sha256:stock")
    weak.finish(claimed).ok()
    assert lab.get(f"/runs/{queued['id']}").ok()["isolation"] == "namespaces"
    reused = launch(lab, weak, place.mission, force=False)
    assert (reused["reuses_id"], reused["isolation"]) == (queued["id"], "namespaces"), "it is that of the results"


def _launch_refused(api: Api, runner: FakeRunner, mission: Any) -> list[Any]:
    action = {"name": "count", "script": "print(1)\n", "resources": {"labels": runner.labels}}
    items = api.post("/runs", {"mission_ids": [mission["id"]], "definition": action, "force": True}).ok()["items"]
    assert [item["outcome"] for item in items] == ["refused"]
    return [item["problem"] for item in items]


def test_the_project_of_now_decides_about_queued_runs_and_started_ones_stay(lab: Api, place: Place) -> None:
    weak = _weak(lab, "namespaces")
    _allow(lab, place.project, "namespaces")
    started, queued = launch(lab, weak, place.mission), launch(lab, weak, place.mission)
    claimed = weak.claim()
    strict = lab.project()
    lab.patch(f"/missions/{place.mission['id']}", {"project_id": strict["id"]}).ok()

    assert weak.claim() is None
    waits = lab.get(f"/runs/{queued['id']}").ok()["waits_for"]
    assert f"`klein project update {strict['id']} --isolation namespaces`" in waits
    assert weak.heartbeat(claimed) == "active"
    weak.finish(claimed).ok()
    assert lab.get(f"/runs/{started['id']}").ok()["state"] == "done"

    _allow(lab, strict, "namespaces")
    assert weak.claim()["run_id"] == queued["id"]


def test_a_stricter_project_stops_queued_runs_until_a_stronger_runner_comes(lab: Api, place: Place) -> None:
    weak = _weak(lab, "namespaces")
    _allow(lab, place.project, "namespaces")
    queued = launch(lab, weak, place.mission)
    _allow(lab, place.project, "container")
    assert weak.claim() is None
    strong = another(lab, weak)
    strong.register()
    assert strong.claim()["run_id"] == queued["id"]
    assert lab.get(f"/runs/{queued['id']}").ok()["isolation"] == "container"


def test_a_lost_run_forgets_the_isolation_of_the_runner_that_lost_it(lab: Api, place: Place) -> None:
    weak = _weak(lab, "namespaces")
    _allow(lab, place.project, "namespaces")
    queued = launch(lab, weak, place.mission)
    weak.claim()
    lab.sql("UPDATE run SET lease_ends_at = now() - interval '1 s' WHERE id = %s", queued["id"])
    strong = another(lab, weak)
    strong.register(networks=["none"])
    assert strong.claim()["attempt"] == 2
    assert lab.get(f"/runs/{queued['id']}").ok()["isolation"] == "container"


def test_no_isolation_is_refused_unless_an_admin_lets_owners_allow_it(lab: Api, place: Place) -> None:
    path = f"/projects/{place.project['id']}"
    refused = lab.patch(path, {"isolation": "none"}).refused(422, "invalid_request")
    assert refused["problems"][0]["field"] == "isolation"
    assert "this server allows namespaces at least" in refused["problems"][0]["message"]
    assert lab.get("/service").ok()["weakest_isolation"] == "namespaces"

    bare = _weak(lab, "none")
    _allow(lab, place.project, "namespaces")
    (problem,) = _launch_refused(lab, bare, place.mission)
    assert "without any isolation, which this server does not allow" in problem["detail"]
    assert "KLEINKRAM_WEAKEST_ISOLATION=none" in problem["detail"]


@pytest.mark.parametrize(("weakest", "gets_it"), [("none", True), ("container", False)])
def test_the_setting_of_the_server_is_above_that_of_projects(start_api: StartApi, weakest: str, gets_it: bool) -> None:
    api = start_api(weakest_isolation=weakest)
    mission = api.mission(api.project()["id"])
    upload(api, mission["id"], "drive.bin", b"a drive")
    bare = _owners_runner(api, "none")
    queued = launch(api, bare, mission)
    assert queued["waits_for"].startswith("It is queued for "), "a single person may do everything"

    people.person(api)
    api.sql("UPDATE project SET isolation = 'none'")  # as when an admin forbids it later
    waits = api.get(f"/runs/{queued['id']}").ok()["waits_for"]
    problem = api.get("/admin/health").ok()["runs_problem"]
    if gets_it:
        assert (waits.startswith("It is queued for "), problem) == (True, None)
        assert bare.claim()["run_id"] == queued["id"]
    else:
        assert "which this server does not allow" in waits
        assert problem.startswith("1 queued run can never start.")
        assert bare.claim() is None


def test_only_owners_change_the_isolation_and_the_audit_log_shows_it(lab: Api) -> None:
    ada, project = people.person(lab), lab.project()
    path = f"/projects/{project['id']}"
    people.grant(lab, ada, Right.write, project_id=project["id"])
    lab.as_(ada.token).patch(path, {"isolation": "namespaces"}).refused(403, "forbidden")
    lab.as_(ada.token).patch(path, {"isolation": "container"}).ok()  # which changes nothing
    people.grant(lab, ada, Right.delete, project_id=project["id"])
    only_write = lab.as_(people.token(lab, ada, [Scope.write]).secret)
    only_write.patch(path, {"isolation": "namespaces"}).refused(403, "scope_missing")

    changed = lab.as_(ada.token).patch(path, {"isolation": "namespaces", "description": "new"}).ok()
    assert (changed["isolation"], changed["description"]) == ("namespaces", "new")
    assert changed["etag"] != project["etag"]
    (event,) = [event for event in lab.events(project["id"]) if event["operation"] == "project.set_isolation"]
    assert (event["before"], event["after"]) == ({"isolation": "container"}, {"isolation": "namespaces"})
    assert event["actor"]["name"] == ada.name
