"""The audit log through HTTP."""

import uuid

from tests.integration.api_server import Api


def test_events_are_listed_latest_first(api: Api) -> None:
    project = api.project()
    mission = api.mission(project["id"])
    sent = api.call("PATCH", f"/missions/{mission['id']}", {"notes": "x"}, headers={"X-Request-Id": "my-request"})
    assert sent.headers["x-request-id"] == "my-request"
    events = api.all("/audit", {"project_id": project["id"], "limit": "1"})
    assert [event["operation"] for event in events] == ["mission.update", "mission.create", "project.create"]
    latest = events[0]
    assert (latest["noun"], latest["noun_id"], latest["noun_name"]) == ("mission", mission["id"], mission["name"])
    assert (latest["actor"]["name"], latest["request_id"]) == ("owner", "my-request")
    assert (latest["before"], latest["after"]) == ({"notes": ""}, {"notes": "x"})


def test_events_are_filtered_by_noun(api: Api) -> None:
    project = api.project()
    mission = api.mission(project["id"])
    query = {"project_id": project["id"], "noun": "mission"}
    assert [event["noun_id"] for event in api.all("/audit", query)] == [mission["id"]]
    assert api.all("/audit", {"noun_id": str(uuid.uuid4())}) == []
    assert api.all("/audit", {**query, "noun": "colour"}) == []


def test_failed_requests_write_no_audit_entry(api: Api) -> None:
    project = api.project()
    api.post(f"/projects/{project['id']}/missions", {"name": "x", "metadata_yaml": "["}).refused(422, "yaml_invalid")
    assert len(api.all("/audit", {"project_id": project["id"]})) == 1


def test_invalid_query_parameters_are_named(api: Api) -> None:
    api.get("/audit", {"noun_id": "x"}).refused(422, "invalid_request")
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
