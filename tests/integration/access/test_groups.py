"""Groups through HTTP: who creates, sees, edits and deletes them, and the rights of members."""

import asyncio
import threading
import uuid
from collections.abc import Callable
from typing import Any

import pytest

from kleinkram.contract.access import GroupKind, Right
from kleinkram.server.access.builtin_groups import ADMINS_ID, join_email_groups
from kleinkram.server.db import open_database
from kleinkram.server.groups.affiliations import AffiliationUnusable, ensure_affiliations
from kleinkram.server.settings import Affiliation
from tests.integration.access.test_grants import in_days
from tests.integration.api_server import Api
from tests.integration.people import Person, deactivate, grant, group, join, person
from tests.integration.races import racing

_RIGHTS = ("SELECT pg_advisory_xact_lock(%s)", 0x6B6C5247)


@pytest.fixture
def ada(api: Api) -> Person:
    """The person who creates groups."""
    return person(api)


@pytest.fixture
def bob(api: Api, ada: Person) -> Person:
    """A person who is visible to her by a group without rights."""
    made = person(api)
    group(api, members=[ada, made])
    return made


def made_by(api: Api, who: Person) -> Any:
    """A group created by a person."""
    return api.as_(who.token).post("/groups", {"name": f"group {uuid.uuid4().hex[:12]}"}).ok(201)


def test_a_new_group_is_edited_by_its_creator_and_visible_to_members(api: Api, ada: Person, bob: Person) -> None:
    made = made_by(api, ada)
    assert (made["kind"], made["member_count"], made["is_member"], made["is_editor"]) == ("custom", 1, True, True)
    assert made["created_by"]["id"] == ada.id
    his, path = api.as_(bob.token), f"/groups/{made['id']}"
    his.get(path).refused(404, "not_found")
    his.get(f"{path}/members").refused(404, "not_found")
    his.patch(path, {"name": "mine"}).refused(404, "not_found")
    his.delete(path).refused(404, "not_found")
    his.call("PUT", f"{path}/members/{bob.id}", {}).refused(404, "not_found")
    assert made["id"] not in [row["id"] for row in his.all("/groups")]
    assert made["id"] in [row["id"] for row in api.all("/groups")]
    (event,) = api.events(made["id"])
    assert (event["operation"], event["actor"]["id"], event["as_admin"]) == ("group.create", ada.id, False)


def test_editors_manage_members_and_members_can_only_read(api: Api, ada: Person, bob: Person) -> None:
    made = made_by(api, ada)
    hers, his, path = api.as_(ada.token), api.as_(bob.token), f"/groups/{made['id']}"
    added = hers.call("PUT", f"{path}/members/{bob.id}", {"expires_at": in_days(1)}).ok()
    assert (added["is_editor"], added["is_active"], added["added_by"]["id"]) == (False, True, ada.id)
    assert his.get(path).ok()["member_count"] == 2
    for refused in (
        his.patch(path, {"name": "mine"}),
        his.delete(path),
        his.call("PUT", f"{path}/members/{bob.id}", {"is_editor": True}),
        his.delete(f"{path}/members/{ada.id}"),
    ):
        refused.refused(403, "forbidden")
    hers.call("PUT", f"{path}/members/{bob.id}", {"is_editor": True}).ok()
    renamed = his.patch(path, {"name": f"new {made['name']}"}).ok()
    assert renamed["name"] == f"new {made['name']}"
    assert hers.get(path).ok()["name"] == renamed["name"]
    his.delete(f"{path}/members/{ada.id}").ok(204)
    hers.get(path).refused(404, "not_found")
    his.delete(path).ok(204)
    message = [event["operation"] for event in api.events(made["id"])]
    assert message == ["group.delete", "group.member", "group.rename", "group.member", "group.member", "group.create"]


def test_a_membership_gives_rights_until_it_expires(api: Api, ada: Person, bob: Person) -> None:
    made, project = made_by(api, ada), api.as_(ada.token).project()
    path, his = f"/groups/{made['id']}", api.as_(bob.token)
    grant(api, made["id"], Right.write, project_id=project["id"])
    api.as_(ada.token).call("PUT", f"{path}/members/{bob.id}", {"expires_at": in_days(1)}).ok()
    assert his.get(f"/projects/{project['id']}").ok()["right"] == "WRITE"
    api.sql("UPDATE membership SET expires_at = now() WHERE group_id = %s AND person_id = %s", made["id"], bob.id)
    his.get(f"/projects/{project['id']}").refused(404, "not_found")
    his.get(path).refused(404, "not_found")
    (past,) = [row for row in api.as_(ada.token).all(f"{path}/members") if not row["is_active"]]
    assert past["person"]["id"] == bob.id
    assert api.as_(ada.token).get(path).ok()["member_count"] == 1


