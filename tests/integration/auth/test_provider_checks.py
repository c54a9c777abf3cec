"""Access that depends on an account at a provider ends when the provider ends the account or the session."""

import asyncio
import hashlib
import json
import secrets
import time
import uuid
from base64 import urlsafe_b64encode
from collections.abc import Iterator
from typing import Any
from urllib.parse import parse_qs, urlencode, urlsplit

import pytest
import urllib3

from kleinkram.server.auth import oidc, provider_accounts
from kleinkram.server.auth.jobs import check_provider_accounts
from tests.integration.api_server import Answer, Api
from tests.integration.auth.accounts import any_email, sign_in
from tests.integration.auth.browser import Browser
from tests.integration.auth.fake_provider import CLIENT_ID, FakeProvider, running_provider
from tests.integration.auth.provider_setup import Lab, known_as, provider_settings
from tests.integration.conftest import StartApi
from tests.integration.jobs import in_worker
from tests.integration.people import token

_SCOPES = ("openid", "profile", "email", "offline_access")


@pytest.fixture(name="provider", scope="module")
def _provider() -> Iterator[FakeProvider]:
    with running_provider() as provider:
        yield provider


@pytest.fixture(name="shared", scope="module")
def _shared(start_api: StartApi, provider: FakeProvider) -> Api:
    return start_api(oidc_providers=[provider_settings("lab", provider.url, timeout_s=1, scopes=_SCOPES)])


@pytest.fixture(name="lab")
def _lab(shared: Api, provider: FakeProvider) -> Lab:
    provider.reset()
    known = shared.app.state.providers["lab"]
    known._discovery = known._keys = None
    # Accounts of earlier tests are not checked.
    shared.sql("UPDATE identity SET refresh_token = NULL")
    return Lab(shared, provider)


def check(lab: Lab, *, is_due: bool = True) -> None:
    """Run the job, with all checks due."""
    if is_due:
        lab.api.sql("UPDATE identity SET checked_at = now() - interval '25 hours'")
    in_worker(lab.api, lambda resources: check_provider_accounts(resources.context))


def logged_in(lab: Lab, browser: Browser) -> str:
    """Do what `klein login` does with a browser; return the token."""
    verifier = secrets.token_urlsafe(48)
    challenge = urlsafe_b64encode(hashlib.sha256(verifier.encode()).digest()).decode().rstrip("=")
    request = {"port": 40123, "state": "a" * 20, "code_challenge": challenge, "client": "klein"}
    url = browser.post("/auth/cli/approve", request).ok()["url"]
    code = parse_qs(urlsplit(url).query)["code"][0]
    answer = lab.api.as_(None).post("/auth/cli/token", {"code": code, "code_verifier": verifier})
    return str(answer.ok()["token"])


def is_valid(lab: Lab, secret: str) -> bool:
    """Whether a token is accepted."""
    return lab.api.as_(secret).get("/me").status == 200


def log_out(lab: Lab, logout_token: str, *, provider: str = "lab") -> Answer:
    """Send a logout token as the provider does."""
    answer = urllib3.request(
        "POST",
        f"{lab.api.url}/sign-in/backchannel-logout/{provider}",
        body=urlencode({"logout_token": logout_token}),
        headers={"Content-Type": "application/x-www-form-urlencoded"},
    )
    body = answer.json() if answer.data else None
    return Answer(answer.status, {name.lower(): value for name, value in answer.headers.items()}, body)


# Checks by refresh tokens


def test_a_removed_account_loses_sessions_and_tokens_of_klein_login(lab: Lab) -> None:
    browser = lab.sign_in("leaver", **known_as(any_email()))
    me, secret = browser.me()["person"], logged_in(lab, browser)
    robot = token(lab.api, me["id"])
    check(lab)
    assert (browser.is_signed_in(), is_valid(lab, secret)) == (True, True)
    lab.provider.remove("leaver")
    check(lab)
    assert (browser.is_signed_in(), is_valid(lab, secret)) == (False, False)
    assert is_valid(lab, robot.secret), "an admin decides about tokens that do not depend on the account"
    (event,) = (
        event
        for event in lab.api.all("/audit", {"operation": "identity.end_access"})
        if event["after"]["person_id"] == me["id"]
    )
    assert (event["after"]["sessions"], event["after"]["tokens"], event["actor"]) == (1, 1, None)


