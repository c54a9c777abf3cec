"""Tokens through HTTP: who creates which, what it allows, and how it ends."""

import datetime
import re
import uuid
from pathlib import Path
from typing import Any

import pytest

from kleinkram import connect
from kleinkram.client.transfer import Outcome, plan_upload
from kleinkram.client.transfer.upload import upload as send_files
from kleinkram.contract.access import Right, Scope, TokenKind
from kleinkram.contract.errors import FileExists
from kleinkram.contract.token_format import PATTERN, has_valid_checksum
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.races import racing
from tests.integration.upload_client import upload


def _made(api: Api, **expected: Any) -> Any:
    return api.post("/tokens", {"name": "a token", **expected}).ok(201)


def _in(**span: float) -> str:
    return (datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(**span)).isoformat()


def test_a_secret_is_shown_once_and_works_until_it_is_revoked(api: Api) -> None:
    ada = people.person(api)
    project = api.project()
    people.grant(api, ada, Right.read, project_id=project["id"])
    hers = api.as_(ada.token)
    made = _made(hers, name="laptop", scopes=["read"])
    assert re.fullmatch(PATTERN, made["secret"])
    assert has_valid_checksum(made["secret"])
    token_id = made["token"]["id"]
    assert made["secret"].startswith(made["token"]["prefix"])
    listed = {item["id"]: item for item in hers.all("/tokens")}
    assert listed[token_id]["last_used_at"] is None
    assert "secret" not in str(listed)
    assert made["secret"][20:] not in str([hers.events(token_id), api.events(token_id), listed])

    with_it = api.as_(made["secret"])
    assert project["id"] in {item["id"] for item in with_it.all("/projects")}
    with_it.post("/projects", {"name": "x"}).refused(403, "scope_missing")
    assert {item["id"]: item for item in hers.all("/tokens")}[token_id]["last_used_at"] is not None

    hers.delete(f"/tokens/{token_id}").ok(204)
    with_it.get("/projects").refused(401, "not_authenticated")
    assert token_id not in {item["id"] for item in hers.all("/tokens")}
    assert {item["id"]: item for item in hers.all("/tokens", {"ended": "true"})}[token_id]["revoked_at"] is not None
    hers.delete(f"/tokens/{token_id}").ok(204)
    assert [event["operation"] for event in api.events(token_id)] == ["token.revoke", "token.create"]


def test_only_the_hash_of_a_token_is_stored(api: Api) -> None:
    made = _made(api, name="kept")
    rows = api.sql("SELECT * FROM token WHERE id = %s", made["token"]["id"])
    assert made["secret"] not in str(rows)
    assert not has_valid_checksum(made["token"]["prefix"])


@pytest.mark.parametrize(
    ("expected", "field"),
    [
        ({"kind": "robot"}, "limited"),
        ({"kind": "robot", "scopes": ["admin"], "project_ids": ["PROJECT"]}, "admin"),
        ({"kind": "runner", "scopes": ["run", "read"]}, "runner"),
        ({"kind": "runner", "mission_ids": ["6b1f8c52-6b0e-4f5e-9d43-0a54b1d3f0aa"]}, "runner"),
        ({"expires_at": "2020-01-01T00:00:00Z"}, "expires_at"),
        ({"scopes": []}, "scopes"),
        ({"name": ""}, "name"),
    ],
)
def test_invalid_token_requests_name_the_invalid_field(api: Api, expected: dict[str, Any], field: str) -> None:
    project_id = api.project()["id"]
    body = {"name": "x", **expected}
    if "project_ids" in body:
        body["project_ids"] = [project_id]
    assert field in str(api.post("/tokens", body).refused(422, "invalid_request"))


def test_a_token_cannot_be_limited_to_objects_its_creator_cannot_see(api: Api) -> None:
    ada = people.person(api)
    seen, unseen = api.project(), api.project()
    mission, other = api.mission(seen["id"]), api.mission(unseen["id"])
    people.grant(api, ada, Right.delete, project_id=seen["id"])
    hers = api.as_(ada.token)
    hers.post("/tokens", {"name": "x", "project_ids": [unseen["id"]]}).refused(404, "not_found")
    hers.post("/tokens", {"name": "x", "mission_ids": [other["id"]]}).refused(404, "not_found")
    hers.post("/tokens", {"name": "x", "mission_ids": [mission["id"], mission["id"]]}).ok(201)
    made = _made(hers, project_ids=[seen["id"]])
    assert made["token"]["limits"] == [{"resource_type": "project", "id": seen["id"], "name": seen["name"]}]
    # Limits on objects that are no longer visible to her keep their id, without a name.
    api.sql("DELETE FROM access_grant WHERE group_id = %s", ada.group_id)
    (limit,) = {item["id"]: item for item in hers.all("/tokens")}[made["token"]["id"]]["limits"]
    assert limit == {"resource_type": "project", "id": seen["id"], "name": None}


