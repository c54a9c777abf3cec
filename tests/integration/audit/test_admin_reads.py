"""Reads by an admin without a right of their own are recorded; reads of own data are not."""

from typing import Any

import pytest

from kleinkram.contract.access import Right, Scope
from kleinkram.server.audit import requests
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.people import Person
from tests.integration.sample import Sample


@pytest.fixture(scope="module")
def own(start_api: StartApi) -> Api:
    """An API of its own: its objects decide what lists show by admin rights alone."""
    return start_api()


def _looks(api: Api, who: Person) -> list[Any]:
    query = {"person_id": who.id, "operation": "admin.read"}
    return [
        (event["resource_type"], event["resource_id"] or event["resource_name"])
        for event in reversed(api.all("/audit", query))
    ]


def test_admin_reads_are_audited_once_an_hour_for_each_object(own: Api) -> None:
    project = own.project()["id"]
    mission, other = own.mission(project)["id"], own.mission(project)["id"]
    file_id = Sample(own).file(mission, "a.mcap")
    admin = people.person(own, admin=True)
    requested = own.as_(admin.token)
    for _ in range(2):
        own.app.state.admin_reads = requests.AdminReads()  # as in another process
        requested.get(f"/files/{file_id}").ok()
        requested.get(f"/missions/{mission}/recordings").ok()
        requested.get("/files", {"mission_id": mission}).ok()
    requested.get(f"/missions/{other}").ok()
    requested.get(f"/projects/{project}").ok()
    assert _looks(own, admin) == [("mission", mission), ("mission", other), ("project", project)]
    (event,) = own.all("/audit", {"operation": "admin.read", "mission_id": mission})
    assert (event["as_admin"], event["project_id"], event["after"]) == (True, project, {"operation": "get_file"})
    own.sql("UPDATE audit_event SET at = at - interval '61 minutes' WHERE operation = 'admin.read'")
    own.app.state.admin_reads = requests.AdminReads()
    requested.get(f"/missions/{mission}").ok()
    assert _looks(own, admin)[3:] == [("mission", mission)]


@pytest.mark.parametrize("right", [*Right])
def test_reads_with_own_rights_are_not_recorded_as_admin_access(own: Api, right: Right) -> None:
    project = own.project()["id"]
    mission = own.mission(project)["id"]
    admin = people.person(own, admin=True)
    people.grant(own, admin, right, mission_id=mission)
    requested = own.as_(admin.token)
    requested.get(f"/missions/{mission}").ok()
    assert _looks(own, admin) == []
    requested.get(f"/projects/{project}").ok()
    assert _looks(own, admin) == [("project", project)]


def test_reads_of_the_audit_log_with_only_write_are_admin_reads(own: Api) -> None:
    project = own.project()["id"]
    admin = people.person(own, admin=True)
    people.grant(own, admin, Right.write, project_id=project)
    requested = own.as_(admin.token)
    requested.get(f"/projects/{project}").ok()
    assert _looks(own, admin) == []
    requested.get("/audit", {"project_id": project}).ok()
    assert _looks(own, admin) == [("project", project)]


def test_lists_that_show_an_admin_more_are_audited_by_operation(start_api: StartApi) -> None:
    api = start_api()
    owner = people.person(api, admin=True)
    requested = api.as_(owner.token)
    project = requested.project()["id"]
    for path in ("/projects", "/missions", "/files", "/topics", "/stats", "/trash"):
        requested.get(path).ok()
    requested.get(f"/projects/{project}").ok()
    requested.get("/service").ok()
    assert _looks(api, owner) == []
    other = people.person(api, admin=True)
    api.as_(other.token).get("/files").ok()
    api.as_(other.token).get("/files", {"text": "x"}).ok()
    api.as_(other.token).get("/stats").ok()
    assert _looks(api, other) == [("server", "list_files"), ("server", "get_stats")]


def test_reads_without_admin_rights_or_of_missing_objects_are_not_audited(own: Api) -> None:
    project = own.project()["id"]
    admin = people.person(own, admin=True)
    plain = people.token(own, admin.id, [Scope.write])
    own.as_(plain.secret).get(f"/projects/{project}").refused(404, "not_found")
    own.as_(plain.secret).get("/projects").ok()
    own.as_(admin.token).get("/projects/00000000-0000-4000-8000-000000000000").refused(404, "not_found")
    own.as_(admin.token).get("/projects/x").refused(422, "invalid_request")
    assert _looks(own, admin) == []


def test_admin_reads_with_a_limited_token_are_audited_inside_its_limits(own: Api) -> None:
    here, there = own.project()["id"], own.project()["id"]
    admin = people.person(own, admin=True)
    requested = own.as_(people.token(own, admin.id, limits=[here]).secret)
    requested.get(f"/projects/{there}").refused(404, "not_found")
    requested.get(f"/groups/{admin.group_id}")
    assert _looks(own, admin) == []
    requested.get(f"/projects/{here}").ok()
    requested.get("/files").ok()
    assert _looks(own, admin) == [("project", here), ("server", "list_files")]
