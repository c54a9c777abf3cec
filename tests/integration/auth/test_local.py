"""Local accounts: invitation, sign-in, change and reset of the password; nothing reveals who has an account."""

from typing import Any

import pytest

from kleinkram.contract.access import Right
from kleinkram.contract.errors import RateLimited
from kleinkram.server.context import AppContext
from kleinkram.server.http import rate_limit
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.auth.accounts import PASSWORD, account, any_email, code_of, sign_in
from tests.integration.auth.browser import USER_AGENT, Browser
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site

OTHER_PASSWORD = "a wholly different one"


def test_an_invited_person_creates_an_account_and_signs_in_by_password(api: Api) -> None:
    made = account(api, name="Ada Lovelace")
    assert made.browser.me()["emails"] == [made.email]
    again = Browser(api)
    sign_in(again, made.email.upper())
    me = again.me()
    assert (me["person"], me["is_admin"]) == ({"id": made.id, "name": "Ada Lovelace"}, False)
    assert (me["credential"]["kind"], me["credential"]["name"]) == ("session", "password")
    operations = {event["operation"] for event in api.all("/audit", {"person_id": made.id})}
    assert {"session.create"} <= operations


def test_an_invitation_is_valid_once_and_until_a_newer_one(api: Api) -> None:
    email = any_email()
    older, newer = (code_of(api.post("/people/invitations", {"email": email}).ok(201)["url"]) for _ in range(2))
    accepted = {"name": "Ada", "password": PASSWORD}
    Browser(api).post("/auth/invitation", {"code": older, **accepted}).refused(410, "code_gone")
    assert Browser(api).post("/auth/codes", {"code": newer}).ok()["email"] == email
    Browser(api).post("/auth/invitation", {"code": newer, **accepted}).ok()
    Browser(api).post("/auth/invitation", {"code": newer, **accepted}).refused(410, "code_gone")
    api.post("/people/invitations", {"email": email}).refused(409, "name_taken")


def test_an_expired_invitation_is_refused(api: Api) -> None:
    email = any_email()
    code = code_of(api.post("/people/invitations", {"email": email}).ok(201)["url"])
    api.sql("UPDATE one_time_code SET expires_at = now() WHERE email = %s", email)
    accepted = {"code": code, "name": "Ada", "password": PASSWORD}
    Browser(api).post("/auth/invitation", accepted).refused(410, "code_gone")


def test_only_admins_invite_people_and_reset_passwords(api: Api) -> None:
    made = account(api)
    made.browser.post("/people/invitations", {"email": any_email()}).refused(403, "forbidden")
    made.browser.post(f"/people/{made.id}/reset").refused(403, "forbidden")


def test_an_invited_person_gets_the_rights_granted_to_their_address(api: Api) -> None:
    email, project = any_email(), api.project()
    people.grant(api, people.email_group(api, email), Right.read, project_id=project["id"])
    made = account(api, email=email)
    assert made.browser.get(f"/api/v1/projects/{project['id']}").ok()["name"] == project["name"]


@pytest.mark.parametrize("wrong", ["not the password", "", PASSWORD + " "])
def test_wrong_passwords_and_unknown_addresses_are_refused_alike(api: Api, wrong: str) -> None:
    made = account(api)
    answers = [
        Browser(api).post("/auth/password", {"email": email, "password": wrong})
        for email in (made.email, any_email(), "not an address", "")
    ]
    bodies = [{**answer.refused(401, "sign_in_failed"), "request_id": ""} for answer in answers]
    assert all(body == bodies[0] for body in bodies)
    assert all("set-cookie" not in answer.headers for answer in answers)


def test_failed_sign_ins_are_audited_without_the_input(start_api: StartApi) -> None:
    api = start_api()
    Browser(api).post("/auth/password", {"email": "ada@lab.example", "password": "hunter2-hunter2"})
    (event,) = (item for item in api.all("/audit") if item["operation"] == "auth.refused")
    assert event["resource_name"] == "POST /api/v1/auth/password"
    assert "hunter2" not in str(event)


def test_changing_a_password_requires_the_old_one_and_ends_other_sessions(api: Api) -> None:
    made, other = account(api), Browser(api)
    sign_in(other, made.email)
    expected = {"old_password": "wrong", "new_password": OTHER_PASSWORD}
    made.browser.post("/auth/password/change", expected).refused(401, "sign_in_failed")
    assert other.is_signed_in()
    made.browser.post("/auth/password/change", {**expected, "old_password": PASSWORD}).ok(204)
    assert (made.browser.is_signed_in(), other.is_signed_in()) == (True, False)
    Browser(api).post("/auth/password", {"email": made.email, "password": PASSWORD}).refused(401, "sign_in_failed")
    sign_in(Browser(api), made.email, OTHER_PASSWORD)


