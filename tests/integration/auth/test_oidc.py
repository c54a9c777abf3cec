"""Sign-in with an OpenID provider: account mapping, claims that are not trusted, and failures."""

import re
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from joserfc.jwk import RSAKey

from kleinkram.contract.access import Right
from kleinkram.server.settings import OpenTo
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.auth.accounts import PASSWORD, account, any_email
from tests.integration.auth.browser import Browser
from tests.integration.auth.fake_provider import CLIENT_ID
from tests.integration.auth.provider_setup import Lab, _fake, _lab, _shared, known_as, provider_settings, sentence
from tests.integration.conftest import StartApi

__all__ = ["_fake", "_lab", "_shared"]
Change = Callable[[dict[str, Any]], dict[str, Any]]


def latest_refusal(api: Api) -> Any:
    """Return what the record says of the last way back from a provider that was refused."""
    events = api.get("/audit", {"operation": "auth.refused", "limit": "20"}).ok()["items"]
    return next(event["after"] for event in events if event["resource_name"] == "GET /sign-in/callback/{provider}")


def test_the_first_sign_in_creates_an_account_and_the_next_opens_it(lab: Lab) -> None:
    email = any_email()
    first = lab.sign_in("ada-1", **known_as(email)).me()
    assert (first["person"]["name"], first["emails"]) == ("Ada Lovelace", [email])
    assert first["credential"]["name"] == lab.provider.url
    renamed = lab.sign_in("ada-1", email="ada@elsewhere.example", name="Other").me()
    assert (renamed["person"], renamed["emails"]) == (first["person"], [email])
    operations = [event["operation"] for event in lab.api.all("/audit", {"person_id": first["person"]["id"]})]
    assert operations == ["session.create", "session.create"]


def test_a_verified_address_gives_the_rights_granted_to_it(lab: Lab) -> None:
    email, project = any_email(), lab.api.project()
    people.grant(lab.api, people.email_group(lab.api, email), Right.read, project_id=project["id"])
    browser = lab.sign_in("granted", **known_as(email))
    assert browser.get(f"/api/v1/projects/{project['id']}").ok()["name"] == project["name"]


def test_claims_missing_in_the_id_token_are_fetched_from_userinfo(lab: Lab) -> None:
    lab.provider.userinfo_claims = True
    email = any_email()
    assert lab.sign_in("shy", **known_as(email)).me()["emails"] == [email]


def test_a_browser_returns_only_to_pages_of_this_server(lab: Lab) -> None:
    lab.provider.sign_in_as("traveller", **known_as(any_email()))
    answer = lab.come_back(Browser(lab.api), return_to="/projects?a=1")
    assert answer.headers["location"] == "/projects?a=1"
    for elsewhere in ("https://evil.example", "//evil.example", "/\\evil.example", "javascript:alert(1)", "x"):
        begun = Browser(lab.api).post("/auth/providers/lab", {"return_to": elsewhere})
        begun.refused(422, "invalid_request")


# Whose account it is


def test_a_trusted_address_opens_the_existing_account(lab: Lab) -> None:
    made = account(lab.api)
    browser = lab.sign_in("linked", **known_as(made.email))
    assert browser.me()["person"]["id"] == made.id
    (own,) = browser.get("/api/v1/me/identities").ok()
    assert (own["issuer"], own["email"]) == (lab.provider.url, made.email)
    (event,) = (
        item for item in lab.api.all("/audit", {"resource_type": "identity"}) if item["resource_id"] == own["id"]
    )
    assert (event["operation"], event["after"]["person_id"]) == ("identity.link", made.id)


@pytest.mark.parametrize("verified", [False, None, "false", 0])
def test_an_unverified_address_opens_no_account(lab: Lab, verified: object) -> None:
    made = account(lab.api)
    message = lab.refuses(f"thief {made.id}", email=made.email, email_verified=verified)
    assert "does not get an account" in message
    assert "Link another sign-in method" in message
    nobodys = any_email()
    other = lab.refuses(f"nobody {made.id}", email=nobodys, email_verified=verified)
    assert other.replace(nobodys, made.email) == message, "it does not tell who has an account"
    assert lab.api.sql("SELECT count(*) FROM identity WHERE person_id = %s", made.id) == [(0,)]


