"""Conflicts, error sentences, hashes and lists of names reveal nothing about hidden objects."""

import os
import uuid
from typing import Any

import pytest

from kleinkram.contract.access import Right, Scope, TokenKind
from tests.integration import people
from tests.integration.api_server import Answer, Api
from tests.integration.people import Person
from tests.integration.upload_client import begin, sha256, upload

_VERIFIED = (
    "UPDATE blob SET state = 'verified', verified_at = now(), md5 = decode(repeat('00', 16), 'hex') WHERE sha256 = %s"
)


@pytest.fixture(name="hidden")
def _hidden(api: Api) -> Any:
    """A project without grants."""
    return api.project()


@pytest.fixture(name="member")
def _member(api: Api) -> Person:
    """The owner of another project."""
    return people.person(api)


def _own_mission(api: Api, who: Person) -> str:
    project = api.project()["id"]
    people.grant(api, who, Right.delete, project_id=project)
    return str(api.mission(project)["id"])


def _same_but_for_ids(one: Answer, other: Answer) -> bool:
    """Whether two refusals are equal except for the requested ids."""

    def answers(answer: Answer) -> dict[str, Any]:
        ref = str(answer.body.get("ref"))
        remaining = {name: value for name, value in answer.body.items() if name not in {"request_id", "ref"}}
        return {**remaining, "detail": remaining["detail"].replace(ref, "REF")}

    headers = [{name for name in answer.headers if name != "date"} for answer in (one, other)]
    return (one.status, answers(one), headers[0]) == (other.status, answers(other), headers[1])


@pytest.mark.parametrize("path", ["", "/template", "/access", "/grants"])
def test_a_hidden_project_looks_like_a_missing_one(api: Api, hidden: Any, member: Person, path: str) -> None:
    theirs = api.as_(member.token)
    answers = [theirs.get(f"/projects/{ref}{path}") for ref in (hidden["id"], uuid.uuid4())]
    assert _same_but_for_ids(*answers), answers


@pytest.mark.parametrize("path", ["", "/recordings", "/uploads", "/access", "/grants"])
def test_a_hidden_mission_looks_like_a_missing_one(api: Api, hidden: Any, member: Person, path: str) -> None:
    theirs, mission = api.as_(member.token), api.mission(hidden["id"])["id"]
    answers = [theirs.get(f"/missions/{ref}{path}") for ref in (mission, uuid.uuid4())]
    assert _same_but_for_ids(*answers), answers


def test_changes_to_hidden_objects_are_refused_like_missing_ones(api: Api, hidden: Any, member: Person) -> None:
    theirs, mission = api.as_(member.token), api.mission(hidden["id"])["id"]
    pairs = [
        (f"/projects/{hidden['id']}", f"/projects/{uuid.uuid4()}"),
        (f"/missions/{mission}", f"/missions/{uuid.uuid4()}"),
    ]
    for there, nowhere in pairs:
        assert _same_but_for_ids(theirs.patch(there, {"name": "mine"}), theirs.patch(nowhere, {"name": "mine"}))
        assert _same_but_for_ids(theirs.delete(there), theirs.delete(nowhere))
    mine = _own_mission(api, member)
    moves = [theirs.patch(f"/missions/{mine}", {"project_id": ref}) for ref in (hidden["id"], str(uuid.uuid4()))]
    assert _same_but_for_ids(*moves), moves


def test_a_name_taken_by_a_hidden_object_reveals_nothing_else(api: Api, hidden: Any, member: Person) -> None:
    """Project names are unique on a server (docs/access.md), so a conflict reveals the name, but not its owner."""
    problem = api.as_(member.token).post("/projects", {"name": hidden["name"]}).refused(409, "name_taken")
    message = problem.keys() - {"type", "title", "status", "detail", "code", "request_id"}
    assert (message, problem["resource_type"], problem["name"]) == (
        {"resource_type", "name"},
        "project",
        hidden["name"],
    )


def test_a_hash_does_not_reveal_whether_the_bytes_exist(api: Api, hidden: Any, member: Person) -> None:
    secret, other = os.urandom(2000), os.urandom(2000)
    upload(api, api.mission(hidden["id"])["id"], "secret.bin", secret)
    api.sql(_VERIFIED, bytes.fromhex(sha256(secret)))
    theirs, mine = api.as_(member.token), _own_mission(api, member)
    decisions = begin(theirs, mine, {"a.bin": secret, "b.bin": other})
    decisions += begin(theirs, mine, {"c.bin": secret, "d.bin": os.urandom(2001)}, hashed=False)
    assert [item["decision"] for item in decisions] == ["upload"] * 4
    assert [sorted(item["upload"]) for item in decisions[1:]] == [sorted(decisions[0]["upload"])] * 3


def test_upload_rights_alone_reveal_no_hash_and_no_other_path(api: Api, member: Person) -> None:
    mission = _own_mission(api, member)
    there = b"what is there"
    upload(api, mission, "Runs/one.bin", there)
    robot = people.token(api, member, [Scope.upload], limits=[mission], kind=TokenKind.robot)
    theirs = api.as_(robot.secret)
    for path in ("Runs/one.bin", "runs/ONE.bin", "Runs", "Runs/one.bin/more"):
        (refused,) = begin(theirs, mission, {path: b"something else"})
        assert refused["decision"] == "refused", path
        message = str(refused["problem"]).replace(repr(path), "")
        assert sha256(there) not in message, path
        assert "one.bin" not in message.replace(path, ""), path


def test_a_hidden_person_looks_like_a_missing_one(api: Api, member: Person) -> None:
    theirs, stranger = api.as_(member.token), people.person(api, email=f"{uuid.uuid4().hex}@elsewhere.test")
    answers = [theirs.get(f"/people/{ref}") for ref in (stranger.id, uuid.uuid4())]
    assert _same_but_for_ids(*answers), answers
    project = api.project()["id"]
    people.grant(api, member, Right.delete, project_id=project)
    values = [
        theirs.post(f"/projects/{project}/grants", {"person_id": str(ref), "right": "READ"})
        for ref in (stranger.id, uuid.uuid4())
    ]
    assert _same_but_for_ids(*values), values


def test_a_right_on_a_mission_shows_only_the_name_of_its_project(api: Api, hidden: Any, member: Person) -> None:
    mine, other = (api.mission(hidden["id"], name=name)["id"] for name in ("mine", "theirs"))
    people.grant(api, member, Right.delete, mission_id=mine)
    theirs = api.as_(member.token)
    assert theirs.get(f"/missions/{mine}").ok()["project"] == {"id": hidden["id"], "name": hidden["name"]}
    assert _same_but_for_ids(theirs.get(f"/projects/{hidden['id']}"), theirs.get(f"/projects/{uuid.uuid4()}"))
    assert _same_but_for_ids(theirs.get(f"/missions/{other}"), theirs.get(f"/missions/{uuid.uuid4()}"))
    taken = theirs.patch(f"/missions/{mine}", {"name": "theirs"}).refused(409, "name_taken")
    assert taken["name"] == "theirs", "a conflict says what was asked for, and nothing of what it meets"
