"""`klein group`, `klein access` and `klein person`, as two people and an admin use them."""

import json
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import kleinkram.cli.people
from kleinkram.cli.main import app
from kleinkram.client.errors import DestinationRefused, InvalidInput
from kleinkram.contract.errors import (
    AmbiguousName,
    Forbidden,
    InvalidRequest,
    LastOwner,
    NotFound,
    PersonErased,
    RightExceeded,
)
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.people import Person, group, person

Klein = Callable[..., Any]


@pytest.fixture
def klein(api: Api, monkeypatch: pytest.MonkeyPatch) -> Klein:
    """A terminal: runs a command with a token and returns its JSON, or raises its error."""

    def run(who: Person | None, *arguments: str, as_json: bool = True) -> Any:
        monkeypatch.setenv("KLEINKRAM_URL", api.url)
        monkeypatch.setenv("KLEINKRAM_TOKEN", str(api.token if who is None else who.token))
        ran = CliRunner().invoke(app, [*arguments, "--json"] if as_json else [*arguments])
        if ran.exception is not None:
            raise ran.exception
        return json.loads(ran.stdout) if as_json else ran.output

    return run


def test_a_second_person_sees_a_project_only_after_a_grant(api: Api, klein: Klein) -> None:
    ada, bob = person(api), person(api, email="bob@lab.example")
    name = klein(ada, "project", "create", f"alps of {ada.name}")["name"]
    with pytest.raises(NotFound):
        klein(bob, "project", "info", name)
    values = klein(ada, "access", "grant", "-p", name, "--to", "bob@lab.example", "read", "--until", "2090-01-01")
    assert (values["to"]["name"], values["right"], values["expires_at"][:10]) == (
        "bob@lab.example",
        "READ",
        "2090-01-01",
    )
    assert klein(bob, "project", "info", name)["right"] == "READ"
    (way,) = klein(bob, "access", "list", "-p", name)["items"]
    assert (way["person"]["id"], way["to"]["name"], way["through"]) == (bob.id, "bob@lab.example", "project grant")
    with pytest.raises(Forbidden):
        klein(bob, "access", "grant", "-p", name, "--to", "x@lab.example", "READ")
    shown = klein(ada, "access", "list", "-p", name, as_json=False)
    assert "email bob@lab.example" in shown
    assert "admins" in shown
    klein(ada, "access", "revoke", "-p", name, "--to", "BOB@lab.example")
    with pytest.raises(NotFound):
        klein(bob, "project", "info", name)
    with pytest.raises(LastOwner):
        klein(ada, "access", "revoke", "-p", name, "--to", ada.name)


def test_a_group_is_created_filled_granted_rights_and_deleted(api: Api, klein: Klein) -> None:
    ada, bob = person(api), person(api)
    group(api, members=[ada, bob])
    name = klein(ada, "group", "create", f"drivers of {ada.name}")["name"]
    (member,) = klein(ada, "group", "add", name, bob.name, "--until", "2090-05-01T12:00:00Z")["items"]
    assert (member["person"]["id"], member["is_editor"]) == (bob.id, False)
    project = api.as_(ada.token).project()
    mission = api.as_(ada.token).mission(project["id"])
    place = ["-p", project["name"], "-m", mission["name"]]
    klein(ada, "access", "grant", *place, "--to", name, "CREATE")
    assert klein(bob, "mission", "info", "-m", mission["id"])["mission"]["right"] == "CREATE"
    assert [row["name"] for row in klein(bob, "group", "list", "drivers*")["items"]] == [name]
    message = klein(bob, "group", "info", name)
    assert [row["person"]["name"] for row in message["members"]] == sorted([ada.name, bob.name])
    assert bob.name in klein(ada, "access", "list", *place, as_json=False)
    assert name in klein(ada, "access", "list", *place, "--grants", as_json=False)
    with pytest.raises(Forbidden):
        klein(bob, "group", "rename", name, "mine")
    renamed = klein(ada, "group", "rename", name, f"{name} II")["name"]
    klein(bob, "group", "remove", renamed, bob.name)
    with pytest.raises(NotFound):
        klein(bob, "mission", "info", "-m", mission["id"])
    klein(ada, "group", "delete", renamed, "--yes")
    assert [row["to"]["name"] for row in klein(ada, "access", "list", *place, "--grants")["items"]] == []