def test_a_token_cannot_create_a_wider_token(api: Api) -> None:
    ada = people.person(api)
    inside, outside = api.project(), api.project()
    for project in (inside, outside):
        people.grant(api, ada, Right.delete, project_id=project["id"])
    narrow = people.token(api, ada, [Scope.admin], limits=[inside["id"]], expires_s=3600)
    with_it = api.as_(narrow.secret)
    limited: dict[str, Any] = {"name": "x", "project_ids": [inside["id"]]}
    assert "limited" in with_it.post("/tokens", {"name": "x"}).refused(403, "token_too_wide")["detail"]
    with_it.post("/tokens", {"name": "x", "project_ids": [outside["id"]]}).refused(404, "not_found")
    late = with_it.post("/tokens", {**limited, "expires_at": _in(hours=2)}).refused(403, "token_too_wide")
    assert "outlive" in late["detail"]
    soon = _made(with_it, **limited, expires_at=_in(minutes=5))["token"]
    unsaid = _made(with_it, **limited)["token"]
    assert soon["expires_at"] < unsaid["expires_at"], "it ends with the one that made it"
    for scopes in (["read"], ["write"], ["upload"]):
        api.as_(people.token(api, ada, [Scope(scope) for scope in scopes]).secret).post(
            "/tokens", {"name": "x", "scopes": scopes}
        ).refused(403, "scope_missing")
    # The scope `admin` does not extend the rights of the token's person.
    everything = _made(api.as_(ada.token), scopes=["admin"])
    api.as_(everything["secret"]).get("/tokens", {"everybody": "true"}).refused(403, "forbidden")


def test_an_upload_token_for_one_project_sees_no_other_project(api: Api) -> None:
    project, other = api.project(), api.project()
    api.mission(other["id"])
    mission = api.mission(project["id"])
    robot = _made(api, name="anymal", kind="robot", project_ids=[project["id"]])
    assert robot["token"]["scopes"] == ["upload"]
    its = api.as_(robot["secret"])
    assert [item["id"] for item in its.all("/projects")] == [project["id"]]
    assert [item["id"] for item in its.all("/missions")] == [mission["id"]]
    its.get(f"/projects/{other['id']}").refused(404, "not_found")
    its.post(f"/projects/{other['id']}/missions", {"name": "x"}).refused(404, "not_found")
    for path in ("/files", "/topics", "/stats", "/trash", "/audit", "/tokens"):
        its.get(path).refused(403, "scope_missing")


def test_an_upload_only_token_sees_that_a_file_exists_and_nothing_else(api: Api, tmp_path: Path) -> None:
    ada, mission = people.person(api), api.mission(api.project()["id"], notes="secret", metadata_yaml="robot: spot\n")
    people.grant(api, ada, Right.create, mission_id=mission["id"])
    secret = people.token(api, ada, [Scope.upload], limits=[mission["id"]]).secret
    (tmp_path / "same.bin").write_bytes(b"brought by another, and by the robot")
    (tmp_path / "other.bin").write_bytes(b"of the robot")
    (tmp_path / "new.bin").write_bytes(b"not there yet")
    for path, body in (("same.bin", (tmp_path / "same.bin").read_bytes()), ("other.bin", b"of another")):
        upload(api, mission["id"], path, body)
    with connect(api.url, secret) as client:
        report = send_files(client, uuid.UUID(mission["id"]), plan_upload([f"{tmp_path}/"]))
        new, other, same = sorted(report.results, key=lambda result: result.path)
        assert (new.outcome, same.outcome, same.file_id) == (Outcome.uploaded, Outcome.already_present, None)
        assert isinstance(other.error, FileExists)
        assert (other.error.existing_sha256, other.error.existing_file_id) == (None, None)
        assert "other content" in str(other.error)
        seen = client.missions.get(mission["name"], project=mission["project"]["name"])
    assert (seen.file_count, seen.size_bytes) == (1, 13), "what it brought itself"
    assert (seen.notes, seen.metadata, seen.metadata_yaml) == ("", {}, None)


