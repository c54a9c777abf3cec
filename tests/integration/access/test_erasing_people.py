"""Erasing a person: no name or address remains where the server stores them, and what they did stays on record."""

import json
import uuid
from typing import Any

import psycopg
import pytest

from kleinkram.contract.access import Right
from kleinkram.server.access.builtin_groups import OWNER_ID
from tests.integration.api_server import Api
from tests.integration.auth.accounts import account, any_email
from tests.integration.auth.browser import Browser
from tests.integration.conftest import StartApi
from tests.integration.jobs import run_jobs
from tests.integration.people import Person, email_group, grant, group, person, session, token

# Every column of our tables that can contain text, except file names and what people wrote.
_TEXTS = """
SELECT table_name, column_name FROM information_schema.columns
WHERE table_schema = 'public' AND table_name !~ 'procrastinate|alembic' AND data_type IN ('text', 'jsonb', 'ARRAY')
"""


@pytest.fixture(name="ada")
def _ada(api: Api) -> Person:
    """The person who is erased: with a name and an address that nobody else has."""
    mark = uuid.uuid4().hex[:10]
    return person(api, f"Ada Lovelace {mark}", email=f"ada.{mark}@lab.example")


def erase(api: Api, who: Person) -> Any:
    """Erase a person as an admin, run the job, and return the answer."""
    erased = api.post(f"/people/{who.id}/erase", {"confirmation": who.name}).ok()
    run_jobs(api)
    return erased


def email_of(api: Api, who: Person) -> str:
    """Return a person's address."""
    return str(api.sql("SELECT email FROM person_email WHERE person_id = %s", who.id)[0][0])


def places_with(api: Api, text: str) -> set[str]:
    """Return the columns of the whole database in which a text is found."""
    return {
        f"{table}.{column}"
        for table, column in api.sql(_TEXTS)
        if api.sql(f'SELECT 1 FROM "{table}" WHERE strpos(lower("{column}"::text), lower(%s)) > 0 LIMIT 1', text)
    }


def test_no_name_and_no_address_remains_in_the_database(api: Api, ada: Person) -> None:
    email, hers = email_of(api, ada), api.as_(ada.token)
    project = hers.project()
    shared, team = api.project(), group(api, members=[ada])
    api.post(f"/projects/{shared['id']}/grants", {"email": email, "right": "READ"}).ok(201)
    api.post(f"/projects/{shared['id']}/grants", {"person_id": ada.id, "right": "WRITE"}).ok(201)
    api.call("PUT", f"/groups/{team}/members/{ada.id}", {"is_editor": True}).ok()
    hers.post("/tokens", {"name": f"laptop of {ada.name}"}).ok(201)
    api.post("/people/invitations", {"email": any_email(), "name": ada.name}).ok(201)
    session(api, ada)
    api.sql("UPDATE session SET address = '192.0.2.7', user_agent = %s WHERE person_id = %s", ada.name, ada.id)
    api.sql("UPDATE one_time_code SET email = %s WHERE name = %s", email, ada.name)
    api.sql(
        "INSERT INTO identity (id, person_id, issuer, subject, email) VALUES (%s, %s, 'https://id.example', %s, %s)",
        *(str(uuid.uuid4()), ada.id, f"subject of {ada.name}", email.upper()),
    )
    assert {"person.name", "person_email.email", "audit_event.after", "token.name"} <= places_with(api, ada.name) | (
        places_with(api, email)
    )
    erased = erase(api, ada)
    assert (places_with(api, ada.name), places_with(api, email)) == (set(), set())
    assert places_with(api, "192.0.2.7") == set()
    pseudonym = f"erased person {ada.id[:8]}"
    assert erased["person"] == {"id": ada.id, "name": pseudonym}
    assert (erased["sessions"], erased["tokens"], erased["projects"]) == (1, 2, [project["name"]])


def test_their_personal_layouts_are_deleted_and_the_shared_ones_stay(api: Api, ada: Person) -> None:
    hers = api.as_(ada.token)
    project = hers.project()
    path = f"/projects/{project['id']}/viewer-layouts"
    for is_shared in (True, False):
        hers.post(path, {"name": "cameras", "panels": ["raw:1@/imu"], "is_shared": is_shared}).ok(201)
    erase(api, ada)
    assert api.sql("SELECT is_shared FROM viewer_layout WHERE created_by_id = %s", ada.id) == [(True,)]