def test_each_check_stores_the_new_refresh_token(lab: Lab) -> None:
    browser = lab.sign_in("rotating", **known_as(any_email()))
    for _ in range(3):
        check(lab)
    assert browser.is_signed_in()
    stored = lab.api.sql("SELECT refresh_token FROM identity WHERE subject = 'rotating'")
    assert stored == [(next(iter(lab.provider.refresh_tokens)),)]


def test_accounts_are_checked_once_an_interval(lab: Lab) -> None:
    lab.sign_in("patient", **known_as(any_email()))
    lab.provider.seen.clear()
    check(lab, is_due=False)
    assert "/token" not in lab.provider.seen
    check(lab)
    check(lab, is_due=False)
    assert lab.provider.seen.count("/token") == 1


@pytest.mark.parametrize("error", ["invalid_client", "unauthorized_client", "server_error"])
def test_an_error_that_is_not_about_the_account_ends_nothing(lab: Lab, error: str) -> None:
    browser = lab.sign_in(f"safe from {error}", **known_as(any_email()))
    lab.provider.remove(f"safe from {error}")
    lab.provider.refresh_error = error
    check(lab)
    assert browser.is_signed_in()


def test_an_account_about_which_the_provider_says_nothing_does_not_delay_others(lab: Lab) -> None:
    unclear = lab.sign_in("unclear", **known_as(any_email()))
    browser = lab.sign_in("behind it", **known_as(any_email()))
    lab.provider.remove("unclear")
    lab.provider.remove("behind it")
    lab.api.sql("UPDATE identity SET checked_at = now() - interval '25 hours' WHERE subject = 'behind it'")
    lab.api.sql("UPDATE identity SET checked_at = NULL WHERE subject = 'unclear'")
    lab.provider.refresh_errors = ["interaction_required"]
    check(lab, is_due=False)
    assert (unclear.is_signed_in(), browser.is_signed_in()) == (True, False)
    lab.provider.seen.clear()
    check(lab, is_due=False)
    assert "/token" not in lab.provider.seen, "it is asked again with its next check"


def test_an_id_token_for_another_client_confirms_nothing(lab: Lab) -> None:
    lab.sign_in("mixed up", **known_as(any_email()))
    now = int(time.time())
    claims = {"iss": lab.provider.url, "sub": "mixed up", "iat": now, "exp": now + 60}
    for audience, is_confirmed in ((["other", CLIENT_ID], True), ("other", False)):
        lab.api.sql("UPDATE identity SET confirmed_at = now() - interval '2 days' WHERE subject = 'mixed up'")
        lab.provider.refreshed_id_token = lab.provider.sign({**claims, "aud": audience})
        check(lab)
        assert lab.api.sql(
            "SELECT confirmed_at > now() - interval '1 day' FROM identity WHERE subject = 'mixed up'"
        ) == [(is_confirmed,)]


def test_tokens_that_were_created_with_a_token_of_klein_login_end_with_it(lab: Lab) -> None:
    secret = logged_in(lab, lab.sign_in("crafty", **known_as(any_email())))
    theirs = lab.api.as_(secret)
    second = theirs.post("/tokens", {"name": "second", "scopes": ["admin"]}).ok(201)["secret"]
    third = lab.api.as_(second).post("/tokens", {"name": "third"}).ok(201)["secret"]
    robot = theirs.post("/tokens", {"name": "robot", "kind": "robot", "project_ids": [theirs.project()["id"]]}).ok(201)[
        "secret"
    ]
    lab.provider.remove("crafty")
    check(lab)
    assert [is_valid(lab, token) for token in (secret, second, third, robot)] == [False, False, False, True]


