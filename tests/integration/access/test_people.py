"""Which people and which of their addresses a person may see."""

import uuid

import pytest

from kleinkram.contract.access import Right, Scope
from tests.integration.api_server import Api
from tests.integration.people import Person, deactivate, email_group, grant, group, join, person, token


@pytest.fixture
def ada(api: Api) -> Person:
    """A person."""
    return person(api, email=f"ada-{uuid.uuid4().hex}@lab.example")


@pytest.fixture
def bob(api: Api) -> Person:
    """Another person."""
    return person(api, email=f"bob-{uuid.uuid4().hex}@lab.example")


def sees(api: Api, who: Person, people: Person) -> bool:
    """Whether the API shows one person to another, in the list and by id alike."""
    requested = api.as_(who.token)
    status = requested.get(f"/people/{people.id}").status
    listed = people.id in [row["id"] for row in requested.all("/people", {"text": people.name})]
    counted = requested.get("/people", {"text": people.name, "count": "true"}).ok()["total"]
    assert (status, counted) == ((200, 1) if listed else (404, 0))
    return listed


def test_people_without_a_shared_group_or_project_do_not_see_each_other(api: Api, ada: Person, bob: Person) -> None:
    assert sees(api, ada, ada)
    assert not sees(api, ada, bob)
    hers = api.as_(ada.token)
    project = hers.project()
    assert not sees(api, bob, ada)
    grant(api, bob, Right.read, project_id=project["id"])
    assert sees(api, ada, bob)
    assert sees(api, bob, ada)


def test_a_shared_group_ends_with_the_membership(api: Api, ada: Person, bob: Person) -> None:
    made = group(api, members=[ada, bob])
    assert sees(api, ada, bob)
    join(api, bob, made, expires_s=-1)
    assert not sees(api, ada, bob)
    assert not sees(api, bob, ada)


def test_a_shared_project_ends_with_the_grant(api: Api, ada: Person, bob: Person) -> None:
    project = api.as_(ada.token).project()
    grant(api, bob, Right.write, project_id=project["id"], expires_s=-1)
    assert not sees(api, ada, bob)
    assert not sees(api, bob, ada)


def test_project_members_see_people_of_a_mission_but_not_vice_versa(api: Api, ada: Person, bob: Person) -> None:
    project = api.as_(ada.token).project()
    mission = api.as_(ada.token).mission(project["id"])
    grant(api, bob, Right.read, mission_id=mission["id"])
    assert sees(api, ada, bob)
    assert not sees(api, bob, ada)  # a right on the mission only does not show the people of the project
    carol = person(api)
    grant(api, carol, Right.read, mission_id=mission["id"])
    assert sees(api, bob, carol)


def test_a_grant_to_an_address_does_not_reveal_its_owner(api: Api, ada: Person, bob: Person) -> None:
    project = api.as_(ada.token).project()
    address = api.sql("SELECT email FROM person_email WHERE person_id = %s", bob.id)[0][0]
    grant(api, email_group(api, address), Right.write, project_id=project["id"])
    assert api.as_(bob.token).get(f"/projects/{project['id']}").ok()["right"] == "WRITE"
    assert not sees(api, ada, bob)
    assert sees(api, bob, ada)


def test_the_admins_group_and_public_projects_do_not_make_people_visible(api: Api, ada: Person, bob: Person) -> None:
    boss = person(api, admin=True)
    project = api.as_(ada.token).project()
    api.sql("UPDATE project SET is_public = true WHERE id = %s", project["id"])
    api.as_(bob.token).get(f"/projects/{project['id']}").ok()
    assert not sees(api, bob, ada)
    assert not sees(api, ada, boss)
    assert sees(api, boss, ada)
    quiet = token(api, boss, [Scope.read])
    api.as_(quiet.secret).get(f"/people/{ada.id}").refused(404, "not_found")


def test_addresses_are_visible_to_admins_and_editors_of_a_shared_group(api: Api, ada: Person, bob: Person) -> None:
    made = group(api, members=[ada, bob])
    (address,) = api.get(f"/people/{bob.id}").ok()["emails"]
    path, hers = f"/people/{bob.id}", api.as_(ada.token)
    assert hers.get(path).ok()["emails"] == []
    assert hers.all("/people", {"text": address}) == []  # searching for the address does not find it
    join(api, ada, made, is_editor=True)
    assert hers.get(path).ok()["emails"] == [address]
    assert [row["id"] for row in hers.all("/people", {"text": address.upper()})] == [bob.id]
    join(api, ada, made, is_editor=True, expires_s=-1)
    hers.get(path).refused(404, "not_found")
    assert len(hers.get(f"/people/{ada.id}").ok()["emails"]) == 1


