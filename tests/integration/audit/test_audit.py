"""The audit log through HTTP: lists, filters and exports of events."""

import datetime
import json
import uuid
from typing import Any

import pytest
import urllib3

from kleinkram.contract.access import Right
from kleinkram.contract.audit import AuditRead
from tests.integration import people
from tests.integration.api_server import Answer, Api
from tests.integration.sample import Sample

Lab = dict[str, Any]


def test_events_are_listed_latest_first(api: Api) -> None:
    project = api.project()
    mission = api.mission(project["id"])
    sent = api.call("PATCH", f"/missions/{mission['id']}", {"notes": "x"}, headers={"X-Request-Id": "my-request"})
    assert sent.headers["x-request-id"] == "my-request"
    events = api.all("/audit", {"project_id": project["id"], "limit": "1"})
    assert [event["operation"] for event in events] == ["mission.update", "mission.create", "project.create"]
    latest = events[0]
    assert (latest["resource_type"], latest["resource_id"], latest["resource_name"]) == (
        "mission",
        mission["id"],
        mission["name"],
    )
    assert (latest["actor"]["name"], latest["request_id"]) == ("owner", "my-request")
    assert (latest["before"], latest["after"]) == ({"notes": ""}, {"notes": "x"})


def test_events_are_filtered_by_resource_type(api: Api) -> None:
    project = api.project()
    mission = api.mission(project["id"])
    query = {"project_id": project["id"], "resource_type": "mission"}
    assert [event["resource_id"] for event in api.all("/audit", query)] == [mission["id"]]
    assert api.all("/audit", {"resource_id": str(uuid.uuid4())}) == []
    assert api.all("/audit", {**query, "resource_type": "colour"}) == []


def test_failed_requests_write_no_audit_entry(api: Api) -> None:
    project = api.project()
    api.post(f"/projects/{project['id']}/missions", {"name": "x", "metadata_yaml": "["}).refused(422, "yaml_invalid")
    assert len(api.all("/audit", {"project_id": project["id"]})) == 1


def test_invalid_query_parameters_are_named(api: Api) -> None:
    api.get("/audit", {"resource_id": "x"}).refused(422, "invalid_request")
    api.get("/audit", {"colour": "red"}).refused(422, "invalid_request")
    api.get("/audit", {"cursor": "x"}).refused(422, "invalid_cursor")
    api.post("/audit", {}).refused(405, "method_not_allowed")


def test_pages_are_stable_while_events_are_added(api: Api) -> None:
    project = api.project()
    for _ in range(3):
        api.mission(project["id"])
    query = {"project_id": project["id"], "limit": "2"}
    first = api.get("/audit", query).ok()
    api.mission(project["id"])
    second = api.get("/audit", {**query, "cursor": first["next"]}).ok()
    ids = [event["id"] for event in first["items"] + second["items"]]
    assert ids == sorted(ids, reverse=True)
    assert len(set(ids)) == 4
    with api.statements() as statements:
        api.get("/audit", query).ok()
    assert len(statements) == 2  # who, what


@pytest.fixture(scope="module")
def lab(api: Api, sample: Sample) -> Lab:
    """A project of the owner, in which a person with CREATE created a mission and downloaded a file by a token."""
    project = api.project()["id"]
    guest = people.person(api)
    people.grant(api, guest, Right.create, project_id=project)
    mission = api.as_(guest.token).mission(project)["id"]
    file_id = sample.file(mission, "a.mcap")
    robot = people.token(api, guest)
    api.as_(robot.secret).post("/files/download", {"file_ids": [file_id]}).ok()
    return {"project": project, "mission": mission, "file": file_id, "guest": guest, "robot": robot}


def _operations(answer: Answer) -> list[str]:
    return [event["operation"] for event in answer.ok()["items"]]


@pytest.mark.parametrize(
    ("expected", "actual"),
    [
        ({}, ["file.download", "mission.create", "project.create"]),
        ({"person_id": "guest"}, ["file.download", "mission.create"]),
        ({"person": "guest"}, ["file.download", "mission.create"]),
        ({"person": "owner"}, ["project.create"]),
        ({"token_id": "robot"}, ["file.download"]),
        ({"token": "local own*"}, ["project.create"]),
        ({"resource_type": "file"}, ["file.download"]),
        ({"resource_id": "mission"}, ["mission.create"]),
        ({"mission_id": "mission"}, ["file.download", "mission.create"]),
        ({"operation": "*.create"}, ["mission.create", "project.create"]),
        ({"operation": "mission_create"}, []),
        ({"as_admin": "true"}, []),
        ({"as_admin": "false"}, ["file.download", "mission.create", "project.create"]),
        ({"share_id": str(uuid.uuid4())}, []),
    ],
)
def test_events_are_filtered(api: Api, lab: Lab, expected: dict[str, str], actual: list[str]) -> None:
    ids = {"mission": lab["mission"], "robot": lab["robot"].id, "guest": lab["guest"].id}
    query = {name: ids.get(value, value) for name, value in expected.items()}
    if expected.get("person") == "guest":
        query["person"] = lab["guest"].name
    assert _operations(api.get("/audit", {"project_id": lab["project"], **query})) == actual


