"""Sign-in of programs: by a browser on the same machine, or by a code on another."""

import base64
import hashlib
import secrets
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from tests.integration.api_server import Api
from tests.integration.auth.accounts import Account, signed_in
from tests.integration.auth.browser import Browser


@pytest.fixture(name="ada", scope="module")
def _ada(api: Api) -> Account:
    return signed_in(api)


def _challenge(verifier: str) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(verifier.encode()).digest()).decode().rstrip("=")


def _approve(browser: Browser, verifier: str, **expected: Any) -> str:
    requested = {"port": 40123, "state": "a" * 20, "code_challenge": _challenge(verifier), "client": "klein on anymal"}
    url = urlsplit(str(browser.post("/auth/cli/approve", {**requested, **expected}).ok()["url"]))
    query = parse_qs(url.query)
    assert (url.scheme, url.netloc, url.path, query["state"]) == ("http", "127.0.0.1:40123", "/", ["a" * 20])
    (code,) = query["code"]
    return code


def test_a_program_on_the_same_machine_gets_a_token_once(api: Api, ada: Account) -> None:
    verifier, nobody = secrets.token_urlsafe(48), api.as_(None)
    code = _approve(ada.browser, verifier)
    brought = {"code": code, "code_verifier": verifier}
    message = nobody.post("/auth/cli/token", brought).ok()
    assert message["person"] == {"id": ada.id, "name": ada.name}
    me = api.as_(message["token"]).get("/me").ok()
    assert me["credential"]["name"] == "klein on anymal"
    assert (me["credential"]["kind"], me["credential"]["expires_at"]) == ("personal", message["expires_at"])
    nobody.post("/auth/cli/token", brought).refused(410, "sign_in_expired")
    (event,) = api.events(me["credential"]["id"])
    assert (event["operation"], event["actor"]["id"]) == ("token.create", ada.id)


def test_a_code_is_useless_without_its_verifier(api: Api, ada: Account) -> None:
    verifier = secrets.token_urlsafe(48)
    code, nobody = _approve(ada.browser, verifier), api.as_(None)
    stolen = {"code": code, "code_verifier": secrets.token_urlsafe(48)}
    nobody.post("/auth/cli/token", stolen).refused(410, "sign_in_expired")
    nobody.post("/auth/cli/token", {"code": code, "code_verifier": verifier}).ok()


def test_a_code_expires_with_its_lifetime_or_session(api: Api) -> None:
    made, nobody = signed_in(api), api.as_(None)
    verifier = secrets.token_urlsafe(48)
    late = _approve(made.browser, verifier)
    api.sql("UPDATE login_request SET expires_at = now() WHERE approved_by_id = %s", made.id)
    nobody.post("/auth/cli/token", {"code": late, "code_verifier": verifier}).refused(410, "sign_in_expired")
    code = _approve(made.browser, verifier)
    made.browser.post("/auth/sign-out").ok(204)
    nobody.post("/auth/cli/token", {"code": code, "code_verifier": verifier}).refused(410, "sign_in_expired")


@pytest.mark.parametrize(
    "expected",
    [
        {"port": 0},
        {"port": 70000},
        {"state": "short"},
        {"state": "a&redirect=//evil.example"},
        {"code_challenge": "plain"},
        {"client": "a\nb"},
    ],
)
def test_redirects_to_other_than_loopback_are_refused(ada: Account, expected: dict[str, Any]) -> None:
    requested = {"port": 40123, "state": "a" * 20, "code_challenge": "A" * 43, "client": "klein"}
    ada.browser.post("/auth/cli/approve", {**requested, **expected}).refused(422, "invalid_request")


def test_approving_requires_a_browser_session(api: Api) -> None:
    requested = {"port": 40123, "state": "a" * 20, "code_challenge": "A" * 43}
    Browser(api).post("/auth/cli/approve", requested).refused(401, "not_authenticated")
    Browser(api).post("/auth/device/approve", {"user_code": "BCDF-GHJK"}).refused(401, "not_authenticated")


def _begin(api: Api) -> Any:
    return api.as_(None).post("/auth/device", {"client": "klein on spot"}).ok()


def _rest(api: Api) -> None:
    """Let the time between two questions pass."""
    api.sql("UPDATE login_request SET polled_at = polled_at - interval '1 minute'")


def test_a_device_gets_a_token_after_its_code_was_approved(api: Api, ada: Account) -> None:
    began, nobody = _begin(api), api.as_(None)
    requested = {"device_code": began["device_code"]}
    assert nobody.post("/auth/device/token", requested).refused(400, "sign_in_pending")["interval_s"] == 5
    nobody.post("/auth/device/token", requested).refused(429, "slow_down")
    typed = {"user_code": began["user_code"].lower().replace("-", " ")}
    checked = ada.browser.post("/auth/device/status", typed).ok()
    assert (checked["client"], checked["address"]) == ("klein on spot", "127.0.0.1")
    ada.browser.post("/auth/device/approve", typed).ok()
    ada.browser.post("/auth/device/approve", typed).refused(410, "code_gone")
    _rest(api)
    message = nobody.post("/auth/device/token", requested).ok()
    assert api.as_(message["token"]).get("/me").ok()["person"]["id"] == ada.id
    _rest(api)
    nobody.post("/auth/device/token", requested).refused(410, "sign_in_expired")


def test_a_refused_program_is_notified(api: Api, ada: Account) -> None:
    began = _begin(api)
    ada.browser.post("/auth/device/deny", {"user_code": began["user_code"]}).ok()
    requested = {"device_code": began["device_code"]}
    api.as_(None).post("/auth/device/token", requested).refused(403, "sign_in_denied")


def test_an_unapproved_code_expires(api: Api, ada: Account) -> None:
    began = _begin(api)
    api.sql("UPDATE login_request SET expires_at = now() WHERE user_code = %s", began["user_code"].replace("-", ""))
    requested = {"device_code": began["device_code"]}
    api.as_(None).post("/auth/device/token", requested).refused(410, "sign_in_expired")
    ada.browser.post("/auth/device/approve", {"user_code": began["user_code"]}).refused(410, "code_gone")


def test_signing_out_everywhere_revokes_tokens_not_yet_fetched(api: Api) -> None:
    made, began = signed_in(api), _begin(api)
    made.browser.post("/auth/device/approve", {"user_code": began["user_code"]}).ok()
    made.browser.call("DELETE", "/api/v1/me/sessions").ok(204)
    requested = {"device_code": began["device_code"]}
    api.as_(None).post("/auth/device/token", requested).refused(410, "sign_in_expired")


def test_unknown_codes_are_reported_as_expired(api: Api, ada: Account) -> None:
    api.as_(None).post("/auth/device/token", {"device_code": "x" * 43}).refused(410, "sign_in_expired")
    ada.browser.post("/auth/device/status", {"user_code": "BCDFGHJK"}).refused(410, "code_gone")


def test_finished_logins_are_deleted(api: Api, ada: Account) -> None:
    _begin(api)
    api.sql("UPDATE login_request SET expires_at = now() - interval '2 hours'")
    _begin(api)
    assert api.sql("SELECT count(*) FROM login_request WHERE expires_at < now()") == [(0,)]
