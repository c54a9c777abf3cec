"""Removing a person: what ends at once, what passes to the admins, what stays, and what is restored."""

import uuid
from typing import Any

import pytest

from kleinkram.contract.access import Right
from kleinkram.server.access.actor import secret_hash
from tests.integration.access.test_grants import in_days
from tests.integration.api_server import Api
from tests.integration.people import Person, grant, group, person, session, token
from tests.integration.races import racing

_RIGHTS = ("SELECT pg_advisory_xact_lock(%s)", 0x6B6C5247)


@pytest.fixture
def ada(api: Api) -> Person:
    """The person who is removed."""
    return person(api)


def leave(api: Api, who: Person) -> Any:
    """Deactivate a person as an admin."""
    return api.post(f"/people/{who.id}/deactivate").ok()


def test_sessions_tokens_and_links_end_at_once(api: Api, ada: Person) -> None:
    browser, second = session(api, ada), token(api, ada)
    project = api.as_(ada.token).project()
    mission = api.as_(ada.token).mission(project["id"])
    link = secret_hash("a link's secret" + mission["id"])
    api.sql(
        "INSERT INTO share (id, mission_id, name, is_whole_mission, prefix, secret_sha256, created_by_id, expires_at)"
        " VALUES (%s, %s, 'for a friend', true, 'x', %s, %s, now() + interval '1 day')",
        *(str(uuid.uuid4()), mission["id"], link, ada.id),
    )
    guest = api.as_("a link's secret" + mission["id"])
    guest.get(f"/missions/{mission['id']}").ok()
    ended = leave(api, ada)
    assert (ended["sessions"], ended["tokens"], ended["links"]) == (1, 2, 1)
    for secret in (ada.token, second.secret):
        api.as_(secret).get("/projects").refused(401, "not_authenticated")
    guest.get(f"/missions/{mission['id']}").refused(401, "not_authenticated")
    cookie = {"Cookie": f"kleinkram={browser}"}
    api.as_(None).call("GET", "/projects", headers=cookie).refused(401, "not_authenticated")
    message = api.all("/audit", {"resource_id": second.id}) + api.all(
        "/audit", {"resource_type": "share", "mission_id": mission["id"]}
    )
    assert [event["operation"] for event in message] == ["token.revoke", "share.revoke"]
    (left,) = api.all("/audit", {"resource_id": ada.id, "operation": "person.deactivate"})
    assert (left["after"]["tokens"], left["after"]["projects"], left["as_admin"]) == (2, [project["name"]], True)


def test_projects_without_another_owner_pass_to_the_admins(api: Api, ada: Person) -> None:
    bob, hers = person(api), api.as_(ada.token)
    alone, shared, ending, trashed, by_address = (hers.project() for _ in range(5))
    for item, until in ((shared, None), (ending, 3600)):
        grant(api, bob, Right.delete, project_id=item["id"], expires_s=until)
    hers.delete(f"/projects/{trashed['id']}").ok()
    hers.post(f"/projects/{by_address['id']}/grants", {"email": "zoe@lab.example", "right": "DELETE"}).ok(201)
    assert leave(api, ada)["projects"] == sorted(item["name"] for item in (alone, ending, trashed, by_address))
    owners = [(row["to"]["name"], row["right"]) for row in api.all(f"/projects/{alone['id']}/grants")]
    assert sorted(owners) == sorted([(ada.name, "DELETE"), ("admins", "DELETE")])
    assert "admins" not in [row["to"]["name"] for row in api.all(f"/projects/{shared['id']}/grants")]
    api.post(f"/trash/project/{trashed['id']}/restore").ok(204)
    message = api.all("/audit", {"project_id": alone["id"], "operation": "grant.create"})
    assert [(event["resource_name"], event["after"]["right"]) for event in message] == [("admins", "DELETE")]
    # Her name remains in the audit log and on the objects that she created.
    assert api.get(f"/projects/{alone['id']}").ok()["created_by"] == {"id": ada.id, "name": ada.name}