def test_what_they_did_stays_on_record_under_the_pseudonym(api: Api, ada: Person) -> None:
    project = api.as_(ada.token).project()
    before = api.events(project["id"])
    erase(api, ada)
    after = api.events(project["id"])
    (created,) = (event for event in after if event["operation"] == "project.create")
    assert created["actor"] == {"id": ada.id, "name": f"erased person {ada.id[:8]}"}
    assert created["address"] is None
    unchanged = ("id", "at", "operation", "resource_id", "resource_name", "project_id", "after", "request_id")
    assert [{key: event[key] for key in unchanged} for event in before] == [
        {key: event[key] for key in unchanged} for event in after if event["operation"] != "grant.create"
    ]
    operations = [event["operation"] for event in api.events(ada.id)]
    assert operations[:2] == ["audit.redact", "person.erase"]
    answer = api.get(f"/people/{ada.id}/erasure").ok()
    assert answer["audit_events"] == next(
        event["after"]["events"] for event in api.events(ada.id) if event["operation"] == "audit.redact"
    )


def test_access_ends_and_no_right_remains(api: Api, ada: Person) -> None:
    project, browser = api.project(), session(api, ada)
    grant(api, ada, Right.write, project_id=project["id"])
    grant(api, email_group(api, email_of(api, ada)), Right.read, project_id=project["id"])
    erase(api, ada)
    api.as_(ada.token).get("/me").refused(401, "not_authenticated")
    cookie = {"Cookie": f"kleinkram={browser}"}
    api.as_(None).call("GET", "/projects", headers=cookie).refused(401, "not_authenticated")
    assert api.sql("SELECT count(*) FROM access_grant WHERE project_id = %s", project["id"]) == [(1,)]
    assert api.sql("SELECT count(*) FROM membership WHERE person_id = %s", ada.id) == [(0,)]


def test_erasing_needs_their_name_and_a_recent_sign_in_of_an_admin(api: Api, ada: Person) -> None:
    path, body = f"/people/{ada.id}/erase", {"confirmation": ada.name}
    (problem,) = api.post(path, {"confirmation": ada.name.upper()}).refused(422, "invalid_request")["problems"]
    assert problem["field"] == "body.confirmation"
    assert ada.name in problem["message"]
    api.as_(person(api).token).post(path, body).refused(403, "forbidden")
    boss = person(api, admin=True)
    api.sql("UPDATE token SET created_at = now() - interval '1 day' WHERE id = %s", boss.token_id)
    api.as_(boss.token).post(path, body).refused(403, "sign_in_too_old")
    api.post(f"/people/{uuid.uuid4()}/erase", body).refused(404, "not_found")
    (problem,) = api.post(f"/people/{OWNER_ID}/erase", {"confirmation": "owner"}).refused(422, "invalid_request")[
        "problems"
    ]
    assert "klein up" in problem["message"]
    assert api.get(f"/people/{ada.id}").ok()["name"] == ada.name


def test_the_last_admin_cannot_be_erased(start_api: StartApi) -> None:
    api = start_api()
    boss = person(api, admin=True)
    api.as_(boss.token).delete(f"/people/{OWNER_ID}/admin").ok()
    api.as_(boss.token).post(f"/people/{boss.id}/erase", {"confirmation": boss.name}).refused(409, "last_admin")
    assert api.as_(boss.token).get(f"/people/{boss.id}").ok()["name"] == boss.name
    api.as_(boss.token).post(f"/people/{OWNER_ID}/admin").ok()
    api.as_(boss.token).post(f"/people/{boss.id}/erase", {"confirmation": boss.name}).ok()


def test_erasing_twice_changes_nothing_and_says_how_far_it_is(api: Api, ada: Person) -> None:
    first = api.post(f"/people/{ada.id}/erase", {"confirmation": ada.name}).ok()
    assert first["audit_events"] is None
    run_jobs(api)
    count = api.sql("SELECT count(*) FROM audit_event")
    again = api.post(f"/people/{ada.id}/erase", {"confirmation": "anything"}).ok()
    assert (again["erased_at"], again["sessions"], again["mentions"]) == (first["erased_at"], None, None)
    assert again["audit_events"] >= 1
    assert api.sql("SELECT count(*) FROM audit_event") == count
    assert api.sql("SELECT names, addresses FROM erasure WHERE person_id = %s", ada.id) == [(None, None)]


def test_an_erased_person_cannot_be_reactivated_and_appears_as_erased(api: Api, ada: Person) -> None:
    erase(api, ada)
    answer = api.post(f"/people/{ada.id}/reactivate").refused(409, "person_erased")
    assert "cannot be undone" in answer["detail"]
    api.post(f"/people/{ada.id}/admin").refused(404, "not_found")
    shown = api.get(f"/people/{ada.id}").ok()
    assert shown["erased_at"] is not None
    assert shown["emails"] == []


def test_a_deactivated_person_can_be_erased(api: Api, ada: Person) -> None:
    api.post(f"/people/{ada.id}/deactivate").ok()
    erase(api, ada)
    assert places_with(api, ada.name) == set()