def test_past_members_and_addresses_show_to_editors_only(api: Api, ada: Person) -> None:
    eve, gone = person(api, email=f"{uuid.uuid4()}@lab.example"), person(api)
    made = made_by(api, ada)
    join(api, eve, made["id"])
    join(api, gone, made["id"])
    deactivate(api, gone)
    seen = {row["person"]["id"]: row for row in api.as_(eve.token).all(f"/groups/{made['id']}/members")}
    assert seen.keys() == {ada.id, eve.id}
    assert all(row["emails"] == [] for row in seen.values())
    seen = {row["person"]["id"]: row for row in api.as_(ada.token).all(f"/groups/{made['id']}/members")}
    assert seen.keys() == {ada.id, eve.id, gone.id}
    assert len(seen[eve.id]["emails"]) == 1
    assert seen[gone.id]["is_active"] is False


def test_only_visible_people_can_be_added(api: Api, ada: Person) -> None:
    made, stranger = made_by(api, ada), person(api)
    path = f"/groups/{made['id']}/members"
    for people in (stranger.id, str(uuid.uuid4())):
        api.as_(ada.token).call("PUT", f"{path}/{people}", {}).refused(404, "not_found")
    api.call("PUT", f"{path}/{stranger.id}", {}).ok()  # all people are visible to admins
    past = {"expires_at": in_days(-1)}
    api.as_(ada.token).call("PUT", f"{path}/{stranger.id}", past).refused(422, "invalid_request")


def test_nobody_grants_a_membership_longer_than_their_own(api: Api, ada: Person, bob: Person) -> None:
    made = made_by(api, ada)
    path, his = f"/groups/{made['id']}/members", api.as_(bob.token)
    join(api, bob, made["id"], is_editor=True, expires_s=86_400)
    for body in ({"is_editor": True}, {"is_editor": True, "expires_at": in_days(2)}):
        his.call("PUT", f"{path}/{bob.id}", body).refused(403, "right_exceeded")
        his.call("PUT", f"{path}/{ada.id}", {"expires_at": in_days(2)}).refused(403, "right_exceeded")
    his.call("PUT", f"{path}/{bob.id}", {"is_editor": True, "expires_at": in_days(0.5)}).ok()


def test_group_names_are_unique_ignoring_case(api: Api, ada: Person, bob: Person) -> None:
    made = made_by(api, ada)
    api.as_(bob.token).post("/groups", {"name": made["name"].upper()}).refused(409, "name_taken")
    other = made_by(api, bob)
    api.as_(bob.token).patch(f"/groups/{other['id']}", {"name": made["name"]}).refused(409, "name_taken")


def test_projects_of_a_group_always_have_an_owner(api: Api, ada: Person, bob: Person) -> None:
    made, project = made_by(api, ada), api.as_(ada.token).project()
    grants, path, hers = f"/projects/{project['id']}/grants", f"/groups/{made['id']}", api.as_(ada.token)
    hers.call("PUT", f"{path}/members/{bob.id}", {"is_editor": True}).ok()
    hers.post(grants, {"group_id": made["id"], "right": "DELETE"}).ok(201)
    (own,) = [row["id"] for row in hers.all(grants) if row["to"]["kind"] == "person"]
    hers.delete(f"{grants}/{own}").ok(204)
    hers.delete(path).refused(409, "last_owner")
    hers.call("PUT", f"{path}/members/{bob.id}", {"is_editor": True, "expires_at": in_days(1)}).ok()
    for refused in (
        hers.delete(f"{path}/members/{ada.id}"),
        hers.call("PUT", f"{path}/members/{ada.id}", {"is_editor": True, "expires_at": in_days(1)}),
    ):
        assert refused.refused(409, "last_owner")["projects"] == [project["name"]]
    hers.delete(f"/projects/{project['id']}").ok()
    hers.delete(path).refused(409, "last_owner")  # in the trash too
    assert hers.get(path).ok()["member_count"] == 2


def test_two_members_who_leave_at_once_cannot_empty_an_owning_group(api: Api, ada: Person, bob: Person) -> None:
    made, project = made_by(api, ada), api.as_(ada.token).project()
    grants, path, hers = f"/projects/{project['id']}/grants", f"/groups/{made['id']}", api.as_(ada.token)
    hers.call("PUT", f"{path}/members/{bob.id}", {}).ok()
    hers.post(grants, {"group_id": made["id"], "right": "DELETE"}).ok(201)
    (own,) = [row["id"] for row in hers.all(grants) if row["to"]["kind"] == "person"]
    hers.delete(f"{grants}/{own}").ok(204)
    with racing(api, *_RIGHTS) as send:
        sent = [send(api.as_(item.token).delete, f"{path}/members/{item.id}") for item in (ada, bob)]
    assert sorted(future.result().status for future in sent) == [204, 409]


