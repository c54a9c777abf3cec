"""Concurrent edits: the second gets a conflict, and the first stays."""

from collections.abc import Callable
from typing import Any

import pytest
from typer.testing import CliRunner

from kleinkram.cli.main import app
from kleinkram.client import connect
from kleinkram.contract.errors import EditConflict
from tests.integration.api_server import Answer, Api
from tests.integration.people import person
from tests.integration.races import racing
from tests.integration.upload_client import upload

FIELDS = "undeclared: accept\nfields:\n  - {name: robot, type: string}\n"
# Of each resource type: what the first writes, and the second, who looked at the same.
_EDITS: dict[str, list[tuple[Any, Any]]] = {
    "missions": [
        ({"metadata": {"robot": "spot"}}, {"metadata": {"operator": "ada"}}),
        ({"metadata_yaml": "robot: spot\n"}, {"metadata_yaml": "robot: anymal\n"}),
        ({"notes": "rain"}, {"notes": "sun"}),
        ({"name": "first"}, {"name": "second"}),
        ({"completed": True}, {"notes": "more to come"}),
    ],
    "projects": [
        ({"metadata_fields": {"fields": [{"name": "a", "type": "string"}]}}, {"fields_yaml": "fields: []\n"}),
        ({"description": "mine"}, {"description": "yours"}),
        ({"is_public": True}, {"licence": "CC0-1.0"}),
        ({"isolation": "namespaces"}, {"description": "ours"}),
    ],
    "files": [({"labels": ["good"]}, {"labels": ["night"]}), ({"path": "a.bin"}, {"path": "b.bin"})],
    "groups": [({"name": "first"}, {"name": "second"})],
    "actions": [({"archived": True}, {"archived": False})],
}
_LOCK = {
    "missions": "SELECT 1 FROM mission WHERE id = %s FOR UPDATE",
    "projects": "SELECT 1 FROM project WHERE id = %s FOR UPDATE",
    "files": "SELECT 1 FROM file f JOIN mission m ON m.id = f.mission_id WHERE f.id = %s FOR UPDATE",
    "groups": "SELECT 1 FROM access_group WHERE id = %s FOR UPDATE",
    "actions": "SELECT 1 FROM action WHERE id = %s FOR UPDATE",
}


@pytest.fixture(name="made")
def _made(api: Api) -> dict[str, Any]:
    """One of each resource type, by its path."""
    project = api.project(fields_yaml=FIELDS)
    mission = api.mission(project["id"], metadata={"robot": "anymal"}, notes="fog")
    return {
        "projects": project,
        "missions": mission,
        "files": upload(api, mission["id"], "run.bin", b"abc"),
        "groups": api.post("/groups", {"name": f"group {mission['id']}"}).ok(201),
        "actions": api.post("/actions", {"project_id": project["id"], "definition": _definition("1")}).ok(201),
    }


def _definition(script: str) -> dict[str, str]:
    return {"name": "count", "script": script}


def _change(api: Api, resource_type: str, seen: Any, body: Any) -> Answer:
    return api.call("PATCH", f"/{resource_type}/{seen['id']}", body, headers={"If-Match": f'"{seen["etag"]}"'})


@pytest.mark.parametrize(
    ("resource_type", "first", "second"),
    [(resource_type, *pair) for resource_type, edits in _EDITS.items() for pair in edits],
)
def test_the_second_of_two_edits_is_refused(
    api: Api, made: dict[str, Any], resource_type: str, first: Any, second: Any
) -> None:
    seen = api.get(f"/{resource_type}/{made[resource_type]['id']}").ok()
    if "name" in first:  # unique
        first, second = ({"name": f"{pair['name']} {seen['id']}"} for pair in (first, second))
    with racing(api, _LOCK[resource_type], seen["id"]) as send:
        both = [send(_change, api, resource_type, seen, body) for body in (first, second)]
    edited = both[0].result(30).ok()
    problem = both[1].result(30).refused(412, "edit_conflict")
    assert problem["etag"] == edited["etag"] != seen["etag"]
    assert "changed by somebody else" in problem["detail"]
    now = api.get(f"/{resource_type}/{seen['id']}").ok()
    assert now == edited
    assert _change(api, resource_type, now, second).ok()["etag"] != now["etag"], "having looked again, they may"