def test_an_address_of_an_untrusted_domain_opens_no_account(lab: Lab) -> None:
    for domain in ("other.example", "sub.lab.example", "lab.example.evil.example"):
        made = account(lab.api, email=f"{any_email().partition('@')[0]}@{domain}")
        assert "does not get an account" in lab.refuses(f"thief of {domain}", **known_as(made.email))


def test_a_reassigned_address_does_not_open_the_account_of_its_former_owner(lab: Lab) -> None:
    email = any_email()
    former = lab.sign_in("left the lab", **known_as(email)).me()["person"]["id"]
    assert "belongs to another identity" in lab.refuses("came later", **known_as(email))
    assert lab.api.sql("SELECT count(*) FROM identity WHERE person_id = %s", former) == [(1,)]


def test_a_signed_in_person_links_a_provider(lab: Lab) -> None:
    made = account(lab.api)
    lab.provider.sign_in_as("mine", email="me@private.example", email_verified=True)
    message = made.browser.post("/auth/providers/lab/link", {"return_to": "/account"}).ok()
    answer = made.browser.get(lab.provider.authorize(message["url"]))
    assert (answer.status, answer.headers["location"]) == (303, "/account")
    assert lab.sign_in("mine").me()["person"]["id"] == made.id
    assert made.browser.me()["emails"] == [made.email]


def test_an_identity_of_another_person_is_not_linked(lab: Lab) -> None:
    lab.sign_in("taken", **known_as(any_email()))
    made = account(lab.api)
    lab.provider.sign_in_as("taken")
    message = made.browser.post("/auth/providers/lab/link", {}).ok()
    answer = made.browser.get(lab.provider.authorize(message["url"]))
    assert "another person" in sentence(answer)


def test_linking_fails_after_the_session_has_ended(lab: Lab) -> None:
    made = account(lab.api)
    lab.provider.sign_in_as("late")
    message = made.browser.post("/auth/providers/lab/link", {}).ok()
    made.browser.post("/auth/sign-out").ok(204)
    assert "you have signed out" in sentence(made.browser.get(lab.provider.authorize(message["url"])))
    assert lab.api.sql("SELECT count(*) FROM identity WHERE subject = 'late'") == [(0,)]


def test_no_account_is_created_without_a_trusted_address(lab: Lab) -> None:
    for claims in ({}, {"email": "a@other.example", "email_verified": True}, {"email": any_email()}):
        assert "does not get an account" in lab.refuses("outsider", **claims)
    assert lab.api.sql("SELECT count(*) FROM identity WHERE subject = 'outsider'") == [(0,)]


def test_only_invited_people_get_an_account_where_registration_is_closed(start_api: StartApi, lab: Lab) -> None:
    settings = provider_settings("lab", lab.provider.url, open_to=OpenTo.invited)
    invited = Lab(start_api(oidc_providers=[settings]), lab.provider)
    email = any_email()
    assert "require an invitation" in invited.refuses("guest", **known_as(email))
    invited.api.post("/people/invitations", {"email": email.upper()}).ok(201)
    assert invited.sign_in("guest", **known_as(email)).me()["emails"] == [email]
    assert "require an invitation" in invited.refuses("another", **known_as(any_email()))


def test_an_invitation_ends_when_its_creator_loses_the_right_to_invite(start_api: StartApi, lab: Lab) -> None:
    settings = provider_settings("lab", lab.provider.url, open_to=OpenTo.invited)
    invited = Lab(start_api(oidc_providers=[settings]), lab.provider)
    email, removed = any_email(), people.person(invited.api, admin=True)
    invited.api.as_(removed.token).post("/people/invitations", {"email": email}).ok(201)
    invited.api.post(f"/people/{removed.id}/deactivate").ok()
    assert "require an invitation" in invited.refuses("ghost", **known_as(email))


def test_open_registration_does_not_trust_addresses(start_api: StartApi, lab: Lab) -> None:
    settings = provider_settings("lab", lab.provider.url, open_to=OpenTo.anybody, trusted_domains=[])
    anybody = Lab(start_api(oidc_providers=[settings]), lab.provider)
    assert anybody.sign_in("whoever", **known_as(any_email())).me()["emails"] == []
    # An address of another account makes no difference: it is neither trusted nor revealed.
    made = account(anybody.api)
    me = anybody.sign_in("namesake", **known_as(made.email)).me()
    assert (me["person"]["id"] != made.id, me["emails"]) == (True, [])