def test_a_password_cannot_be_ones_name_or_address(api: Api) -> None:
    email = any_email()
    code = code_of(api.post("/people/invitations", {"email": email}).ok(201)["url"])
    accepted = {"code": code, "name": "Ada Lovelace"}
    for obvious in ("Ada Lovelace", "ada lovelace ", email, email.upper(), email.partition("@")[0]):
        problem = (
            Browser(api).post("/auth/invitation", {**accepted, "password": obvious}).refused(422, "invalid_request")
        )
        assert problem["problems"][0]["field"] == "password"
    Browser(api).post("/auth/invitation", {**accepted, "password": PASSWORD}).ok()


def test_a_short_password_is_refused(api: Api) -> None:
    code = code_of(api.post("/people/invitations", {"email": any_email()}).ok(201)["url"])
    Browser(api).post("/auth/invitation", {"code": code, "password": "nine char"}).refused(422, "invalid_request")


def test_a_reset_link_sets_a_new_password_and_ends_all_sessions(api: Api) -> None:
    made, other = account(api), Browser(api)
    link = api.post(f"/people/{made.id}/reset").ok(201)["url"]
    assert link.startswith(f"{made.browser.public_url}/sign-in/reset#")
    assert other.post("/auth/codes", {"code": code_of(link)}).ok()["name"] == made.name
    reset = {"code": code_of(link), "password": OTHER_PASSWORD}
    other.post("/auth/reset", reset).ok()
    assert (made.browser.is_signed_in(), other.is_signed_in()) == (False, True)
    other.post("/auth/reset", reset).refused(410, "code_gone")
    sign_in(Browser(api), made.email, OTHER_PASSWORD)
    assert {"password.reset_link", "password.reset"} <= {event["operation"] for event in api.events(made.id)}


def test_a_reset_revokes_only_personal_tokens_and_a_change_none(api: Api) -> None:
    made, project = account(api), api.project()
    people.grant(
        api,
        api.sql("SELECT id FROM access_group WHERE person_id = %s", made.id)[0][0],
        Right.create,
        project_id=project["id"],
    )
    expected: dict[str, dict[str, Any]] = {
        "laptop": {"scopes": ["admin"]},
        "anymal": {"kind": "robot", "project_ids": [project["id"]]},
    }
    secrets = [
        made.browser.post("/tokens", {"name": name, **rest}).ok(201)["secret"] for name, rest in expected.items()
    ]
    laptop, robot = (api.as_(secret) for secret in secrets)
    passwords = {"old_password": PASSWORD, "new_password": "a third one, longer"}
    made.browser.post("/auth/password/change", passwords).ok(204)
    laptop.get("/me").ok()
    reset = {"code": code_of(api.post(f"/people/{made.id}/reset").ok(201)["url"]), "password": OTHER_PASSWORD}
    Browser(api).post("/auth/reset", reset).ok()
    laptop.get("/me").refused(401, "not_authenticated")
    robot.get("/projects").ok()
    message = next(event["after"] for event in api.events(made.id) if event["operation"] == "password.reset")
    assert message["tokens"] == 1


def test_one_time_links_do_not_survive_removal_and_return(api: Api) -> None:
    made, removed = account(api), people.person(api, admin=True)
    reset = code_of(api.post(f"/people/{made.id}/reset").ok(201)["url"])
    invited = {"email": any_email()}
    invitation = code_of(api.as_(removed.token).post("/people/invitations", invited).ok(201)["url"])
    for who in (made, removed):
        api.post(f"/people/{who.id}/deactivate").ok()
        api.post(f"/people/{who.id}/reactivate").ok()
    for code in (reset, invitation):
        Browser(api).post("/auth/codes", {"code": code}).refused(410, "code_gone")
    Browser(api).post("/auth/reset", {"code": reset, "password": OTHER_PASSWORD}).refused(410, "code_gone")


@pytest.mark.parametrize("how", ["deactivate", "dismiss"])
def test_links_end_when_their_creator_loses_admin_rights(api: Api, how: str) -> None:
    removed, victim = people.person(api, admin=True), account(api)
    theirs = api.as_(removed.token)
    invitation = code_of(theirs.post("/people/invitations", {"email": any_email()}).ok(201)["url"])
    reset = code_of(theirs.post(f"/people/{victim.id}/reset").ok(201)["url"])
    if how == "deactivate":
        api.post(f"/people/{removed.id}/deactivate").ok()
    else:
        api.delete(f"/people/{removed.id}/admin").ok()
    remaining = Browser(api)
    remaining.post("/auth/codes", {"code": invitation}).refused(410, "code_gone")
    remaining.post("/auth/invitation", {"code": invitation, "name": "Ghost", "password": PASSWORD}).refused(
        410, "code_gone"
    )
    remaining.post("/auth/reset", {"code": reset, "password": OTHER_PASSWORD}).refused(410, "code_gone")
    assert victim.browser.is_signed_in()