@pytest.mark.parametrize("resource_type", _EDITS)
def test_an_edit_without_change_is_no_conflict(api: Api, made: dict[str, Any], resource_type: str) -> None:
    seen, body = made[resource_type], _EDITS[resource_type][0][0]
    edited = _change(api, resource_type, seen, body).ok()
    assert _change(api, resource_type, seen, body).ok()["etag"] == edited["etag"], (
        "an answer was lost, and asked for again"
    )


def test_the_second_of_two_new_versions_is_refused(api: Api, made: dict[str, Any]) -> None:
    seen = made["actions"]

    def publish(script: str, etag: str) -> Answer:
        body, headers = {"definition": _definition(script)}, {"If-Match": f'"{etag}"'}
        return api.call("POST", f"/actions/{seen['id']}/versions", body, headers=headers)

    with racing(api, _LOCK["actions"], seen["id"]) as send:
        both = [send(publish, script, seen["etag"]) for script in ("2", "3")]
    edited = both[0].result(30).ok(201)
    assert both[1].result(30).refused(412, "edit_conflict")["etag"] == edited["etag"] != seen["etag"]
    assert publish("2", seen["etag"]).ok(201) == edited, "an answer was lost, and asked for again"
    assert publish("3", edited["etag"]).ok(201)["latest"]["number"] == 3


def test_the_second_of_two_membership_edits_is_refused(api: Api, made: dict[str, Any]) -> None:
    path = f"/groups/{made['groups']['id']}/members/{person(api).id}"
    put: Callable[[Any, Any], Answer] = lambda body, seen: api.call(  # noqa: E731  (short)
        "PUT", path, body, headers={"If-Match": f'"{seen["etag"]}"'} if seen else None
    )
    seen = put({}, None).ok()
    put({"is_editor": True}, seen).ok()
    until = {"expires_at": "2100-01-01T00:00:00Z"}
    problem = put(until, seen).refused(412, "edit_conflict")
    assert put(until, problem).ok()["is_editor"] is False, "having looked again, they may"
    assert put({"expires_at": "2100-01-01T01:00:00+01:00"}, seen).ok()["etag"] != seen["etag"], "it is so already"
    api.delete(path).ok(204)
    put({}, seen).refused(404, "not_found")


def test_results_of_jobs_do_not_change_the_etag(api: Api, made: dict[str, Any]) -> None:
    api.sql("UPDATE mission SET files_revision = files_revision + 1, start_ns = 1, end_ns = 2")
    upload(api, made["missions"]["id"], "more.bin", b"more")
    assert _change(api, "missions", made["missions"], {"notes": "sun"}).ok()["notes"] == "sun"


@pytest.mark.parametrize(
    ("header", "status"), [("*", 200), ('"0000000000000000"', 412), ('W/"{}"', 200), ('"1", "{}"', 200)]
)
def test_if_match_follows_the_http_specification(api: Api, made: dict[str, Any], header: str, status: int) -> None:
    seen = made["missions"]
    headers = {"If-Match": header.format(seen["etag"])}
    assert api.call("PATCH", f"/missions/{seen['id']}", {"notes": "x"}, headers=headers).status == status
    assert api.patch(f"/missions/{seen['id']}", {"notes": "y"}).ok()["notes"] == "y", "who names none is not asked"


def test_the_sdk_raises_edit_conflict(api: Api, made: dict[str, Any]) -> None:
    with connect(api.url, api.token) as client:
        seen = client.missions.get(made["missions"]["id"])
        client.missions.update(seen.id, if_match=seen.etag, notes="mine")
        with pytest.raises(EditConflict, match="changed by somebody else"):
            client.missions.update(seen.id, if_match=seen.etag, notes="yours")
        assert client.missions.get(seen.id).notes == "mine"


def test_the_cli_exits_with_conflict(api: Api, made: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KLEINKRAM_URL", api.url)
    monkeypatch.setenv("KLEINKRAM_TOKEN", str(api.token))
    seen = made["missions"]
    change: Callable[[str], Any] = lambda notes: CliRunner().invoke(  # noqa: E731  (short)
        app, ["mission", "update", seen["id"], "--notes", notes, "--if-match", seen["etag"]]
    )
    assert change("mine").exit_code == 0
    assert isinstance(change("yours").exception, EditConflict)
    assert api.get(f"/missions/{seen['id']}").ok()["notes"] == "mine"