def test_deleting_a_group_deletes_and_audits_its_grants(api: Api, ada: Person, bob: Person) -> None:
    made, project = made_by(api, ada), api.as_(ada.token).project()
    mission = api.as_(ada.token).mission(project["id"])
    join(api, bob, made["id"])
    grant(api, made["id"], Right.read, project_id=project["id"])
    grant(api, made["id"], Right.write, mission_id=mission["id"])
    api.as_(ada.token).delete(f"/groups/{made['id']}").ok(204)
    api.as_(bob.token).get(f"/missions/{mission['id']}").refused(404, "not_found")
    message = api.all("/audit", {"project_id": project["id"], "operation": "grant.revoke"})
    assert {(event["mission_id"], event["before"]["right"]) for event in message} == {
        (None, "READ"),
        (mission["id"], "WRITE"),
    }


def test_admins_are_a_group_of_their_own(start_api: Callable[..., Api]) -> None:
    api = start_api()
    ada, bob = person(api), person(api)
    path = f"/groups/{ADMINS_ID}"
    api.as_(ada.token).get(path).refused(404, "not_found")
    api.patch(path, {"name": "us"}).refused(409, "group_fixed")
    api.delete(path).refused(409, "group_fixed")
    (owner,) = [row["person"]["id"] for row in api.all(f"{path}/members")]
    api.delete(f"{path}/members/{owner}").refused(409, "last_admin")
    api.delete(f"/people/{owner}/admin").refused(409, "last_admin")
    api.post(f"/people/{owner}/deactivate").refused(409, "last_admin")
    api.call("PUT", f"{path}/members/{owner}", {"expires_at": in_days(1)}).refused(409, "last_admin")
    api.call("PUT", f"{path}/members/{ada.id}", {"expires_at": in_days(1)}).ok()
    hers = api.as_(ada.token)
    assert hers.get(f"/people/{bob.id}").ok()["is_admin"] is False
    hers.delete(f"{path}/members/{owner}").refused(409, "last_admin")
    assert hers.post(f"/people/{bob.id}/admin").ok()["is_admin"] is True
    hers.delete(f"/people/{owner}/admin").ok()
    api.get(path).refused(404, "not_found")
    message = api.as_(bob.token).all("/audit", {"operation": "person.*"})
    assert [(event["operation"], event["as_admin"]) for event in message] == [
        ("person.unmake_admin", True),
        ("person.make_admin", True),
    ]


@pytest.mark.parametrize("creators", ["affiliated", "everybody", "admins"])
def test_a_setting_restricts_who_creates_projects_and_groups(start_api: Callable[..., Api], creators: str) -> None:
    lab = Affiliation(name="Lab", domains=("lab.example",), default_right=Right.read)
    api = start_api(creators=creators, affiliations=(lab,))
    ours, theirs = person(api), person(api)
    (lab_id,) = [row["id"] for row in api.all("/groups", {"name": "lab"})]
    join(api, ours, lab_id)
    may = {"affiliated": [ours], "everybody": [ours, theirs], "admins": []}[creators]
    for item in (ours, theirs):
        for path in ("/projects", "/groups"):
            answer = api.as_(item.token).post(path, {"name": f"x {uuid.uuid4().hex}"})
            answer.ok(201) if item in may else answer.refused(403, "forbidden")
    project = api.project()
    (values,) = [row for row in api.all(f"/projects/{project['id']}/grants") if row["to"]["kind"] == "group"]
    assert (values["to"]["name"], values["right"]) == ("Lab", "READ")
    assert api.as_(ours.token).get(f"/projects/{project['id']}").ok()["right"] == "READ"
    api.as_(theirs.token).get(f"/projects/{project['id']}").refused(404, "not_found")
    (made,) = api.events(project["id"])
    assert made["after"]["grants"] == {"Lab": "READ"}