def test_a_name_of_both_a_person_and_a_group_must_be_disambiguated(api: Api, klein: Klein) -> None:
    ada, bob = person(api), person(api)
    duplicate = group(api, bob.name, members=[ada, bob])
    project = api.as_(ada.token).project()
    with pytest.raises(AmbiguousName):
        klein(ada, "access", "grant", "-p", project["name"], "--to", bob.name, "READ")
    values = klein(ada, "access", "grant", "-p", project["name"], "--to", duplicate, "WRITE")
    assert values["to"] == {"kind": "group", "id": duplicate, "name": bob.name}
    with pytest.raises(RightExceeded):
        klein(bob, "access", "grant", "-p", project["name"], "--to", bob.id, "DELETE")


def test_an_admin_lists_and_deactivates_people(api: Api, klein: Klein) -> None:
    ada = person(api, email="ada@lab.example")
    project = api.as_(ada.token).project()
    (actual,) = klein(None, "person", "list", "ada@lab.example")["items"]
    assert (actual["id"], actual["emails"], actual["is_admin"]) == (ada.id, ["ada@lab.example"], False)
    assert klein(None, "person", "admin", "ada@lab.example", "--yes")["is_admin"] is True
    assert klein(ada, "person", "info", ada.id)["is_admin"] is True
    assert klein(None, "person", "admin", ada.id, "--end")["is_admin"] is False
    ended = klein(None, "person", "deactivate", ada.id, "--yes")
    assert (ended["tokens"], ended["projects"]) == (1, [project["name"]])
    (left,) = klein(None, "person", "list", ada.name, "--left")["items"]
    assert left["deactivated_at"] is not None
    assert klein(None, "person", "reactivate", ada.id)["deactivated_at"] is None


def test_an_admin_erases_a_person_after_typing_their_name(
    api: Api, klein: Klein, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kleinkram.cli.people, "_REDACTION_WAIT_S", 0.0)
    ada = person(api, f"Ada {uuid.uuid4().hex[:8]}")
    project = api.as_(ada.token).project()
    mission = api.mission(project["id"], notes=f"{ada.name} drove")
    with pytest.raises(InvalidInput, match="--confirm"):
        klein(None, "person", "erase", ada.id)  # nothing is typed
    with pytest.raises(InvalidRequest, match="is not the name"):
        klein(None, "person", "erase", ada.id, "--confirm", "yes")
    colleague = person(api)
    group(api, members=[ada, colleague])
    with pytest.raises(Forbidden):
        klein(colleague, "person", "erase", ada.id, "--confirm", ada.name)
    shown = klein(None, "person", "erase", ada.id, "--confirm", ada.name, as_json=False)
    assert "A worker will redact the audit log" in shown
    assert mission["name"] in shown
    run_jobs(api)
    again = klein(None, "person", "erase", ada.id)
    assert again["person"]["name"] == f"erased person {ada.id[:8]}"
    assert again["audit_events"] > 0
    with pytest.raises(PersonErased):
        klein(None, "person", "reactivate", ada.id)


def test_people_write_their_own_data_to_a_file(api: Api, klein: Klein, tmp_path: Path) -> None:
    ada, path = person(api, email=f"{uuid.uuid4().hex}@lab.example"), tmp_path / "ada.json"
    project = api.as_(ada.token).project()
    written = klein(ada, "person", "export", "-o", str(path))
    sections = json.loads(path.read_text())
    assert sections["account"][0]["id"] == ada.id
    assert [row["id"] for row in sections["projects"]] == [project["id"]]
    assert written == {"path": str(path), "records": sum(map(len, sections.values()))}
    assert path.stat().st_mode & 0o077 == 0
    with pytest.raises(DestinationRefused, match="exists"):
        klein(ada, "person", "export", "-o", str(path))
    with pytest.raises(InvalidInput, match="-o"):
        klein(ada, "person", "export")
    with pytest.raises(DestinationRefused):
        klein(ada, "person", "export", "-o", str(tmp_path / "missing" / "ada.json"))
    klein(None, "person", "export", ada.id, "-o", str(tmp_path / "by-admin.json"))
    colleague = person(api)
    group(api, members=[ada, colleague])
    with pytest.raises(NotFound):
        klein(colleague, "person", "export", ada.id, "-o", str(tmp_path / "colleague.json"))
    assert not (tmp_path / "colleague.json").exists()