def test_the_next_sign_in_makes_a_new_account(start_api: StartApi) -> None:
    api = start_api()
    made = account(api, name="Ada Lovelace")
    api.post(f"/people/{made.id}/erase", {"confirmation": "Ada Lovelace"}).ok()
    Browser(api).post("/auth/password", {"email": made.email, "password": "correct horse battery"}).refused(
        401, "sign_in_failed"
    )
    again = account(api, name="Ada Lovelace", email=made.email)
    assert again.id != made.id
    assert again.browser.me()["emails"] == [made.email]


def test_texts_that_mention_them_are_reported_and_stay(api: Api, ada: Person) -> None:
    email = email_of(api, ada)
    project = api.project(description=f"Data of {ada.name}.")
    mission = api.mission(project["id"], metadata={"operator": ada.name}, notes=f"Ask {email.upper()}")
    other = api.mission(project["id"], notes=f"x{email}, {ada.name}son")
    erased = erase(api, ada)
    fields = {(mention["resource_type"], mention["id"]): mention["fields"] for mention in erased["mentions"]}
    assert fields.pop(("mission", mission["id"])) == ["notes", "metadata"]
    assert fields == {("project", project["id"]): ["description"]}
    assert api.get(f"/missions/{mission['id']}").ok()["metadata"] == {"operator": ada.name}
    assert api.get(f"/missions/{other['id']}").ok()["notes"].endswith("son")


def test_the_record_of_somebody_with_the_same_name_is_not_changed(api: Api) -> None:
    name = f"Max {uuid.uuid4().hex[:6]}"
    first, second = person(api, name), person(api, name)
    for who in (first, second):
        api.post(f"/people/{who.id}/admin").ok()
        api.delete(f"/people/{who.id}/admin").ok()
    erase(api, first)
    assert {event["resource_name"] for event in api.events(second.id)} == {name}
    assert {event["resource_name"] for event in api.events(first.id)} == {f"erased person {first.id[:8]}"}
    assert api.as_(second.token).get("/me").ok()["person"]["name"] == name


def test_addresses_are_redacted_inside_texts_of_the_record(api: Api, ada: Person) -> None:
    email, mark, pseudonym = email_of(api, ada), uuid.uuid4().hex, f"erased person {ada.id[:8]}"
    shown = ["{0}", "{0}, again", "({0})", "<{0}>.", "two\nlines\n{0}"]
    longer = {"other": f"x{email}", "host": f"{email}.evil.example", "list": [f"un-{email}"]}
    api.sql(
        "INSERT INTO audit_event (operation, resource_type, resource_name, address, after)"
        " VALUES ('auth.refused', 'request', %s, '192.0.2.9', %s)",
        *(mark, json.dumps({"reasons": [text.format(email.upper()) for text in shown], **longer})),
    )
    erase(api, ada)
    ((address, after),) = api.sql("SELECT address, after FROM audit_event WHERE resource_name = %s", mark)
    assert after == {"reasons": [text.format(pseudonym) for text in shown], **longer}
    assert address is None


def test_the_serving_role_redacts_only_what_was_erased(api: Api, ada: Person) -> None:
    settings = api.app.state.settings
    api.as_(ada.token).project()
    before = api.sql("SELECT count(*), max(id) FROM audit_event")
    with psycopg.connect(str(settings.database_url).replace("+psycopg", ""), autocommit=True) as serving:
        for statement in (
            "UPDATE audit_event SET resource_name = ''",
            "DELETE FROM audit_event",
            "UPDATE audit_retention SET days = 30",
            "INSERT INTO audit_retention (days) VALUES (30)",
            "SELECT pseudonymise('{}', '{}', '', '')",
        ):
            with pytest.raises(psycopg.errors.InsufficientPrivilege):
                serving.execute(statement)
        assert serving.execute("SELECT redact_audit_log(%s)", [ada.id]).fetchone() == (0,)
        assert serving.execute("SELECT delete_expired_audit_events(%s, 1000)", [2**62]).fetchone() == (0,)
    assert api.sql("SELECT count(*), max(id) FROM audit_event") == before


def test_tokens_of_a_run_and_robots_are_renamed(api: Api, ada: Person) -> None:
    robot = token(api, ada)
    api.sql("UPDATE token SET kind = 'robot', name = %s WHERE id = %s", ada.name, robot.id)
    erase(api, ada)
    assert api.sql("SELECT name, revoked_at IS NOT NULL FROM token WHERE id = %s", robot.id) == [
        (f"erased person {ada.id[:8]}", True)
    ]


