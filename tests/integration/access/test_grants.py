"""Grants through HTTP: who may grant what to whom, for how long, and with what effect."""

import datetime
import uuid
from typing import Any

import pytest

from kleinkram.contract.access import Right
from tests.integration.api_server import Api
from tests.integration.people import Person, deactivate, grant, group, join, person
from tests.integration.races import racing

RIGHTS = ("READ", "CREATE", "WRITE", "DELETE")


def in_days(days: float) -> str:
    """A time some days from now."""
    return (datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=days)).isoformat()


def met(api: Api, *people: Person) -> None:
    """Make people visible to each other by a group without rights."""
    group(api, members=people)


@pytest.fixture
def ada(api: Api) -> Person:
    """The person who creates the project."""
    return person(api)


@pytest.fixture
def bob(api: Api, ada: Person) -> Person:
    """A person who is visible to her."""
    made = person(api)
    met(api, ada, made)
    return made


@pytest.fixture
def project(api: Api, ada: Person) -> Any:
    """The project of `ada`."""
    return api.as_(ada.token).project()


def test_a_new_project_is_owned_by_its_creator_and_hidden_from_others(
    api: Api, ada: Person, bob: Person, project: Any
) -> None:
    path = f"/projects/{project['id']}"
    assert api.as_(ada.token).get(path).ok()["right"] == "DELETE"
    api.as_(bob.token).get(path).refused(404, "not_found")
    (only,) = api.as_(ada.token).all(f"{path}/grants")
    assert (only["to"]["id"], only["right"], only["expires_at"]) == (ada.id, "DELETE", None)


@pytest.mark.parametrize("right", RIGHTS)
def test_a_grant_is_created_listed_changed_and_revoked(
    api: Api, ada: Person, bob: Person, project: Any, right: str
) -> None:
    path, hers, his = f"/projects/{project['id']}", api.as_(ada.token), api.as_(bob.token)
    values = hers.post(f"{path}/grants", {"person_id": bob.id, "right": right}).ok(201)
    assert values["to"] == {"kind": "person", "id": bob.id, "name": bob.name}
    assert (values["right"], values["on"], values["granted_by"]["id"]) == (right, "project", ada.id)
    assert his.get(path).ok()["right"] == right
    assert his.all("/projects", {"name": project["name"]})[0]["right"] == right
    mission = hers.mission(project["id"])
    assert his.get(f"/missions/{mission['id']}").ok()["right"] == right
    changed = hers.patch(f"{path}/grants/{values['id']}", {"right": "READ", "expires_at": in_days(1)}).ok()
    assert (changed["right"], changed["has_expired"]) == ("READ", False)
    assert his.get(path).ok()["right"] == "READ"
    assert hers.delete(f"{path}/grants/{values['id']}").status == 204
    his.get(path).refused(404, "not_found")
    message = [event for event in api.all("/audit", {"project_id": project["id"]}) if event["resource_type"] == "grant"]
    assert [event["operation"] for event in message] == ["grant.revoke", "grant.change", "grant.create"]
    assert [event["after"].get("right") for event in message] == [None, "READ", right]
    assert {event["resource_name"] for event in message} == {bob.name}


def test_an_equal_grant_changes_nothing_and_another_one_replaces_it(
    api: Api, ada: Person, bob: Person, project: Any
) -> None:
    path, hers = f"/projects/{project['id']}/grants", api.as_(ada.token)
    first = hers.post(path, {"person_id": bob.id, "right": "READ"}).ok(201)
    assert hers.post(path, {"person_id": bob.id, "right": "READ"}).ok(201) == first
    second = hers.post(path, {"person_id": bob.id, "right": "WRITE"}).ok(201)
    assert second["id"] == first["id"]
    assert len(hers.all(path)) == 2
    assert len(api.events(first["id"])) == 2


@pytest.mark.parametrize("locked", RIGHTS)
def test_a_grant_cannot_exceed_the_rights_of_its_grantor(
    api: Api, ada: Person, bob: Person, project: Any, locked: str
) -> None:
    grant(api, bob, Right(locked), project_id=project["id"])
    carol = person(api)
    met(api, bob, carol)
    path, his = f"/projects/{project['id']}/grants", api.as_(bob.token)
    for expected in RIGHTS:
        answer = his.post(path, {"person_id": carol.id, "right": expected})
        if locked in ("READ", "CREATE"):
            answer.refused(403, "forbidden")
        elif RIGHTS.index(expected) > RIGHTS.index(locked):
            answer.refused(403, "right_exceeded")
        else:
            answer.ok(201)
    mine = f"{path}/{grant(api, bob, Right(locked), project_id=project['id'])}"
    if locked == "WRITE":
        his.patch(mine, {"right": "DELETE"}).refused(403, "right_exceeded")


