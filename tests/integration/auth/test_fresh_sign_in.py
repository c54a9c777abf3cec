"""Sensitive operations require a recent sign-in and continue after it."""

import pytest

from kleinkram.contract.access import Scope
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.auth.accounts import PASSWORD, Account, account, code_of
from tests.integration.auth.browser import Browser

_NEW = "another good password"


@pytest.fixture(name="ada")
def _ada(api: Api) -> Account:
    return account(api)


def _age(api: Api, who: Account) -> None:
    api.sql("UPDATE session SET authenticated_at = now() - interval '16 minutes' WHERE person_id = %s", who.id)


_SENSITIVE = [
    ("POST", "/auth/password/change", {"old_password": PASSWORD, "new_password": _NEW}),
    ("POST", "/me/totp", None),
    ("POST", "/me/totp/confirm", {"code": "000000"}),
    ("POST", "/me/totp/recovery-codes", None),
    ("DELETE", "/me/totp", None),
    ("POST", "/auth/providers/lab/link", {"return_to": "/"}),
    ("DELETE", "/me/identities/00000000-0000-4000-8000-000000000000", None),
    ("POST", "/tokens", {"name": "all", "scopes": ["admin"]}),
    ("POST", "/auth/cli/approve", {"port": 4711, "state": "s" * 20, "code_challenge": "c" * 43}),
    ("POST", "/auth/device/approve", {"user_code": "BCDF-GHJK"}),
]


@pytest.mark.parametrize(("method", "path", "body"), _SENSITIVE)
def test_sensitive_operations_require_a_recent_sign_in(
    api: Api, ada: Account, method: str, path: str, body: object
) -> None:
    _age(api, ada)
    refused = ada.browser.call(method, f"/api/v1{path}", body).refused(403, "sign_in_too_old")
    assert "sign in again" in refused["detail"]
    ada.browser.post("/auth/password/reauthenticate", {"password": "not it at all"}).refused(401, "sign_in_failed")
    assert ada.browser.call(method, f"/api/v1{path}", body).body["code"] == "sign_in_too_old"
    ada.browser.post("/auth/password/reauthenticate", {"password": PASSWORD}).ok(204)
    answer = ada.browser.call(method, f"/api/v1{path}", body)
    assert (answer.body or {}).get("code") != "sign_in_too_old"


def test_a_password_is_changed_only_after_signing_in_again(api: Api, ada: Account) -> None:
    _age(api, ada)
    change = {"old_password": PASSWORD, "new_password": _NEW}
    ada.browser.post("/auth/password/change", change).refused(403, "sign_in_too_old")
    ada.browser.post("/auth/password/reauthenticate", {"password": PASSWORD}).ok(204)
    ada.browser.post("/auth/password/change", change).ok(204)
    assert "session.renew" in [event["operation"] for event in api.get("/audit", {"person_id": ada.id}).ok()["items"]]


def test_an_old_sign_in_of_an_admin_cannot_change_other_accounts(api: Api, ada: Account) -> None:
    api.post(f"/people/{ada.id}/admin").ok()
    _age(api, ada)
    for method, path in (("POST", "reset"), ("DELETE", "totp"), ("POST", "admin")):
        ada.browser.call(method, f"/api/v1/people/{ada.id}/{path}", None).refused(403, "sign_in_too_old")
    ada.browser.post("/auth/password/reauthenticate", {"password": PASSWORD}).ok(204)
    ada.browser.post(f"/people/{ada.id}/reset").ok(201)


def test_an_old_session_of_the_owner_creates_no_sign_in_link(api: Api) -> None:
    browser = Browser(api)
    browser.post("/auth/link", {"code": code_of(api.post("/auth/owner-link").ok()["url"])}).ok()
    api.sql("UPDATE session SET authenticated_at = now() - interval '16 minutes'")
    browser.post("/auth/owner-link").refused(403, "sign_in_too_old")
    api.post("/auth/owner-link").ok()


def test_tokens_without_the_scope_admin_need_no_recent_sign_in(api: Api, ada: Account) -> None:
    _age(api, ada)
    ada.browser.post("/tokens", {"name": "writes", "scopes": ["write"]}).ok(201)


def test_an_old_token_creates_no_token_with_the_scope_admin(api: Api) -> None:
    who = people.person(api)
    theirs = api.as_(who.token)
    theirs.post("/tokens", {"name": "made soon after", "scopes": ["admin"]}).ok(201)
    api.sql("UPDATE token SET created_at = now() - interval '16 minutes' WHERE id = %s", who.token_id)
    refused = theirs.post("/tokens", {"name": "late", "scopes": ["admin"]}).refused(403, "sign_in_too_old")
    assert "klein login" in refused["detail"]


def test_a_token_made_by_a_token_is_no_sign_in(api: Api) -> None:
    theirs = api.as_(people.person(api).token)
    made = theirs.post("/tokens", {"name": "made", "scopes": [Scope.admin.value]}).ok(201)
    api.as_(made["secret"]).post("/tokens", {"name": "grandchild", "scopes": ["admin"]}).refused(403, "sign_in_too_old")


def test_the_owner_token_file_creates_tokens_at_any_time(api: Api) -> None:
    api.sql("UPDATE token SET created_at = now() - interval '1 year' WHERE name = 'local owner'")
    api.post("/tokens", {"name": "of the owner", "scopes": ["admin"]}).ok(201)