@pytest.mark.parametrize("query", [{"where": "robot=spot"}, {"satisfied": "true"}])
def test_an_upload_token_cannot_filter_by_hidden_values(api: Api, query: dict[str, str]) -> None:
    project = api.project(description="about something")
    api.mission(project["id"], notes="secret", metadata_yaml="robot: spot\n")
    its = api.as_(_made(api, kind="robot", project_ids=[project["id"]])["secret"])
    its.get("/missions", query).refused(422, "invalid_query")
    for text in ("secret", "spot", "something"):
        assert its.all("/missions", {"text": text}) == its.all("/projects", {"text": text}) == []
    assert its.all("/projects")[0]["description"] == ""
    form = its.get(f"/projects/{project['id']}/template").ok()
    assert (form["prefilled_from"], "spot" in form["yaml"]) == (None, False)


def test_only_admins_create_runner_tokens_which_give_no_access_to_data(api: Api) -> None:
    ada = people.person(api)
    api.as_(ada.token).post("/tokens", {"name": "x", "kind": "runner"}).refused(403, "forbidden")
    runner = api.as_(_made(api, name="desk", kind="runner")["secret"])
    runner.get("/service").ok()
    for path in ("/projects", "/missions", "/files", "/tokens", "/audit"):
        runner.get(path).refused(403, "scope_missing")


def test_admins_list_and_revoke_tokens_of_others(api: Api) -> None:
    ada, bob = people.person(api), people.person(api)
    hers = _made(api.as_(ada.token), name="hers")["token"]
    bobs = api.as_(bob.token)
    bobs.get("/tokens", {"person_id": ada.id}).refused(403, "forbidden")
    bobs.delete(f"/tokens/{hers['id']}").refused(404, "not_found")
    assert hers["id"] in {item["id"] for item in api.all("/tokens", {"person_id": ada.id})}
    assert {ada.id, bob.id} <= {item["person"]["id"] for item in api.all("/tokens", {"everybody": "true"})}
    limited = people.token(api, people.person(api, admin=True), [Scope.admin], limits=[api.project()["id"]])
    api.as_(limited.secret).get("/tokens", {"everybody": "true"}).refused(403, "scope_missing")
    api.delete(f"/tokens/{hers['id']}").ok(204)
    revoked, _ = api.events(hers["id"])
    assert (revoked["operation"], revoked["as_admin"]) == ("token.revoke", True)


def test_a_token_can_revoke_itself_but_no_other_without_the_scope_admin(api: Api) -> None:
    project = api.project()
    robot, other = (_made(api, kind="robot", project_ids=[project["id"]]) for _ in range(2))
    its = api.as_(robot["secret"])
    its.delete(f"/tokens/{other['token']['id']}").refused(403, "scope_missing")
    its.delete(f"/tokens/{robot['token']['id']}").ok(204)
    its.get("/projects").refused(401, "not_authenticated")


def test_tokens_created_by_a_token_are_revoked_with_it(api: Api) -> None:
    ada = people.person(api)
    hers = api.as_(ada.token)
    stolen, other = _made(hers, scopes=["admin"]), _made(hers, scopes=["admin"])
    # The creator is set in the database, because a token created by a token cannot create one with the scope admin.
    stolen_id = stolen["token"]["id"]
    api.sql("UPDATE token SET created_by_token_id = NULL WHERE id = %s", stolen_id)
    child = _made(api.as_(stolen["secret"]), scopes=["admin"], name="child")
    api.sql("UPDATE token SET created_by_token_id = %s WHERE id = %s", ada.token_id, stolen_id)
    grandchild = _made(api.as_(child["secret"]), scopes=["read"], name="grandchild")
    hers.delete(f"/tokens/{stolen['token']['id']}").ok(204)
    for made in (stolen, child, grandchild):
        api.as_(made["secret"]).get("/me").refused(401, "not_authenticated")
        ended, _ = api.events(made["token"]["id"])
        assert ended["operation"] == "token.revoke"
        assert ended["after"].get("made_with") == (None if made is stolen else "a token")
    api.as_(other["secret"]).get("/me").ok()


def test_signing_out_keeps_tokens_until_they_are_revoked(api: Api) -> None:
    ada = people.person(api)
    hers = api.as_(ada.token)
    laptop = _made(hers, scopes=["admin"])
    path = f"/tokens/{laptop['token']['id']}"
    robots = _made(api.as_(laptop["secret"]), name="robot")
    api.as_(laptop["secret"]).delete(path, {"made": "valid"}).ok(204)
    api.as_(laptop["secret"]).get("/me").refused(401, "not_authenticated")
    api.as_(robots["secret"]).get("/me").ok()
    hers.delete(path).ok(204)
    api.as_(robots["secret"]).get("/me").refused(401, "not_authenticated")