def test_a_group_owns_its_projects_until_its_last_member_leaves(api: Api, ada: Person) -> None:
    bob, hers = person(api), api.as_(ada.token)
    lab = group(api, members=[ada, bob])
    project = hers.project()
    grant(api, lab, Right.delete, project_id=project["id"])
    (own,) = [row["id"] for row in hers.all(f"/projects/{project['id']}/grants") if row["to"]["kind"] == "person"]
    hers.delete(f"/projects/{project['id']}/grants/{own}").ok(204)
    assert leave(api, ada)["projects"] == []
    assert leave(api, bob)["projects"] == [project["name"]]


def test_reactivation_restores_memberships_and_grants_but_no_tokens(api: Api, ada: Person) -> None:
    bob = person(api)
    lab, project = group(api, members=[ada, bob]), api.as_(bob.token).project()
    grant(api, lab, Right.write, project_id=project["id"])
    leave(api, ada)
    api.post(f"/people/{ada.id}/deactivate").refused(404, "not_found")
    assert api.get(f"/groups/{lab}").ok()["member_count"] == 1
    assert {row["person"]["id"]: row["is_active"] for row in api.all(f"/groups/{lab}/members")} == {
        ada.id: False,
        bob.id: True,
    }
    assert api.post(f"/people/{ada.id}/reactivate").ok()["deactivated_at"] is None
    api.as_(ada.token).get("/projects").refused(401, "not_authenticated")
    fresh = api.as_(token(api, ada).secret)
    assert fresh.get(f"/projects/{project['id']}").ok()["right"] == "WRITE"
    assert len(api.all("/audit", {"resource_id": ada.id, "operation": "person.reactivate"})) == 1


def test_the_last_active_owner_cannot_leave_after_the_other_was_removed(api: Api, ada: Person) -> None:
    bob = person(api)
    project = api.as_(bob.token).project()
    grant(api, ada, Right.delete, project_id=project["id"])
    leave(api, ada)
    grants = f"/projects/{project['id']}/grants"
    (own,) = [row["id"] for row in api.all(grants) if row["to"]["id"] == bob.id]
    api.as_(bob.token).delete(f"{grants}/{own}").refused(409, "last_owner")
    api.as_(bob.token).patch(f"{grants}/{own}", {"expires_at": in_days(3)}).refused(409, "last_owner")


def test_an_owner_cannot_leave_while_the_only_other_owner_is_removed(api: Api, ada: Person) -> None:
    bob = person(api)
    project = api.as_(bob.token).project()
    grant(api, ada, Right.delete, project_id=project["id"])
    grants = f"/projects/{project['id']}/grants"
    (own,) = [row["id"] for row in api.all(grants) if row["to"]["id"] == bob.id]
    with racing(api, *_RIGHTS) as send:
        gone = send(api.as_(bob.token).delete, f"{grants}/{own}")
        left = send(api.post, f"/people/{ada.id}/deactivate")
    handed = left.result().ok()["projects"]
    assert (gone.result().status, handed) in [(204, [project["name"]]), (409, [])]


def test_a_person_removed_while_creating_a_project_leaves_none_without_owner(api: Api, ada: Person) -> None:
    name = f"project {uuid.uuid4()}"
    with racing(api, *_RIGHTS) as send:
        made = send(api.as_(ada.token).post, "/projects", {"name": name})
        left = send(api.post, f"/people/{ada.id}/deactivate")
    if made.result().status == 201:
        assert left.result().ok()["projects"] == [name]
    else:
        made.result().refused(409, "last_owner")
        assert api.all("/projects", {"name": name}) == []


def test_a_removed_admin_loses_access_until_reactivated(api: Api) -> None:
    boss = person(api, admin=True)
    leave(api, boss)
    api.as_(boss.token).get("/people").refused(401, "not_authenticated")
    seen = api.get(f"/people/{boss.id}").ok()
    assert seen["deactivated_at"] is not None
    assert api.post(f"/people/{boss.id}/reactivate").ok()["is_admin"] is True
