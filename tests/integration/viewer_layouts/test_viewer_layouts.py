"""Layouts of the viewer through HTTP: who sees and changes them, what is refused, and what is recorded."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from kleinkram.contract.access import Right, Scope
from kleinkram.contract.viewer_layouts import MAX_VIEWER_LAYOUTS
from kleinkram.server.access.builtin_groups import OWNER_ID
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.event_client import listening

_PANELS = ["image*:1@/camera/front", "plot:1@/imu,linear_acceleration.x;2@/odom"]


@pytest.fixture(name="project_id")
def _project_id(api: Api) -> str:
    return str(api.project()["id"])


def _path(project_id: str, layout: Any = None) -> str:
    return f"/projects/{project_id}/viewer-layouts" + ("" if layout is None else f"/{layout['id']}")


def _save(api: Api, project_id: str, name: str = "cameras", **fields: Any) -> Any:
    return api.post(_path(project_id), {"name": name, "panels": _PANELS, **fields}).ok(201)


def _member(api: Api, project_id: str, right: Right) -> Api:
    member = people.person(api)
    people.grant(api, member, right, project_id=project_id)
    return api.as_(member.token)


def test_a_layout_is_saved_and_listed_by_name(api: Api, project_id: str) -> None:
    shared = _save(api, project_id, "Wheels", is_shared=True)
    personal = _save(api, project_id, "cameras")
    assert (shared["panels"], shared["is_shared"], shared["is_default"]) == (_PANELS, True, False)
    assert (personal["is_shared"], personal["created_by"]["id"]) == (False, str(OWNER_ID))
    assert personal["project_id"] == project_id
    assert api.all(_path(project_id)) == [personal, shared]
    assert api.all(_path(project_id), {"limit": "1"}) == [personal, shared]
    assert api.all(_path(str(api.project()["id"]))) == []


def test_readers_see_shared_layouts_and_their_own_and_strangers_none(api: Api, project_id: str) -> None:
    shared, personal = _save(api, project_id, is_shared=True), _save(api, project_id)
    reader, other = (_member(api, project_id, Right.read) for _ in range(2))
    own = _save(reader, project_id, "mine")
    assert [one["id"] for one in reader.all(_path(project_id))] == [shared["id"], own["id"]]
    assert [one["id"] for one in other.all(_path(project_id))] == [shared["id"]]
    assert {one["id"] for one in api.all(_path(project_id))} == {shared["id"], personal["id"]}
    for answer in (
        other.patch(_path(project_id, own), {"name": "x"}),
        other.delete(_path(project_id, own)),
        api.patch(_path(project_id, own), {"name": "x"}),
        api.delete(_path(project_id, own)),
    ):
        answer.refused(404, "not_found")
    stranger = api.as_(people.person(api).token)
    for answer in (
        stranger.get(_path(project_id)),
        stranger.post(_path(project_id), {"name": "x", "panels": _PANELS}),
        stranger.patch(_path(project_id, shared), {"name": "x"}),
        stranger.delete(_path(project_id, shared)),
    ):
        answer.refused(404, "not_found")


def test_a_personal_layout_is_lost_with_the_right_to_read_the_project(api: Api, project_id: str) -> None:
    member = people.person(api)
    people.grant(api, member, Right.read, project_id=project_id)
    own = _save(api.as_(member.token), project_id)
    api.sql("DELETE FROM access_grant WHERE group_id = %s", member.group_id)
    api.as_(member.token).patch(_path(project_id, own), {"name": "x"}).refused(404, "not_found")


def test_sharing_requires_write_and_a_personal_layout_only_read(api: Api, project_id: str) -> None:
    shared = _save(api, project_id, is_shared=True)
    reader, creator, writer = (_member(api, project_id, right) for right in (Right.read, Right.create, Right.write))
    body = {"name": "x", "panels": _PANELS, "is_shared": True}
    for member in (reader, creator):
        for answer in (
            member.post(_path(project_id), body),
            member.patch(_path(project_id, shared), {"name": "x"}),
            member.patch(_path(project_id, shared), {"is_default": True}),
            member.delete(_path(project_id, shared)),
        ):
            answer.refused(403, "forbidden")
    own = _save(reader, project_id)
    assert reader.patch(_path(project_id, own), {"name": "mine"}).ok()["name"] == "mine"
    reader.delete(_path(project_id, own)).ok(204)
    writer.post(_path(project_id), body).ok(201)
    writer.patch(_path(project_id, shared), {"is_default": True}).ok()
    writer.delete(_path(project_id, shared)).ok(204)
    api.delete(_path(project_id, shared)).refused(404, "not_found")


def test_a_token_that_only_reads_saves_nothing(api: Api, project_id: str) -> None:
    member = people.person(api)
    people.grant(api, member, Right.write, project_id=project_id)
    reading = api.as_(people.token(api, member, {Scope.read}).secret)
    shared = _save(api, project_id, is_shared=True)
    assert reading.all(_path(project_id)) == [shared]
    body = {"name": "x", "panels": _PANELS}
    reading.post(_path(project_id), body).refused(403, "scope_missing")
    reading.delete(_path(project_id, shared)).refused(403, "scope_missing")


def test_the_public_sees_shared_layouts_without_people(api: Api, project_id: str) -> None:
    shared = _save(api, project_id, is_shared=True)
    _save(api, project_id, "mine")
    api.sql("UPDATE project SET is_public = true WHERE id = %s", project_id)
    guest = api.as_(None)
    assert guest.all(_path(project_id)) == [{**shared, "created_by": None}]
    guest.post(_path(project_id), {"name": "x", "panels": _PANELS}).refused(401, "not_authenticated")


def test_names_are_unique_among_shared_layouts_and_among_those_of_one_person(api: Api, project_id: str) -> None:
    shared, personal = _save(api, project_id, is_shared=True), _save(api, project_id)
    reader = _member(api, project_id, Right.read)
    _save(reader, project_id)
    for is_shared in (True, False):
        body = {"name": "CAMERAS", "panels": _PANELS, "is_shared": is_shared}
        assert api.post(_path(project_id), body).refused(409, "name_taken")["name"] == "CAMERAS"
        other = _save(api, project_id, "other", is_shared=is_shared)
        api.patch(_path(project_id, other), {"name": "Cameras"}).refused(409, "name_taken")
    for same in (shared, personal):
        assert api.patch(_path(project_id, same), {"name": "Cameras"}).ok()["name"] == "Cameras"
    _save(api, str(api.project()["id"]), is_shared=True)


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"name": ""}, "body.name"),
        ({"name": "a/b"}, "body.name"),
        ({"name": "x" * 129}, "body.name"),
        ({"panels": []}, "body.panels"),
        ({"panels": ["raw:1@/imu"] * 17}, "body.panels"),
        ({"panels": [""]}, "body.panels.0"),
        ({"panels": ["x" * 2001]}, "body.panels.0"),
        ({"panels": ["raw:1@/\x00"]}, "body.panels.0"),
        ({"is_default": True}, "body.is_default"),
    ],
)
def test_what_is_wrong_is_refused_with_the_field(
    api: Api, project_id: str, fields: dict[str, object], field: str
) -> None:
    problem = api.post(_path(project_id), {"name": "x", "panels": _PANELS, **fields}).refused(422, "invalid_request")
    assert [one["field"] for one in problem["problems"]] == [field]
    assert api.all(_path(project_id)) == []


def test_the_largest_layout_is_saved(api: Api, project_id: str) -> None:
    panels = ["plot:1@/" + "é" * 1992] * 16
    assert _save(api, project_id, panels=panels)["panels"] == panels


def test_a_change_needs_the_etag_that_was_read(api: Api, project_id: str) -> None:
    saved = _save(api, project_id, is_shared=True)
    path, first = _path(project_id, saved), {"If-Match": f'"{saved["etag"]}"'}
    changed = api.call("PATCH", path, body={"panels": _PANELS[:1]}, headers=first).ok()
    assert changed == {**saved, "panels": _PANELS[:1], "etag": changed["etag"]}
    api.call("PATCH", path, body={"name": "x"}, headers=first).refused(412, "edit_conflict")
    api.call("PATCH", path, body={"panels": _PANELS[:1]}, headers=first).ok()
    assert api.all(_path(project_id)) == [changed]


def test_a_project_has_one_default_which_is_shared(api: Api, project_id: str) -> None:
    first, second = (_save(api, project_id, name, is_shared=True) for name in ("one", "two"))
    personal = _save(api, project_id)
    for layout in (first, second):
        api.patch(_path(project_id, layout), {"is_default": True}).ok()
    assert [one["name"] for one in api.all(_path(project_id)) if one["is_default"]] == ["two"]
    problem = api.patch(_path(project_id, personal), {"is_default": True}).refused(422, "invalid_request")
    assert problem["problems"][0]["field"] == "is_default"
    api.patch(_path(project_id, personal), {"is_default": False}).ok()
    assert api.patch(_path(project_id, second), {"is_default": False}).ok()["is_default"] is False
    assert not any(one["is_default"] for one in api.all(_path(project_id)))


def test_of_two_that_become_the_default_at_once_one_does(api: Api, project_id: str) -> None:
    layouts = [_save(api, project_id, f"layout {number}", is_shared=True) for number in range(4)]
    with ThreadPoolExecutor(4) as pool:
        sent = [pool.submit(api.patch, _path(project_id, one), {"is_default": True}) for one in layouts]
    assert {one.result().status for one in sent} == {200}
    assert sum(one["is_default"] for one in api.all(_path(project_id))) == 1


@pytest.mark.parametrize("is_shared", [True, False])
def test_a_project_has_a_limited_number_of_layouts(api: Api, project_id: str, is_shared: bool) -> None:
    api.sql(
        "INSERT INTO viewer_layout (id, project_id, name, name_key, panels, is_shared, created_by_id)"
        " SELECT gen_random_uuid(), %s, n, n, '{raw:1@/imu}', %s, %s FROM generate_series(1, %s) n",
        *(project_id, is_shared, OWNER_ID, MAX_VIEWER_LAYOUTS),
    )
    body = {"name": "x", "panels": _PANELS, "is_shared": is_shared}
    problem = api.post(_path(project_id), body).refused(422, "invalid_request")
    assert "at most 50" in problem["problems"][0]["message"]
    _save(api, project_id, is_shared=not is_shared)
    _save(_member(api, project_id, Right.read), project_id)


def test_layouts_go_with_their_project(api: Api, project_id: str) -> None:
    saved = _save(api, project_id, is_shared=True)
    api.delete(f"/projects/{project_id}").ok()
    api.get(_path(project_id)).refused(404, "not_found")
    api.patch(_path(project_id, saved), {"name": "x"}).refused(404, "not_found")
    api.post(f"/trash/project/{project_id}/restore").ok(204)
    assert api.all(_path(project_id)) == [saved]
    api.patch(_path(str(api.project()["id"]), saved), {"name": "x"}).refused(404, "not_found")


def test_changes_of_shared_layouts_are_audited_and_of_personal_ones_without_their_content(
    api: Api, project_id: str
) -> None:
    shared = _save(api, project_id, is_shared=True)
    api.patch(_path(project_id, shared), {"name": "wheels", "is_default": True}).ok()
    api.delete(_path(project_id, shared)).ok(204)
    personal = _save(_member(api, project_id, Right.read), project_id, "secret")
    removed, changed, created = (
        next(one for one in api.events(project_id) if one["operation"] == f"project.{verb}_layout")
        for verb in ("delete", "update", "create")
    )
    assert (created["after"], created["before"]) == ({"is_personal": True}, {})
    assert changed["before"] == {"layout": "cameras", "name": "cameras", "is_default": False}
    assert changed["after"] == {"name": "wheels", "is_default": True}
    assert removed["before"] == {"layout": "wheels", "panels": _PANELS, "is_default": True}
    assert personal["name"] not in str(api.events(project_id))


def test_saving_takes_a_bounded_number_of_statements(api: Api, project_id: str) -> None:
    with api.statements() as statements:
        _save(api, project_id, is_shared=True)
    assert len(statements) <= 11  # who, lock, two rights, count, insert, read, name, audit, tell
    with api.statements() as statements:
        api.get(_path(project_id)).ok()
    assert len(statements) <= 4


def test_changes_are_published_to_all_readers_or_to_the_creator(api: Api, project_id: str) -> None:
    reader, other = (_member(api, project_id, Right.read) for _ in range(2))
    with listening(reader) as ears, listening(other) as ears_of_other:
        own = _save(reader, project_id)
        ears.receive(resource_type="viewer_layout", id=own["id"], change="created")
        shared = _save(api, project_id, is_shared=True)
        for stream in (ears, ears_of_other):
            stream.receive(resource_type="viewer_layout", id=shared["id"], change="created", project_id=project_id)
        assert own["id"] not in str(ears_of_other.events)