def test_two_first_sign_ins_at_once_make_one_account(lab: Lab) -> None:
    lab.provider.sign_in_as("hasty", **known_as(any_email()))
    browsers = [Browser(lab.api) for _ in range(4)]
    backs = [lab.provider.authorize(item.post("/auth/providers/lab", {}).ok()["url"]) for item in browsers]
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(Browser.get, browsers, backs))
    assert [answer.status for answer in answers] == [303] * 4
    assert len({item.me()["person"]["id"] for item in browsers}) == 1


def test_a_removed_person_is_refused(lab: Lab) -> None:
    me = lab.sign_in("left", **known_as(any_email())).me()
    lab.api.sql("UPDATE person SET deactivated_at = now() WHERE id = %s", me["person"]["id"])
    assert "deactivated" in lab.refuses("left")


# What is not believed


def _without(name: str) -> Change:
    return lambda claims: {key: value for key, value in claims.items() if key != name}


def _with(**changed: Any) -> Change:
    return lambda claims: {**claims, **changed}


@pytest.mark.parametrize(
    "change",
    [
        _with(iss="https://evil.example"),
        _with(aud="another client"),
        _with(aud=[CLIENT_ID, "another"]),
        _with(azp="another"),
        _with(exp=int(time.time()) - 3600),
        _with(iat=int(time.time()) + 3600),
        _with(nonce="another"),
        _with(sub=None),
        _with(sub=7),
        _with(sub=""),
        _with(sub="a" * 256),
        _with(sub="ada\0"),
        _with(email="ada\0@lab.example"),
        *(_without(name) for name in ("iss", "aud", "exp", "iat", "nonce", "sub")),
    ],
)
def test_an_id_token_for_another_sign_in_is_refused(lab: Lab, change: Change) -> None:
    lab.provider.change = change
    assert "could not confirm who you are" in lab.refuses(**known_as(any_email()))


def test_an_id_token_signed_by_another_key_is_refused(lab: Lab) -> None:
    lab.sign_in("signed", **known_as(any_email()))
    published = lab.provider.keys
    kid = published[0].kid
    lab.provider.keys = [RSAKey.generate_key(2048, parameters={"kid": kid or ""})]
    real = lab.provider.answer

    def keys_stay(path: str, body: dict[str, str], headers: dict[str, str]) -> tuple[int, Any]:
        forged, lab.provider.keys = lab.provider.keys, published if path == "/jwks" else lab.provider.keys
        try:
            return real(path, body, headers)
        finally:
            lab.provider.keys = forged

    lab.provider.answer = keys_stay  # type: ignore[method-assign]  # a provider whose token endpoint lies
    assert "the signature of its ID token is not valid" in lab.refuses("signed", **known_as(any_email()))


def test_a_deeply_nested_response_of_a_provider_is_refused(lab: Lab) -> None:
    lab.sign_in("deep", **known_as(any_email()))
    real = lab.provider.answer

    def endless(path: str, body: dict[str, str], headers: dict[str, str]) -> tuple[int, Any]:
        return (200, b"[" * 100_000) if path == "/token" else real(path, body, headers)

    lab.provider.answer = endless  # type: ignore[method-assign]  # a provider whose token endpoint is broken
    assert "The sign-in with The Lab failed" in lab.refuses("deep")


def test_rotated_keys_of_a_provider_are_fetched(lab: Lab) -> None:
    lab.sign_in("rotating", **known_as(any_email()))
    lab.sign_in("rotating")
    assert lab.provider.seen.count("/jwks") == 1
    lab.provider.rotate()
    lab.sign_in("rotating")
    assert lab.provider.seen.count("/jwks") == 2
    assert lab.provider.seen.count("/.well-known/openid-configuration") == 1