def test_a_token_being_revoked_creates_no_token(api: Api) -> None:
    ada = people.person(api)
    stolen = people.token(api, ada, [Scope.admin])
    with_it = api.as_(stolen.secret)
    with racing(api, "SELECT id FROM person WHERE id = %s FOR UPDATE", ada.id) as send:
        revoking = send(api.as_(ada.token).delete, f"/tokens/{stolen.id}")
        making = send(with_it.post, "/tokens", {"name": "child"})
    revoking.result().ok(204)
    making.result().refused(401, "not_authenticated")
    assert api.sql("SELECT 1 FROM token WHERE created_by_token_id = %s AND revoked_at IS NULL", stolen.id) == []


def test_a_limited_token_reaches_nothing_outside_its_limits(api: Api) -> None:
    ada, project = people.person(api), api.project()
    people.grant(api, ada, Right.delete, project_id=project["id"])
    narrow, other = people.token(api, ada, [Scope.admin], limits=[project["id"]]), people.token(api, ada)
    people.session(api, ada)
    session_id = api.as_(ada.token).all("/me/sessions")[0]["id"]
    with_it = api.as_(narrow.secret)
    for path in ("/tokens", "/me/sessions", "/me/identities"):
        assert "without limits" in with_it.get(path).refused(403, "scope_missing")["detail"]
    for path in ("/me/sessions", f"/me/sessions/{session_id}", f"/tokens/{other.id}"):
        with_it.delete(path).refused(403, "scope_missing")
    api.as_(other.secret).get("/me").ok()
    _made(with_it, project_ids=[project["id"]])
    with_it.delete(f"/tokens/{narrow.id}").ok(204)


def test_a_truncated_or_mistyped_token_is_recognised(api: Api) -> None:
    secret = _made(api)["secret"]
    wrong = secret[:-10] + ("a" if secret[-10] != "a" else "b") + secret[-9:]
    assert has_valid_checksum(secret)
    assert [has_valid_checksum(item) for item in (wrong, secret[:-1], secret + "x")] == [False] * 3


def test_tokens_of_robots_and_runners_reveal_no_address_and_no_group(api: Api) -> None:
    ada, project = people.person(api, email=f"{uuid.uuid4().hex}@lab.example"), api.project()
    people.group(api, members=[ada])
    limited = people.token(api, ada, (Scope.upload,), limits=[project["id"]], kind=TokenKind.robot)
    runner = people.token(api, ada, (Scope.run,), kind=TokenKind.runner)
    for secret, seen in ((ada.token, 1), (limited.secret, 0), (runner.secret, 0)):
        me = api.as_(secret).get("/me").ok()
        assert (len(me["emails"]), len(me["groups"])) == (seen, seen)


@pytest.fixture(name="lasting", scope="module")
def _valid_until(start_api: StartApi) -> Api:
    return start_api(token_days_max=0)


def _days(made: Any) -> float:
    ends = datetime.datetime.fromisoformat(made["token"]["expires_at"].replace("Z", "+00:00"))
    return (ends - datetime.datetime.now(datetime.timezone.utc)).total_seconds() / 86_400


def _in_days(days: float) -> str:
    return (datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=days)).isoformat()


@pytest.mark.parametrize(("kind", "days"), [("personal", 90), ("runner", 365)])
@pytest.mark.parametrize("text", [{}, {"expires_at": None}])
def test_a_token_expires_after_the_default_lifetime(api: Api, kind: str, days: float, text: dict[str, None]) -> None:
    made = api.post("/tokens", {"name": "usual", "kind": kind, **text}).ok(201)
    assert _days(made) == pytest.approx(days, abs=0.1)


def test_the_expiry_of_a_token_is_limited_by_the_maximum(api: Api) -> None:
    assert _days(api.post("/tokens", {"name": "a", "expires_at": _in_days(365)}).ok(201)) == pytest.approx(365, abs=0.1)
    refused = api.post("/tokens", {"name": "b", "expires_at": _in_days(366)}).refused(422, "invalid_request")
    assert "365 days" in str(refused["problems"])
    api.post("/tokens", {"name": "c", "no_end": True}).refused(422, "invalid_request")


def test_a_server_may_allow_tokens_without_an_end(lasting: Api) -> None:
    assert lasting.post("/tokens", {"name": "a", "no_end": True}).ok(201)["token"]["expires_at"] is None
    assert _days(lasting.post("/tokens", {"name": "b"}).ok(201)) == pytest.approx(90, abs=0.1)
    lasting.post("/tokens", {"name": "c", "no_end": True, "expires_at": _in_days(1)}).refused(422, "invalid_request")


def test_the_service_endpoint_returns_the_lifetimes_of_tokens(api: Api, lasting: Api) -> None:
    text = [item.get("/service").ok() for item in (api, lasting)]
    assert [(item["token_days_default"], item["token_days_max"]) for item in text] == [(90, 365), (90, 0)]