def test_a_removed_person_cannot_sign_in_and_has_no_session(api: Api) -> None:
    made = account(api)
    reset = code_of(api.post(f"/people/{made.id}/reset").ok(201)["url"])
    api.sql("UPDATE person SET deactivated_at = now() WHERE id = %s", made.id)
    assert not made.browser.is_signed_in()
    Browser(api).post("/auth/password", {"email": made.email, "password": PASSWORD}).refused(401, "sign_in_failed")
    Browser(api).post("/auth/reset", {"code": reset, "password": PASSWORD}).refused(403, "sign_in_refused")
    api.post(f"/people/{made.id}/reset").refused(404, "not_found")


def test_signing_in_renews_a_hash_with_older_parameters(api: Api) -> None:
    from argon2 import PasswordHasher

    made = account(api)
    older = PasswordHasher(time_cost=1, memory_cost=8192, parallelism=1).hash(PASSWORD)
    api.sql("UPDATE password SET hash = %s WHERE person_id = %s", older, made.id)
    sign_in(Browser(api), made.email)
    ((remaining,),) = api.sql("SELECT hash FROM password WHERE person_id = %s", made.id)
    assert remaining != older
    sign_in(Browser(api), made.email)


def test_sign_in_attempts_are_limited_for_unknown_addresses_too(
    start_api: StartApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rate_limit, "_WINDOW", rate_limit._WINDOW * 60 * 24 * 365)
    api = start_api(sign_ins_per_minute=3)
    tries = [
        Browser(api).post("/auth/password", {"email": "nobody@lab.example", "password": f"guess number {number}"})
        for number in range(5)
    ]
    assert [answer.status for answer in tries] == [401, 401, 401, 429, 429]
    assert tries[-1].refused(429, "rate_limited")["what"] == "sign-ins"
    assert int(tries[-1].headers["retry-after"]) >= 1


def _guess(api: Api, email: str, password: str, address: str) -> int:
    headers = {"Origin": api.app.state.settings.public_origin, "X-Forwarded-For": address}
    body = {"email": email, "password": password}
    return api.as_(None).call("POST", "/auth/password", body, headers=headers).status


def test_failed_attempts_do_not_lock_out_the_owner_of_an_account(
    start_api: StartApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rate_limit, "_WINDOW", rate_limit._WINDOW * 60 * 24 * 365)
    api = start_api(sign_ins_per_minute=2, trusted_proxies=["127.0.0.1/32"])
    made = account(api)
    thief = [_guess(api, made.email, f"guess number {number}", "203.0.113.9") for number in range(4)]
    assert thief == [401, 401, 429, 429]
    assert _guess(api, made.email, PASSWORD, "198.51.100.1") == 200


def test_attempts_on_an_account_from_many_addresses_are_delayed(
    start_api: StartApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rate_limit, "_WINDOW", rate_limit._WINDOW * 60 * 24 * 365)
    monkeypatch.setattr(rate_limit, "_SLOT", rate_limit._SLOT * 1000)
    monkeypatch.setattr(rate_limit, "_MAX_SLOTS_AHEAD", 3)
    waits: list[float] = []
    email = any_email()

    async def ask(context: AppContext) -> None:
        while True:
            waits.append(await rate_limit.reserve_slot(context.database, rate_limit.Count("sign-ins", email, 2)))

    with pytest.raises(RateLimited):
        on_site(start_api(), ask)
    assert waits[:2] == [0, 0]
    assert [round(waited - waits[2]) for waited in waits[2:]] == [0, 2000, 4000]


def test_password_sign_in_is_off_without_local_accounts(start_api: StartApi) -> None:
    api = start_api(local_accounts=False)
    methods = Browser(api).get("/api/v1/auth/methods").ok()
    assert methods == {"password": False, "providers": [], "bootstrap": False}
    Browser(api).post("/auth/password", {"email": "a@b.example", "password": "x"}).refused(404, "not_found")
    assert 'name="password"' not in Browser(api).get("/sign-in").ok()
    api.post("/people/invitations", {"email": any_email()}).refused(403, "forbidden")


def test_a_session_lists_address_and_browser(api: Api) -> None:
    made = account(api)
    (own,) = made.browser.get("/api/v1/me/sessions").ok()["items"]
    assert (own["method"], own["address"], own["user_agent"]) == ("password", "127.0.0.1", USER_AGENT)