def test_an_affiliation_contains_people_with_exactly_its_domains(start_api: Callable[..., Api]) -> None:
    lab = Affiliation(name="Lab", domains=("lab.example", "LAB.example.org"))
    api = start_api(affiliations=(lab,))
    inside = [person(api, email=f"a@{domain}") for domain in ("lab.example", "Lab.Example.ORG")]
    for domain in ("sub.lab.example", "evillab.example", "lab.example.com", "example"):
        person(api, email=f"a@{domain}")
    _run(api, [lab])
    (seen,) = api.all("/groups", {"name": "Lab"})
    assert (seen["kind"], seen["domains"]) == ("affiliation", ["lab.example", "lab.example.org"])
    path = f"/groups/{seen['id']}"
    assert {row["person"]["id"] for row in api.all(f"{path}/members")} == {item.id for item in inside}
    api.delete(f"{path}/members/{inside[0].id}").refused(409, "group_fixed")
    api.call("PUT", f"{path}/members/{person(api).id}", {}).refused(409, "group_fixed")
    api.call("PUT", f"{path}/members/{inside[0].id}", {"expires_at": in_days(1)}).refused(409, "group_fixed")
    api.patch(path, {"name": "other"}).refused(409, "group_fixed")
    api.delete(path).refused(409, "group_fixed")
    api.call("PUT", f"{path}/members/{inside[0].id}", {"is_editor": True}).ok()
    editor = api.as_(inside[0].token)
    assert [row["emails"] for row in editor.all("/people", {"text": inside[1].name})] == [["a@Lab.Example.ORG"]]
    _run(api, [lab])
    assert editor.get(path).ok()["is_editor"] is True


def test_a_verified_address_joins_its_affiliation_at_once(start_api: Callable[..., Api]) -> None:
    lab = Affiliation(name="Lab", domains=("lab.example",))
    api = start_api(affiliations=(lab,))
    ada = person(api)
    assert api.as_(ada.token).all("/groups") == []
    _run(api, None, join=(ada.id, "ada@LAB.example"))
    assert [row["name"] for row in api.as_(ada.token).all("/groups")] == ["Lab"]


def test_changed_affiliations_update_members_and_pass_projects_to_admins(start_api: Callable[..., Api]) -> None:
    api = start_api(affiliations=(Affiliation(name="Lab", domains=("lab.example",)),))
    ada, bob = person(api, email="ada@lab.example"), person(api, email="bob@else.example")
    _run(api, [Affiliation(name="Lab", domains=("lab.example",))])
    (lab,) = api.all("/groups", {"name": "Lab"})
    project = api.as_(ada.token).project()
    grants, hers = f"/projects/{project['id']}/grants", api.as_(ada.token)
    hers.post(grants, {"group_id": lab["id"], "right": "DELETE"}).ok(201)
    (own,) = [row["id"] for row in hers.all(grants) if row["to"]["kind"] == "person"]
    hers.delete(f"{grants}/{own}").ok(204)
    _run(api, [Affiliation(name="lab", domains=("else.example",))])
    hers.get(f"/projects/{project['id']}").refused(404, "not_found")
    assert api.as_(bob.token).get(f"/projects/{project['id']}").ok()["right"] == "DELETE"
    _run(api, [])
    api.as_(bob.token).get(f"/projects/{project['id']}").refused(404, "not_found")
    owners = {(row["to"]["name"], row["right"]) for row in api.all(grants)}
    assert owners == {("lab", "DELETE"), ("admins", "DELETE")}
    (seen,) = api.all("/groups", {"name": "lab"})
    assert (seen["member_count"], seen["domains"]) == (0, [])
    assert len(api.all("/audit", {"resource_id": lab["id"], "operation": "group.member"})) == 4
    api.delete(f"/groups/{lab['id']}").ok(204)


def test_an_affiliation_cannot_have_the_name_of_a_custom_group(start_api: Callable[..., Api]) -> None:
    api = start_api()
    group(api, "Lab", kind=GroupKind.custom)
    with pytest.raises(AffiliationUnusable, match="'lab'"):
        _run(api, [Affiliation(name="lab", domains=("lab.example",))])


def test_several_processes_can_start_at_once(start_api: Callable[..., Api]) -> None:
    api = start_api()
    for number in range(5):
        person(api, email=f"p{number}@lab.example")
    lab = Affiliation(name="Lab", domains=("lab.example",))
    starts = [threading.Thread(target=_run, args=(api, [lab])) for _ in range(4)]
    for start in starts:
        start.start()
    for start in starts:
        start.join()
    (seen,) = api.all("/groups", {"name": "Lab"})
    assert seen["member_count"] == 5
    assert len(api.all("/audit", {"resource_id": seen["id"], "operation": "group.member"})) == 5


def _run(api: Api, affiliations: list[Affiliation] | None, *, join: tuple[str, str] | None = None) -> None:
    """Update affiliations, as the server does at its start and when an address is verified."""

    async def work() -> None:
        database = open_database(api.app.state.settings)
        try:
            async with database.begin() as db:
                if affiliations is not None:
                    await ensure_affiliations(db, affiliations)
                if join is not None:
                    await join_email_groups(db, uuid.UUID(join[0]), join[1])
        finally:
            await database.close()

    asyncio.run(work())