def test_a_callback_works_once_and_only_in_the_same_browser(lab: Lab) -> None:
    lab.provider.sign_in_as("once", **known_as(any_email()))
    browser, other = Browser(lab.api), Browser(lab.api)
    back = lab.provider.authorize(browser.post("/auth/providers/lab", {}).ok()["url"])
    other.post("/auth/providers/lab", {}).ok()
    assert "not started in this browser" in sentence(other.get(back))
    assert not other.is_signed_in()
    assert browser.get(back).status == 303
    assert "not started in this browser" in sentence(browser.get(back))


def test_two_tabs_of_a_browser_can_sign_in_concurrently(lab: Lab) -> None:
    lab.provider.sign_in_as("tabs", **known_as(any_email()))
    browser = Browser(lab.api)
    backs = [lab.provider.authorize(browser.post("/auth/providers/lab", {}).ok()["url"]) for _ in range(2)]
    assert [browser.get(back).status for back in backs] == [303, 303]


def test_wrong_and_expired_states_are_refused(lab: Lab) -> None:
    lab.provider.sign_in_as("late", **known_as(any_email()))
    browser = Browser(lab.api)
    back = lab.provider.authorize(browser.post("/auth/providers/lab", {}).ok()["url"])
    assert "not started" in sentence(browser.get(re.sub("state=[^&]+", "state=wrong", back)))
    lab.api.sql("UPDATE oidc_login SET expires_at = now()")
    assert "has expired" in sentence(browser.get(back))
    assert lab.provider.seen.count("/token") == 0


def test_a_response_of_another_issuer_is_refused(lab: Lab) -> None:
    browser = Browser(lab.api)
    back = lab.provider.authorize(browser.post("/auth/providers/lab", {}).ok()["url"])
    assert "not from The Lab" in sentence(browser.get(re.sub("iss=[^&]+", "iss=https%3A%2F%2Fevil.example", back)))


# What its failures look like


@pytest.mark.parametrize(
    ("error", "message"), [("access_denied", "denied access"), ("<script>alert(1)</script>", "&lt;script&gt;")]
)
def test_refused_consent_is_explained_and_audited(lab: Lab, error: str, message: str) -> None:
    lab.provider.error = error
    assert message in lab.refuses()
    assert "The Lab" in latest_refusal(lab.api)["reason"]


@pytest.mark.parametrize("dies_at", ["/token", "/jwks", "/userinfo"])
def test_a_provider_that_fails_during_sign_in_is_explained_and_audited(lab: Lab, dies_at: str) -> None:
    lab.provider.is_dead.add(dies_at)
    lab.provider.userinfo_claims = True
    assert "The sign-in with The Lab failed" in lab.refuses(**known_as(any_email()))
    assert latest_refusal(lab.api) == {"provider": "The Lab", "reason": "it answered with status 503"}


def test_an_unusable_provider_is_reported_before_the_redirect(lab: Lab) -> None:
    lab.provider.is_dead.add("/.well-known/openid-configuration")
    Browser(lab.api).post("/auth/providers/lab", {}).refused(503, "provider_unavailable")
    lab.provider.is_dead.clear()
    lab.provider.issuer = "https://evil.example"
    Browser(lab.api).post("/auth/providers/lab", {}).refused(503, "provider_unavailable")
    Browser(lab.api).post("/auth/providers/nobody", {}).refused(404, "not_found")


def test_only_our_pages_start_a_provider_sign_in(lab: Lab) -> None:
    foreign = Browser(lab.api, origin="https://evil.example")
    foreign.post("/auth/providers/lab", {}).refused(401, "not_authenticated")
    assert foreign.cookies == {}


def test_the_page_offers_the_provider_beside_the_password(lab: Lab) -> None:
    page = str(Browser(lab.api).get("/sign-in").ok())
    assert "Sign in with The Lab" in page
    assert 'data-form="password"' in page
    ways = Browser(lab.api).get("/api/v1/auth/methods").ok()
    assert ways["providers"] == [{"name": "lab", "title": "The Lab"}]


def test_a_local_account_keeps_its_password_beside_the_provider(lab: Lab) -> None:
    made = account(lab.api)
    lab.sign_in("both", **known_as(made.email))
    browser = Browser(lab.api)
    browser.post("/auth/password", {"email": made.email, "password": PASSWORD}).ok()
    assert browser.me()["person"]["id"] == made.id