def test_a_grant_cannot_outlast_the_rights_of_its_grantor(api: Api, ada: Person, bob: Person, project: Any) -> None:
    mine = grant(api, bob, Right.write, project_id=project["id"], expires_s=86_400)
    path, his = f"/projects/{project['id']}/grants", api.as_(bob.token)
    carol = person(api)
    met(api, bob, carol)
    expected = {"person_id": carol.id, "right": "WRITE"}
    problem = his.post(path, expected).refused(403, "right_exceeded")
    assert "without an end" in problem["requested"]
    his.post(path, {**expected, "expires_at": in_days(2)}).refused(403, "right_exceeded")
    his.patch(f"{path}/{mine}", {"expires_at": None}).refused(403, "right_exceeded")
    his.post(path, {**expected, "expires_at": in_days(0.5)}).ok(201)


def test_grants_cannot_outlast_the_membership_they_are_based_on(api: Api, ada: Person, project: Any) -> None:
    guest = person(api)
    lab = group(api, members=[ada])
    join(api, guest, lab, expires_s=3600)
    grant(api, lab, Right.delete, project_id=project["id"])
    path = f"/projects/{project['id']}/grants"
    api.as_(guest.token).post(path, {"person_id": guest.id, "right": "DELETE"}).refused(403, "right_exceeded")


def test_writers_cannot_change_grants_of_owners(api: Api, ada: Person, bob: Person, project: Any) -> None:
    grant(api, bob, Right.write, project_id=project["id"])
    path, his = f"/projects/{project['id']}/grants", api.as_(bob.token)
    (owners,) = [item for item in his.all(path) if item["to"]["id"] == ada.id]
    his.delete(f"{path}/{owners['id']}").refused(403, "forbidden")
    his.patch(f"{path}/{owners['id']}", {"right": "READ"}).refused(403, "forbidden")
    his.post(path, {"person_id": ada.id, "right": "READ"}).refused(403, "forbidden")
    assert api.as_(ada.token).get(f"/projects/{project['id']}").ok()["right"] == "DELETE"


def test_the_last_owner_cannot_be_removed_or_limited_in_time(api: Api, ada: Person, bob: Person, project: Any) -> None:
    path, hers = f"/projects/{project['id']}/grants", api.as_(ada.token)
    (own,) = hers.all(path)
    for refused in (
        hers.delete(f"{path}/{own['id']}"),
        hers.patch(f"{path}/{own['id']}", {"right": "WRITE"}),
        hers.patch(f"{path}/{own['id']}", {"expires_at": in_days(1)}),
        hers.post(path, {"person_id": ada.id, "right": "READ"}),
    ):
        assert refused.refused(409, "last_owner")["projects"] == [project["name"]]
    hers.post(path, {"email": f"{uuid.uuid4()}@lab.example", "right": "DELETE"}).ok(201)
    hers.delete(f"{path}/{own['id']}").refused(409, "last_owner")
    hers.post(path, {"person_id": bob.id, "right": "DELETE", "expires_at": in_days(9)}).ok(201)
    hers.delete(f"{path}/{own['id']}").refused(409, "last_owner")
    hers.post(path, {"person_id": bob.id, "right": "DELETE"}).ok(201)
    assert hers.delete(f"{path}/{own['id']}").status == 204
    hers.get(f"/projects/{project['id']}").refused(404, "not_found")


def test_two_owners_cannot_remove_each_other_at_the_same_time(api: Api, ada: Person, bob: Person, project: Any) -> None:
    path = f"/projects/{project['id']}/grants"
    his = grant(api, bob, Right.delete, project_id=project["id"])
    (hers,) = [item["id"] for item in api.as_(bob.token).all(path) if item["to"]["id"] == ada.id]
    with racing(api, "SELECT pg_advisory_xact_lock(%s)", 0x6B6C5247) as send:
        answers = [
            send(api.as_(ada.token).delete, f"{path}/{his}"),
            send(api.as_(bob.token).delete, f"{path}/{hers}"),
        ]
    # The second request fails, because its sender has no right any more.
    assert sorted(answer.result().status for answer in answers) == [204, 404]
    assert len(api.all(path)) == 1