def test_a_sign_in_without_a_refresh_token_keeps_the_earlier_one(lab: Lab) -> None:
    email = any_email()
    lab.sign_in("first only", **known_as(email))
    lab.provider.grants_refresh_tokens = False
    browser = lab.sign_in("first only", **known_as(email))
    lab.provider.remove("first only")
    check(lab)
    assert not browser.is_signed_in()


def test_a_dead_provider_ends_nothing(lab: Lab) -> None:
    browser = lab.sign_in("waiting", **known_as(any_email()))
    lab.provider.is_dead.add("/token")
    check(lab)
    assert browser.is_signed_in()
    lab.provider.is_dead.clear()
    check(lab)
    assert browser.is_signed_in()


def test_a_session_by_another_method_stays(lab: Lab) -> None:
    browser = lab.sign_in("two methods", **known_as(any_email()))
    other, person_id = Browser(lab.api), browser.me()["person"]["id"]
    email = browser.me()["emails"][0]
    reset = lab.api.post(f"/people/{person_id}/reset").ok(201)["url"].partition("#")[2]
    other.post("/auth/reset", {"code": reset, "password": "correct horse battery"}).ok()
    again = lab.sign_in("two methods", **known_as(email))
    lab.provider.remove("two methods")
    check(lab)
    assert (again.is_signed_in(), other.is_signed_in()) == (False, True)
    sign_in(Browser(lab.api), email)


def test_refresh_tokens_are_forgotten_when_nothing_depends_on_them(lab: Lab) -> None:
    browser = lab.sign_in("gone home", **known_as(any_email()))
    browser.post("/auth/sign-out").ok(204)
    check(lab)
    assert lab.api.sql("SELECT refresh_token FROM identity WHERE subject = 'gone home'") == [(None,)]


def test_without_offline_access_no_refresh_token_is_stored(start_api: StartApi, provider: FakeProvider) -> None:
    provider.reset()
    api = start_api(oidc_providers=[provider_settings("lab", provider.url)])
    lab = Lab(api, provider)
    lab.sign_in("plain", **known_as(any_email()))
    assert api.sql("SELECT refresh_token FROM identity") == [(None,)]
    api.sql("UPDATE identity SET refresh_token = 'from when the scope was requested'")
    lab.provider.seen.clear()
    check(lab)
    assert lab.provider.seen == []
    assert api.sql("SELECT refresh_token FROM identity") == [(None,)]


def test_refresh_tokens_that_need_no_secret_of_the_client_are_not_stored() -> None:
    assert provider_settings("lab", "https://id.example", scopes=_SCOPES).is_refreshable
    assert not provider_settings("lab", "https://id.example", scopes=_SCOPES, client_secret=None).is_refreshable
    assert not provider_settings("lab", "https://id.example", scopes=_SCOPES, client_auth="none").is_refreshable