def grant_event(api: Api, who: Person) -> dict[str, Any]:
    """Grant READ to a person; return the event."""
    project = api.project()
    api.post(f"/projects/{project['id']}/grants", {"person_id": who.id, "right": "READ"}).ok(201)
    (event,) = api.all("/audit", {"project_id": project["id"], "operation": "grant.create"})
    return dict(event)


def test_a_name_that_is_a_word_of_the_record_is_replaced_only_where_it_names_the_person(api: Api) -> None:
    who, other = person(api, "READ"), person(api)
    about_others, about_them, team = grant_event(api, other), grant_event(api, who), group(api)
    api.call("PUT", f"/groups/{team}/members/{who.id}", {"is_editor": True}).ok()
    erase(api, who)
    events = {event["id"]: event for event in api.all("/audit", {"operation": "grant.create"})}
    assert events[about_others["id"]] == about_others
    pseudonym = f"erased person {who.id[:8]}"
    assert events[about_them["id"]] == {**about_them, "resource_name": pseudonym}
    (added,) = (event for event in api.events(team) if event["operation"] == "group.member")
    assert added["after"]["person"] == pseudonym


def test_what_a_provider_sent_instead_of_an_address_redacts_nothing(api: Api, ada: Person) -> None:
    other = grant_event(api, person(api))
    for claimed in ("READ", '", "', "READ@", ".*@.*"):
        api.sql(
            "INSERT INTO audit_event (operation, resource_type, resource_name, after)"
            " VALUES ('identity.link', 'identity', 'The Lab', %s)",
            json.dumps({"person_id": ada.id, "email": claimed, "list": ["a", "b"]}),
        )
    erase(api, ada)
    assert api.all("/audit", {"project_id": other["project_id"], "operation": "grant.create"}) == [other]
    ((is_finished,),) = api.sql("SELECT finished_at IS NOT NULL FROM erasure WHERE person_id = %s", ada.id)
    assert is_finished


def test_names_of_their_tokens_and_addresses_of_their_programs_are_redacted(api: Api, ada: Person) -> None:
    made = api.as_(ada.token).post("/tokens", {"name": "klein on adas-laptop", "scopes": ["admin"]}).ok(201)
    api.as_(made["secret"]).post("/tokens", {"name": "adas-script"}).ok(201)
    api.as_(ada.token).delete(f"/tokens/{made['token']['id']}").ok(204)
    login = uuid.uuid4()
    api.sql(
        "INSERT INTO audit_event (actor_id, operation, resource_type, resource_id, resource_name, after)"
        " VALUES (%s, 'login.approve', 'login', %s, 'klein', %s)",
        *(ada.id, login, json.dumps({"by": "code", "from": "192.0.2.44"})),
    )
    erase(api, ada)
    assert places_with(api, "adas-laptop") | places_with(api, "adas-script") | places_with(api, "192.0.2.44") == set()
    assert api.sql("SELECT after FROM audit_event WHERE resource_id = %s", login) == [({"by": "code"},)]


# A run, with a copy of its mission's metadata, of an action.
_RUN = """
WITH made AS (
    INSERT INTO action (id, name, name_key, project_id, created_by_id)
        VALUES (gen_random_uuid(), 'count', 'count', %(project)s, %(person)s) RETURNING id),
  version AS (
    INSERT INTO action_version (id, action_id, number, definition, definition_sha256, created_by_id)
        SELECT gen_random_uuid(), id, 1, %(definition)s, sha256('x'), %(person)s FROM made RETURNING id)
INSERT INTO run (id, version_id, mission_id, parameters, network, cores, memory_bytes, disk_bytes, gpus, needs_images,
    inputs_fingerprint, started_by_id, input_count, input_bytes, input_metadata)
  SELECT gen_random_uuid(), id, %(mission)s, %(parameters)s, 'none', 1, 1, 1, 0, false, sha256('x'), %(person)s, 1, 1,
    %(metadata)s FROM version
"""


def test_actions_runs_and_checks_that_mention_them_are_reported(api: Api, ada: Person) -> None:
    project = api.project()
    mission = api.mission(project["id"])
    values = {"project": project["id"], "mission": mission["id"], "person": str(OWNER_ID)}
    values |= {name: json.dumps({"by": ada.name}) for name in ("definition", "parameters", "metadata")}
    api.database.execute(_RUN, values)
    api.sql(
        "INSERT INTO project_checks (project_id, number, text, sha256, created_by_id)"
        " VALUES (%s, 1, %s, sha256('x'), %s)",
        *(project["id"], f"# by {ada.name}", OWNER_ID),
    )
    mentions = {(row["resource_type"], row["name"]): row["fields"] for row in erase(api, ada)["mentions"]}
    assert mentions == {
        ("project", project["name"]): ["checks.yaml"],
        ("action", "count"): ["definition"],
        ("run", mission["name"]): ["parameters", "metadata"],
    }