def test_two_owners_who_leave_at_once_cannot_leave_a_project_unowned(
    api: Api, ada: Person, bob: Person, project: Any
) -> None:
    path = f"/projects/{project['id']}/grants"
    his = grant(api, bob, Right.delete, project_id=project["id"])
    (hers,) = [item["id"] for item in api.as_(bob.token).all(path) if item["to"]["id"] == ada.id]
    with racing(api, "SELECT pg_advisory_xact_lock(%s)", 0x6B6C5247) as send:
        answers = [
            send(api.as_(ada.token).delete, f"{path}/{hers}"),
            send(api.as_(bob.token).delete, f"{path}/{his}"),
        ]
    assert sorted(answer.result().status for answer in answers) == [204, 409]
    assert len(api.all(path)) == 1


def test_a_grant_to_an_address_is_answered_alike_with_and_without_an_account(
    api: Api, ada: Person, project: Any
) -> None:
    path, hers = f"/projects/{project['id']}", api.as_(ada.token)
    known, unknown = (f"{uuid.uuid4().hex}@lab.example" for _ in range(2))
    zoe = person(api, email=known)
    message = []
    for address in (known, unknown):
        made = hers.post(f"{path}/grants", {"email": address.upper(), "right": "WRITE"})
        listed = hers.get(f"{path}/grants").ok()
        access = hers.get(f"{path}/access").ok()
        people = hers.get("/people", {"count": "true"}).ok()
        left = hers.delete(f"{path}/grants/{made.body['id']}").status
        text = repr((made.status, made.body, listed, access, people, left))
        message.append(
            text.replace(address, "ADDRESS").replace(made.body["id"], "ID").replace(made.body["granted_at"], "")
        )
    assert message[0] == message[1]
    assert "ADDRESS" in message[0]
    hers.post(f"{path}/grants", {"email": known, "right": "WRITE"}).ok(201)
    assert api.as_(zoe.token).get(path).ok()["right"] == "WRITE"
    hers.get(f"/people/{zoe.id}").refused(404, "not_found")
    (own,) = [row for row in hers.all(f"{path}/grants") if row["to"]["id"] == ada.id]
    hers.delete(f"{path}/grants/{own['id']}").refused(409, "last_owner")


def test_only_visible_people_can_be_granted_rights_by_id(api: Api, ada: Person, project: Any) -> None:
    path, hers = f"/projects/{project['id']}/grants", api.as_(ada.token)
    stranger, gone = person(api), person(api)
    met(api, ada, gone)
    deactivate(api, gone)
    foreign = group(api, members=[stranger])
    for people in ({"person_id": stranger.id}, {"person_id": str(uuid.uuid4())}, {"person_id": gone.id}):
        hers.post(path, {**people, "right": "READ"}).refused(404, "not_found")
    for people in ({"group_id": foreign}, {"group_id": stranger.group_id}, {"group_id": ada.group_id}):
        hers.post(path, {**people, "right": "READ"}).refused(404, "not_found")


def test_a_grant_has_one_grantee_and_expires_in_the_future(api: Api, ada: Person, project: Any) -> None:
    path, hers = f"/projects/{project['id']}/grants", api.as_(ada.token)
    for body in (
        {"right": "READ"},
        {"right": "READ", "person_id": ada.id, "email": "a@b.example"},
        {"right": "READ", "email": "not an address"},
        {"right": "READ", "email": "k\u212alvin@lab.example"},
        {"right": "OWNER", "email": "a@b.example"},
        {"right": "READ", "email": "a@b.example", "expires_at": in_days(-1)},
        {"right": "READ", "email": "a@b.example", "expires_at": "2030-01-01T00:00:00"},
        {"right": "READ", "email": "a@b.example", "expires_at": "9999-12-31T23:59:59-12:00"},
    ):
        hers.post(path, body).refused(422, "invalid_request")
    assert len(hers.all(path)) == 1


def test_a_right_ends_when_it_expires(api: Api, ada: Person, bob: Person, project: Any) -> None:
    path, his = f"/projects/{project['id']}", api.as_(bob.token)
    values = api.as_(ada.token).post(f"{path}/grants", {"person_id": bob.id, "right": "READ", "expires_at": in_days(1)})
    his.get(path).ok()
    api.sql("UPDATE access_grant SET expires_at = now() WHERE id = %s", values.ok(201)["id"])
    his.get(path).refused(404, "not_found")
    (old,) = [row for row in api.as_(ada.token).all(f"{path}/grants") if row["to"]["id"] == bob.id]
    assert old["has_expired"] is True
    api.as_(ada.token).patch(f"{path}/grants/{old['id']}", {"right": "WRITE"}).refused(422, "invalid_request")
    api.as_(ada.token).patch(f"{path}/grants/{old['id']}", {"expires_at": None}).ok()
    assert his.get(path).ok()["right"] == "READ"