def test_since_is_inclusive_and_until_exclusive(api: Api, lab: Lab) -> None:
    within = {"project_id": lab["project"]}
    latest, made, first = api.get("/audit", within).ok()["items"]
    assert _operations(api.get("/audit", {**within, "since": made["at"]})) == ["file.download", "mission.create"]
    assert _operations(api.get("/audit", {**within, "until": made["at"]})) == ["project.create"]
    assert _operations(api.get("/audit", {**within, "since": made["at"], "until": latest["at"]})) == ["mission.create"]
    at = datetime.datetime.fromisoformat(first["at"].replace("Z", "+00:00")) + datetime.timedelta(microseconds=1)
    naive = at.astimezone(datetime.timezone.utc).replace(tzinfo=None).isoformat()
    assert len(_operations(api.get("/audit", {**within, "since": naive}))) == 2
    api.get("/audit", {"since": "yesterday"}).refused(422, "invalid_request")


def test_events_contain_credential_and_place(api: Api, lab: Lab) -> None:
    (event,) = api.get("/audit", {"project_id": lab["project"], "token_id": lab["robot"].id}).ok()["items"]
    assert event["actor"] == {"id": lab["guest"].id, "name": lab["guest"].name}
    assert event["token"]["id"] == lab["robot"].id
    assert (event["address"], event["session_id"], event["share"]) == ("127.0.0.1", None, None)
    assert (event["mission_id"], event["project_id"]) == (lab["mission"], lab["project"])


def test_uses_of_a_share_are_distinguished_and_owners_see_their_addresses(api: Api, sample: Sample) -> None:
    project = api.project()["id"]
    mission = api.mission(project)["id"]
    link, owner = people.share(api, mission), people.person(api)
    people.grant(api, owner, Right.delete, project_id=project)
    api.as_(link.secret).post("/files/download", {"file_ids": [sample.file(mission, "a.mcap")]}).ok()
    (event,) = api.as_(owner.token).get("/audit", {"share_id": link.id}).ok()["items"]
    assert (event["actor"], event["token"], event["share"]["id"]) == (None, None, link.id)
    assert event["address"] == "127.0.0.1"
    api.sql("DELETE FROM share WHERE id = %s", link.id)
    (event,) = api.get("/audit", {"share_id": link.id}).ok()["items"]
    assert event["share"] == {"id": link.id, "name": ""}


def test_owners_see_events_of_their_projects_without_addresses_of_others(api: Api, lab: Lab) -> None:
    other = api.project()["id"]
    owner, reader = people.person(api), people.person(api)
    people.grant(api, owner, Right.delete, project_id=lab["project"])
    people.grant(api, reader, Right.write, project_id=lab["project"])
    seen = api.as_(owner.token).all("/audit")
    assert {event["project_id"] for event in seen} == {lab["project"]}
    assert [event["operation"] for event in seen] == ["file.download", "mission.create", "project.create"]
    assert {event["address"] for event in seen} == {None}
    api.as_(owner.token).mission(lab["project"])
    own = api.as_(owner.token).get("/audit", {"person_id": owner.id}).ok()["items"]
    assert [event["address"] for event in own] == ["127.0.0.1"]
    assert api.as_(owner.token).all("/audit", {"project_id": other}) == []
    assert api.as_(reader.token).all("/audit") == []
    assert api.as_(reader.token).all("/audit", {"resource_id": lab["mission"]}) == []
    api.as_(None).get("/audit").refused(401, "not_authenticated")


def _export(api: Api, token: str | None, query: dict[str, str]) -> tuple[urllib3.BaseHTTPResponse, list[AuditRead]]:
    answer = urllib3.request(
        "GET", f"{api.url}/api/v1/audit/export", fields=query, headers={"Authorization": f"Bearer {token}"}
    )
    return answer, [AuditRead.model_validate_json(line) for line in answer.data.splitlines() if answer.status == 200]


def test_an_export_has_the_events_of_the_list_oldest_first(api: Api, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kleinkram.server.audit.service._EXPORT_BATCH", 2)
    query = {"project_id": lab["project"]}
    answer, events = _export(api, api.token, query)
    assert answer.headers["content-type"] == "application/jsonl"
    assert [json.loads(event.model_dump_json()) for event in reversed(events)] == api.all("/audit", query)


def test_an_export_occupies_no_connection_and_shows_no_more_than_a_list(api: Api, lab: Lab) -> None:
    reader = people.person(api)
    assert _export(api, reader.token, {})[1] == []
    assert _export(api, None, {})[0].status == 401
    assert _export(api, api.token, {"colour": "red"})[0].status == 422
