"""The export of all that is kept of a person: complete, without secrets, for them and for admins."""

import json
import uuid
from typing import Any

from sqlalchemy.sql.util import find_tables

from kleinkram.contract.access import Right
from kleinkram.contract.people import DataSection
from kleinkram.server.people import export
from kleinkram.server.tables import metadata
from tests.integration.api_server import Api
from tests.integration.people import Person, grant, group, person, session, share, token

# Tables that refer to people, but whose rows are about something else, which they only created, changed or deleted.
_NOT_ABOUT_PEOPLE = {"blob", "scrub", "project_checks", "project_action", "erasure"}


def exported(api: Api, who: Person) -> dict[str, list[Any]]:
    """Return the records of an export by section."""
    sections: dict[str, list[Any]] = {}
    for line in api.get(f"/people/{who.id}/export").ok().splitlines():
        row = json.loads(line)
        sections.setdefault(row["section"], []).append(row["record"])
    return sections


def test_a_person_exports_their_own_data(api: Api) -> None:
    email = f"{uuid.uuid4().hex}@lab.example"
    ada = person(api, f"Ada {uuid.uuid4().hex[:8]}", email=email)
    hers = api.as_(ada.token)
    project = hers.project()
    mission = hers.mission(project["id"], notes=f"{ada.name} drove")
    team = group(api, members=[ada])
    shared = api.project()
    grant(api, team, Right.read, project_id=shared["id"])
    session(api, ada)
    sections = exported(hers, ada)
    assert list(sections) == [section.value for section in DataSection if section.value in sections]
    (own,) = sections["account"]
    assert (own["id"], own["name"]) == (ada.id, ada.name)
    assert [row["email"] for row in sections["addresses"]] == [email]
    assert len(sections["sessions"]) == 1
    assert [row["id"] for row in sections["tokens"]] == [ada.token_id]
    assert team in [row["id"] for row in sections["groups"]]
    assert {row["project_id"] for row in sections["rights"]} == {project["id"], shared["id"]}
    assert [row["id"] for row in sections["projects"]] == [project["id"]]
    assert [row["id"] for row in sections["missions"]] == [mission["id"]]
    assert [(row["id"], row["fields"]) for row in sections["mentions"]] == [(mission["id"], ["notes"])]
    assert {row["operation"] for row in sections["audit_events"]} >= {"project.create", "mission.create"}


def test_an_export_contains_no_secrets(api: Api) -> None:
    ada = person(api, email=f"{uuid.uuid4().hex}@lab.example")
    session(api, ada)
    api.sql("INSERT INTO password (person_id, hash) VALUES (%s, '$argon2id$secret')", ada.id)
    api.sql("INSERT INTO totp (person_id, secret) VALUES (%s, 'TOTPSECRET')", ada.id)
    api.sql(
        "INSERT INTO identity (id, person_id, issuer, subject, refresh_token)"
        " VALUES (%s, %s, 'https://id.example', 'ada', 'REFRESHTOKEN')",
        *(str(uuid.uuid4()), ada.id),
    )
    text = api.as_(ada.token).get(f"/people/{ada.id}/export").ok()
    for secret in ("argon2id", "TOTPSECRET", "REFRESHTOKEN", "sha256", ada.token):
        assert secret not in text, secret
    assert [row["method"] for row in exported(api, ada)["sign_in"]] == ["password", "second factor"]


def test_only_the_person_and_admins_may_export(api: Api) -> None:
    ada, bob, boss = person(api), person(api), person(api, admin=True)
    group(api, members=[ada, bob])  # they see each other
    path = f"/people/{ada.id}/export"
    api.as_(bob.token).get(path).refused(404, "not_found")
    api.as_(None).get(path).refused(401, "not_authenticated")
    limited = token(api, ada, limits=[api.as_(ada.token).project()["id"]])
    api.as_(limited.secret).get(path).refused(403, "scope_missing")
    exported(api.as_(boss.token), ada)
    exported(api.as_(ada.token), ada)
    events = [event for event in api.events(ada.id) if event["operation"] == "person.export"]
    assert [(event["actor"]["id"], event["as_admin"]) for event in events] == [(ada.id, False), (boss.id, True)]


def test_of_texts_that_mention_a_person_they_get_those_that_they_may_see(api: Api) -> None:
    # Where accounts are open to anybody, people choose their names.
    word = f"falcon{uuid.uuid4().hex[:8]}"
    eve = person(api, word)
    project = api.project(description=f"Project {word} is secret")
    mission = api.mission(project["id"], notes=f"{word} flew", metadata={"robot": word})
    api.mission(project["id"], name=word)
    group(api, f"group {word}")
    link = share(api, mission["id"])
    api.sql("UPDATE share SET name = %s WHERE id = %s", f"link of {word}", link.id)
    hers = api.as_(eve.token)
    assert "mentions" not in exported(hers, eve)
    assert project["id"] not in hers.get(f"/people/{eve.id}/export").ok()
    grant(api, eve, Right.read, mission_id=mission["id"])
    assert [(row["id"], row["fields"]) for row in exported(hers, eve)["mentions"]] == [
        (mission["id"], ["notes", "metadata"])
    ]
    grant(api, eve, Right.write, project_id=project["id"])
    assert len(exported(hers, eve)["mentions"]) == 4
    assert len(exported(api, eve)["mentions"]) == 5


def test_names_and_addresses_of_people_invited_by_them_are_left_out(api: Api) -> None:
    boss, email = person(api, admin=True), f"{uuid.uuid4().hex}@lab.example"
    api.as_(boss.token).post("/people/invitations", {"email": email, "name": "Grace Hopper"}).ok(201)
    (invitation,) = exported(api.as_(boss.token), boss)["invitations"]
    assert (invitation["purpose"], invitation["email"], invitation["name"]) == ("invitation", None, None)


def test_addresses_of_others_are_left_out(api: Api) -> None:
    ada = person(api)
    api.post(f"/people/{ada.id}/admin").ok()
    exported(api.as_(ada.token), ada)
    events = {row["operation"]: row for row in exported(api.as_(ada.token), ada)["audit_events"]}
    assert events["person.make_admin"]["address"] is None
    assert events["person.export"]["address"] is not None


def test_an_export_is_read_in_batches(api: Api, monkeypatch: Any) -> None:
    ada = person(api)
    made = sorted(api.as_(ada.token).project()["id"] for _ in range(5))
    monkeypatch.setattr(export, "_BATCH", 2)
    sections = exported(api.as_(ada.token), ada)
    assert [row["id"] for row in sections["projects"]] == made
    assert len({row["id"] for row in sections["audit_events"]}) == len(sections["audit_events"])


def test_every_table_that_refers_to_a_person_is_exported() -> None:
    referring = {
        table.name
        for table in metadata.sorted_tables
        for key in table.foreign_keys
        if key.column.table.name == "person"
    }
    exported_tables = {table for source in export._sources(uuid.uuid4()) for table in find_tables(source.stmt)}
    assert referring - {table.name for table in exported_tables} == _NOT_ABOUT_PEOPLE