def test_a_right_on_a_mission_shows_only_its_projects_name_in_lists(
    api: Api, ada: Person, bob: Person, project: Any
) -> None:
    hers, his = api.as_(ada.token), api.as_(bob.token)
    shown, hidden = hers.mission(project["id"]), hers.mission(project["id"])
    path = f"/missions/{shown['id']}"
    hers.post(f"{path}/grants", {"person_id": bob.id, "right": "WRITE"}).ok(201)
    seen = his.get(path).ok()
    assert seen["project"] == {"id": project["id"], "name": project["name"]}
    assert seen["right"] == "WRITE"
    assert [row["id"] for row in his.all("/missions", {"project_id": project["id"]})] == [shown["id"]]
    his.get(f"/missions/{hidden['id']}").refused(404, "not_found")
    his.get(f"/projects/{project['id']}").refused(404, "not_found")
    his.get(f"/projects/{project['id']}/access").refused(404, "not_found")
    his.post(f"/projects/{project['id']}/grants", {"person_id": bob.id, "right": "READ"}).refused(404, "not_found")
    carol = person(api)
    met(api, bob, carol)
    his.post(f"{path}/grants", {"person_id": carol.id, "right": "WRITE"}).ok(201)
    his.post(f"{path}/grants", {"person_id": carol.id, "right": "DELETE"}).refused(403, "right_exceeded")
    # The access of a mission does not show the owners of its project.
    assert {row["person"]["id"] for row in his.all(f"{path}/access") if row["person"]} == {bob.id, carol.id}
    assert {row["to"]["id"] for row in his.all(f"{path}/grants")} == {bob.id, carol.id}
    assert api.events(shown["id"]) != []
    message = api.all("/audit", {"mission_id": shown["id"], "resource_type": "grant"})
    assert {(event["project_id"], event["mission_id"]) for event in message} == {(project["id"], shown["id"])}


def test_the_higher_of_two_rights_counts(api: Api, ada: Person, bob: Person, project: Any) -> None:
    mission = api.as_(ada.token).mission(project["id"])
    grant(api, bob, Right.read, project_id=project["id"])
    grant(api, bob, Right.write, mission_id=mission["id"])
    his = api.as_(bob.token)
    assert his.get(f"/missions/{mission['id']}").ok()["right"] == "WRITE"
    assert his.get(f"/projects/{project['id']}").ok()["right"] == "READ"
    grant(api, bob, Right.delete, project_id=project["id"])
    assert his.get(f"/missions/{mission['id']}").ok()["right"] == "DELETE"


def test_access_lists_people_rights_and_reasons(api: Api, ada: Person, bob: Person, project: Any) -> None:
    hers = api.as_(ada.token)
    mission = hers.mission(project["id"])
    carol, dan, guest = person(api), person(api), person(api)
    lab, foreign = group(api, members=[ada, carol]), group(api, members=[dan])
    join(api, guest, lab, expires_s=3600)
    for people in (lab, foreign):
        grant(api, people, Right.create, project_id=project["id"])
    grant(api, bob, Right.write, mission_id=mission["id"])
    hers.post(f"/projects/{project['id']}/grants", {"email": "x@lab.example", "right": "READ"}).ok(201)
    ways = hers.all(f"/missions/{mission['id']}/access")
    message = {
        (row["person"] and row["person"]["id"], row["to"] and row["to"]["kind"], row["right"], row["through"])
        for row in ways
    }
    assert message == {
        (ada.id, "person", "DELETE", "project grant"),
        (ada.id, "group", "CREATE", "project grant"),
        (carol.id, "group", "CREATE", "project grant"),
        (guest.id, "group", "CREATE", "project grant"),
        (None, "group", "CREATE", "project grant"),  # a group that is hidden from her
        (None, "email", "READ", "project grant"),
        (bob.id, "person", "WRITE", "mission grant"),
        (None, None, "DELETE", "admin"),
    }
    (ends,) = [row["expires_at"] for row in ways if row["person"] and row["person"]["id"] == guest.id]
    assert ends is not None
    assert {row["person"]["id"] for row in api.as_(carol.token).all(f"/missions/{mission['id']}/access")} == {carol.id}
    api.as_(person(api).token).get(f"/missions/{mission['id']}/access").refused(404, "not_found")
    pages = hers.get(f"/projects/{project['id']}/access", {"limit": "2"}).ok()
    assert len(pages["items"]) == 2
    assert len(hers.all(f"/projects/{project['id']}/access", {"limit": "1"})) == len(ways) - 1