def test_an_identity_is_not_linked_to_somebody_who_is_erased_meanwhile(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    browser = lab.sign_in("erased", **known_as(any_email()))
    me = browser.me()["person"]
    url = browser.post("/auth/providers/lab/link", {"return_to": "/account"}).ok()["url"]
    lab.provider.sign_in_as("late", **known_as(any_email()))

    link = provider_accounts.link_identity

    async def erase_and_link(*arguments: Any, **options: Any) -> None:
        body = {"confirmation": me["name"]}
        (await asyncio.to_thread(lab.api.post, f"/people/{me['id']}/erase", body)).ok()
        await link(*arguments, **options)

    monkeypatch.setattr(provider_accounts, "link_identity", erase_and_link)
    assert browser.get(lab.provider.authorize(url)).status == 401
    assert lab.api.sql("SELECT * FROM identity WHERE person_id = %s OR subject = 'late'", me["id"]) == []


# The maximum age of a confirmation


def test_without_a_confirmation_sessions_and_logins_are_suspended_until_the_next_sign_in(lab: Lab) -> None:
    email = any_email()
    browser = lab.sign_in("seldom", **known_as(email))
    secret = logged_in(lab, browser)
    lab.api.sql("UPDATE identity SET confirmed_at = now() - interval '29 days' WHERE subject = 'seldom'")
    assert (browser.is_signed_in(), is_valid(lab, secret)) == (True, True)
    (shown,) = browser.get("/api/v1/me/sessions").ok()["items"]
    ((left,),) = lab.api.sql("SELECT %s::timestamptz - now() < interval '25 hours'", shown["expires_at"])
    assert left
    lab.api.sql("UPDATE identity SET confirmed_at = now() - interval '31 days' WHERE subject = 'seldom'")
    assert (browser.is_signed_in(), is_valid(lab, secret)) == (False, False)
    lab.sign_in("seldom", **known_as(email))
    assert (browser.is_signed_in(), is_valid(lab, secret)) == (True, True)


def test_the_maximum_age_can_be_turned_off(start_api: StartApi, provider: FakeProvider) -> None:
    provider.reset()
    api = start_api(oidc_providers=[provider_settings("lab", provider.url)], provider_session_days=0)
    browser = Lab(api, provider).sign_in("free", **known_as(any_email()))
    api.sql("UPDATE identity SET confirmed_at = now() - interval '3000 days'")
    assert browser.is_signed_in()


# Back-channel logout


def test_a_logout_with_a_session_id_ends_that_session_only(lab: Lab) -> None:
    email, browsers = any_email(), {}
    for session_id in ("one", "two"):
        lab.provider.session_id = session_id
        browsers[session_id] = lab.sign_in("twice", **known_as(email))
    other = lab.sign_in("somebody else", **known_as(any_email()))
    answer = log_out(lab, lab.provider.logout_token(sub="twice", sid="one"))
    assert (answer.status, answer.headers["cache-control"], answer.body) == (200, "no-store", None)
    assert [browser.is_signed_in() for browser in (*browsers.values(), other)] == [False, True, True]
    assert log_out(lab, lab.provider.logout_token(sid="two")).status == 200
    assert not browsers["two"].is_signed_in()


def test_a_logout_with_a_subject_ends_all_sessions_but_no_tokens(lab: Lab) -> None:
    email = any_email()
    browsers = [lab.sign_in("everywhere", **known_as(email)) for _ in range(2)]
    secret = logged_in(lab, browsers[0])
    person_id = browsers[0].me()["person"]["id"]
    assert log_out(lab, lab.provider.logout_token(sub="everywhere")).status == 200
    assert [browser.is_signed_in() for browser in browsers] == [False, False]
    assert is_valid(lab, secret)
    ended = lab.api.sql(
        "SELECT after ->> 'reason' FROM audit_event JOIN session ON session.id = resource_id"
        " WHERE operation = 'session.revoke' AND person_id = %s",
        person_id,
    )
    assert ended == [("logout at The Lab",)] * 2


def test_after_a_logout_the_account_is_checked_soon(lab: Lab) -> None:
    secret = logged_in(lab, lab.sign_in("fired", **known_as(any_email())))
    lab.provider.remove("fired")
    assert log_out(lab, lab.provider.logout_token(sub="fired")).status == 200
    check(lab, is_due=False)
    assert not is_valid(lab, secret)


_EVENT: dict[str, Any] = {"http://schemas.openid.net/event/backchannel-logout": {}}
_BAD_CLAIMS: dict[str, dict[str, Any]] = {
    "another issuer": {"iss": "https://evil.example"},
    "another client": {"aud": "other"},
    "only other clients": {"aud": ["other", "another"]},
    "no time": {"iat": None},
    "too old": {"iat": int(time.time()) - 3600},
    "from the future": {"iat": int(time.time()) + 3600},
    "expired": {"exp": int(time.time()) - 600},
    "no id": {"jti": None},
    "an empty id": {"jti": ""},
    "no event": {"events": None},
    "another event": {"events": {"http://schemas.openid.net/event/other": {}}},
    "an event that is no object": {"events": {next(iter(_EVENT)): "yes"}},
    "a nonce": {"nonce": "n"},
    "nobody": {"sub": None},
    "a control character": {"sub": "ada\u0000"},
}


@pytest.mark.parametrize("claims", _BAD_CLAIMS.values(), ids=_BAD_CLAIMS)
def test_an_invalid_logout_token_ends_nothing(lab: Lab, claims: dict[str, Any]) -> None:
    browser = lab.sign_in("steady", **known_as(any_email()))
    answer = log_out(lab, lab.provider.logout_token(**{"sub": "steady", **claims}))
    assert (answer.status, answer.body["error"]) == (400, "invalid_request")
    assert answer.body["error_description"]
    assert browser.is_signed_in()
    (latest,) = lab.api.get("/audit", {"operation": "auth.refused", "limit": "1"}).ok()["items"]
    assert "backchannel-logout" in latest["resource_name"]


def test_a_token_that_is_not_signed_by_the_provider_ends_nothing(lab: Lab) -> None:
    browser = lab.sign_in("signed", **known_as(any_email()))
    good = lab.provider.logout_token(sub="signed")
    header, body, signature = good.split(".")
    no_algorithm = urlsafe_b64encode(b'{"alg":"none"}').decode().rstrip("=")
    unsigned = f"{no_algorithm}.{body}."
    old_key = lab.provider.keys
    lab.provider.rotate()
    foreign = lab.provider.logout_token(sub="signed")
    lab.provider.keys = old_key
    flipped = f"{header}.{body}.{signature[:-8]}AAAAAAAA"
    for bad in ("", "x", "a.b.c", unsigned, foreign, flipped):
        answer = log_out(lab, bad)
        assert (answer.status, answer.body["error"]) == (400, "invalid_request"), bad
    assert browser.is_signed_in()
    assert log_out(lab, good, provider="other").status == 404


def test_an_id_token_is_no_logout_token(lab: Lab) -> None:
    browser = lab.sign_in("confused", **known_as(any_email()))
    now = int(time.time())
    claims = {"iss": lab.provider.url, "aud": CLIENT_ID, "sub": "confused", "iat": now, "exp": now + 60}
    assert log_out(lab, lab.provider.sign({**claims, "nonce": "n"})).status == 400
    events = {"jti": uuid.uuid4().hex, "events": _EVENT}
    assert log_out(lab, lab.provider.sign({**claims, **events}, typ="at+jwt")).status == 400
    assert browser.is_signed_in()


@pytest.mark.parametrize("critical", [None, 1, "nonce", ["nonce"]])
def test_an_unexpected_header_is_refused(lab: Lab, critical: object) -> None:
    header = urlsafe_b64encode(json.dumps({"alg": "RS256", "crit": critical}).encode()).decode().rstrip("=")
    good = lab.provider.logout_token(sub="anybody")
    assert log_out(lab, f"{header}.{good.partition('.')[2]}").status == 400


def test_logout_tokens_of_unknown_keys_do_not_make_the_server_fetch_keys_all_the_time(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    browser = lab.sign_in("rotated", **known_as(any_email()))
    lab.provider.seen.clear()
    lab.provider.rotate()
    for _ in range(3):
        assert log_out(lab, lab.provider.logout_token(sub="rotated")).status == 400
    assert lab.provider.seen == []
    monkeypatch.setattr(oidc, "_LOGOUT_REFETCH_S", 0.0)
    assert log_out(lab, lab.provider.logout_token(sub="rotated")).status == 200
    assert not browser.is_signed_in()


def test_a_logout_token_works_once(lab: Lab) -> None:
    email = any_email()
    lab.sign_in("replayed", **known_as(email))
    message = lab.provider.logout_token(sub="replayed")
    assert log_out(lab, message).status == 200
    again = lab.sign_in("replayed", **known_as(email))
    answer = log_out(lab, message)
    assert (answer.status, "used before" in answer.body["error_description"]) == (400, True)
    assert again.is_signed_in()


def test_a_logout_of_an_unknown_person_is_accepted(lab: Lab) -> None:
    assert log_out(lab, lab.provider.logout_token(sub="unknown here")).status == 200