def test_creating_a_group_reveals_neither_addresses_nor_people(api: Api, ada: Person, bob: Person) -> None:
    hers, unknown = api.as_(ada.token), person(api, email=f"{uuid.uuid4().hex}@lab.example")
    group(api, members=[ada, bob])  # he is visible to her as a member
    people_before = {row["id"] for row in hers.all("/people")}
    (address,) = api.get(f"/people/{bob.id}").ok()["emails"]
    made = hers.post("/groups", {"name": f"mine {uuid.uuid4().hex}"}).ok(201)["id"]
    put = hers.call("PUT", f"/groups/{made}/members/{bob.id}", {}).ok()
    hers.call("PUT", f"/groups/{made}/members/{unknown.id}", {}).refused(404, "not_found")
    assert put["emails"] == hers.get(f"/people/{bob.id}").ok()["emails"] == []
    members = hers.all(f"/groups/{made}/members")
    assert [row["emails"] for row in members if row["person"]["id"] == bob.id] == [[]]
    assert hers.all("/people", {"text": address}) == []
    assert {row["id"] for row in hers.all("/people")} == people_before
    # If another person adds him, his address is visible to the editor.
    hers.delete(f"/groups/{made}/members/{bob.id}").ok(204)
    assert api.call("PUT", f"/groups/{made}/members/{bob.id}", {}).ok()["emails"] == [address]
    assert hers.get(f"/people/{bob.id}").ok()["emails"] == [address]


def test_an_editor_of_one_group_has_no_rights_on_another(api: Api, ada: Person, bob: Person) -> None:
    group(api, members=[ada, bob])
    join(api, ada, group(api), is_editor=True)
    assert api.as_(ada.token).get(f"/people/{bob.id}").ok()["emails"] == []


def test_unverified_addresses_are_hidden(api: Api, ada: Person, bob: Person) -> None:
    api.sql("UPDATE person_email SET verified_at = NULL, verified_by = NULL WHERE person_id = %s", bob.id)
    assert api.get(f"/people/{bob.id}").ok()["emails"] == []


def test_former_members_are_visible_to_admins_only(api: Api, ada: Person, bob: Person) -> None:
    group(api, members=[ada, bob])
    deactivate(api, bob)
    api.as_(ada.token).get(f"/people/{bob.id}").refused(404, "not_found")
    assert api.get(f"/people/{bob.id}").ok()["deactivated_at"] is not None
    assert [row["id"] for row in api.all("/people", {"text": bob.name, "active": "false"})] == [bob.id]
    assert api.all("/people", {"text": bob.name, "active": "true"}) == []


def test_a_limited_token_shows_no_other_person_and_no_group(api: Api, ada: Person, bob: Person) -> None:
    made = group(api, members=[ada, bob])
    project = api.as_(ada.token).project()
    limited = api.as_(token(api, ada, limits=[project["id"]]).secret)
    assert [row["id"] for row in limited.all("/people")] == [ada.id]
    assert limited.all("/groups") == []
    limited.get(f"/groups/{made}").refused(404, "not_found")
    limited.post("/projects", {"name": f"x {uuid.uuid4()}"}).refused(403, "forbidden")
    boss = person(api, admin=True)
    limited = api.as_(token(api, boss, limits=[project["id"]]).secret)
    assert [row["id"] for row in limited.all("/people")] == [boss.id]


def test_only_admins_appoint_admins_and_deactivate_people(api: Api, ada: Person, bob: Person) -> None:
    group(api, members=[ada, bob])
    hers = api.as_(ada.token)
    for path in ("admin", "deactivate", "reactivate"):
        hers.post(f"/people/{bob.id}/{path}").refused(403, "forbidden")
    hers.delete(f"/people/{bob.id}/admin").refused(403, "forbidden")
    boss = person(api, admin=True)
    powerless = api.as_(token(api, boss, [Scope.write]).secret)
    powerless.post(f"/people/{bob.id}/deactivate").refused(403, "scope_missing")
