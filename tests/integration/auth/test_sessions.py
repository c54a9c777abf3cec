"""Browser sessions: HttpOnly cookies, renewed at each sign-in, revoked on request."""

import re

import pytest

from kleinkram.contract.access import Scope
from tests.integration import people
from tests.integration.api_server import Answer, Api
from tests.integration.auth.accounts import PASSWORD, account, sign_in, signed_in
from tests.integration.auth.browser import Browser
from tests.integration.conftest import StartApi

COOKIE = "kleinkram"
_SECURE_URL = "https://kleinkram.lab.example"


def _signed_in(api: Api) -> tuple[Browser, Answer]:
    made, browser = account(api), Browser(api)
    return browser, browser.post("/auth/password", {"email": made.email, "password": PASSWORD})


def test_the_cookie_is_host_only_and_hidden_from_scripts(api: Api) -> None:
    _, answer = _signed_in(api)
    attributes = {part.strip().lower() for part in answer.headers["set-cookie"].split(";")[1:]}
    assert {"httponly", "samesite=lax", "path=/"} <= attributes
    assert not any(part.startswith(("domain", "secure")) for part in attributes)


def test_with_tls_the_cookie_is_secure_and_has_the_host_prefix(start_api: StartApi) -> None:
    _, answer = _signed_in(start_api(public_url=_SECURE_URL))
    name, _, rest = answer.headers["set-cookie"].partition("=")
    assert name == "__Host-kleinkram"
    assert "secure" in {part.strip().lower() for part in rest.split(";")}


def test_signing_in_ends_the_browsers_previous_session(api: Api) -> None:
    ada, ben = account(api), account(api, name="Ben")
    before = ada.browser.cookies[COOKIE]
    sign_in(ada.browser, ben.email)
    assert ada.browser.me()["person"]["id"] == ben.id
    assert not Browser(api, cookies={COOKIE: before}).is_signed_in()


def test_signing_in_never_reuses_a_planted_session(api: Api) -> None:
    made, browser = account(api), Browser(api, cookies={COOKIE: "planted" * 8})
    sign_in(browser, made.email)
    assert browser.is_signed_in()
    assert not Browser(api, cookies={COOKIE: "planted" * 8}).is_signed_in()


def test_signing_out_ends_the_session_and_deletes_the_cookie(api: Api) -> None:
    browser, _ = _signed_in(api)
    locked = dict(browser.cookies)
    browser.post("/auth/sign-out").ok(204)
    assert COOKIE not in browser.cookies
    assert not Browser(api, cookies=locked).is_signed_in()
    Browser(api, cookies=locked).post("/auth/sign-out").ok(204)


def test_a_person_lists_and_ends_their_sessions(api: Api) -> None:
    made, stranger = account(api), signed_in(api)
    others = [Browser(api), Browser(api)]
    for other in others:
        sign_in(other, made.email)
    listed = made.browser.get("/api/v1/me/sessions").ok()["items"]
    assert [item["is_current"] for item in listed] == [False, False, True]
    foreign = stranger.browser.me()["credential"]["id"]
    made.browser.call("DELETE", f"/api/v1/me/sessions/{foreign}").refused(404, "not_found")
    made.browser.call("DELETE", f"/api/v1/me/sessions/{others[0].me()['credential']['id']}").ok(204)
    assert [item.is_signed_in() for item in (*others, made.browser)] == [False, True, True]
    made.browser.call("DELETE", "/api/v1/me/sessions").ok(204)
    assert [item.is_signed_in() for item in (*others, made.browser, stranger.browser)] == [False, False, False, True]


def test_an_unlimited_admin_token_lists_and_ends_sessions(api: Api) -> None:
    made = signed_in(api)
    full = people.token(api, made.id)
    less = people.token(api, made.id, [Scope.write])
    api.as_(less.secret).get("/me/sessions").refused(403, "scope_missing")
    api.as_(full.secret).delete("/me/sessions").ok(204)
    assert not made.browser.is_signed_in()


def test_idle_sessions_expire(api: Api) -> None:
    made = account(api)
    idle_s = api.app.state.settings.session_idle_s
    api.sql("UPDATE session SET last_used_at = now() - make_interval(secs => %s) WHERE person_id = %s", idle_s, made.id)
    made.browser.get("/api/v1/me").refused(401, "not_authenticated")
    sign_in(made.browser, made.email)
    assert len(made.browser.get("/api/v1/me/sessions").ok()["items"]) == 1


def test_a_session_ends_after_its_lifetime_even_if_used(api: Api) -> None:
    made = signed_in(api)
    api.sql("UPDATE session SET expires_at = now() WHERE person_id = %s", made.id)
    assert not made.browser.is_signed_in()


@pytest.mark.parametrize("origin", ["https://evil.example", "null", "http://127.0.0.1:8001", None])
def test_pages_of_other_sites_change_nothing_and_sign_nobody_in(api: Api, origin: str | None) -> None:
    made = account(api)
    foreign = made.browser.from_page_of(origin)
    foreign.post("/projects", {"name": "planted"}).refused(401, "not_authenticated")
    foreign.post("/auth/sign-out").refused(401, "not_authenticated")
    fresh = Browser(api).from_page_of(origin)
    fresh.post("/auth/password", {"email": made.email, "password": PASSWORD}).refused(401, "not_authenticated")
    assert fresh.cookies == {}
    assert made.browser.is_signed_in()


def test_tokens_cannot_use_operations_for_browsers(api: Api) -> None:
    token = api.as_(people.person(api).token)
    token.post("/auth/device/approve", {"user_code": "BCDF-GHJK"}).refused(403, "scope_missing")
    token.post("/auth/password/change", {"old_password": "x", "new_password": "y" * 12}).refused(403, "scope_missing")


def test_sign_in_pages_have_no_inline_code_and_cannot_be_framed(api: Api) -> None:
    for page in ("", "/link", "/invitation", "/reset", "/bootstrap", "/device", "/cli"):
        answer = Browser(api).get(f"/sign-in{page}")
        html = answer.ok()
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert "<script>" not in html
        assert "style=" not in html
        assert not re.search(r"\son\w+=", html)
        buttons = re.findall(r"<button[^>]*>", html)
        assert all(" disabled" in item for item in buttons), "pressed before the script is there, it would do nothing"
    assert "JSON" in Browser(api).get("/sign-in/static/sign-in.js").ok()
    Browser(api).get("/sign-in/static/..%2fpages.py").refused(404, "not_found")
    Browser(api).get("/sign-in/nothing").refused(404, "not_found")
