"""The own account: its data, and unlinking a provider without locking people out."""

import json
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from typer.testing import CliRunner

from kleinkram import connect
from kleinkram.cli.main import app
from kleinkram.contract.access import Scope
from kleinkram.contract.errors import LastSignInMethod, NotFound
from kleinkram.server.access.builtin_groups import OWNER_ID
from kleinkram.server.settings import Affiliation
from tests.integration import people
from tests.integration.auth.accounts import PASSWORD, account, any_email, sign_in, signed_in
from tests.integration.auth.browser import Browser
from tests.integration.auth.provider_setup import Lab, _fake, _lab, _shared, known_as, provider_settings, sentence
from tests.integration.conftest import StartApi

__all__ = ["_fake", "_lab", "_shared"]


def _link(lab: Lab, browser: Browser, subject: str, **claims: Any) -> Any:
    """Link an account at the provider to the account of a browser; return the identity."""
    lab.provider.sign_in_as(subject, **claims)
    begun = browser.post("/auth/providers/lab/link", {"return_to": "/account"}).ok()
    answer = browser.get(lab.provider.authorize(begun["url"]))
    assert (answer.status, answer.headers["location"]) == (303, "/account")
    return _identities(browser)[-1]


def _identities(browser: Browser) -> list[Any]:
    listed: list[Any] = browser.get("/api/v1/me/identities").ok()
    return listed


def _unlink(browser: Browser, identity: Any) -> Any:
    return browser.call("DELETE", f"/api/v1/me/identities/{identity['id']}")


def test_an_account_returns_addresses_affiliations_and_sign_in_methods(start_api: StartApi) -> None:
    eth = Affiliation(name="ETH", domains=("lab.example",))
    api = start_api(affiliations=[eth])
    made = account(api)
    reported = made.browser.get("/api/v1/me/account").ok()
    assert reported["person"] == {"id": made.id, "name": "Ada"}
    (address,) = reported["addresses"]
    assert (address["email"], address["verified_by"]) == (made.email, "invitation")
    assert (reported["affiliations"], reported["has_password"]) == (["ETH"], True)
    without = signed_in(api)
    assert without.browser.get("/api/v1/me/account").ok()["has_password"] is False
    robot = people.token(api, made.id, [Scope.read])
    api.as_(robot.secret).get("/me/account").refused(403, "scope_missing")


def test_unlinking_a_provider_ends_nothing_else(lab: Lab) -> None:
    made = account(lab.api)
    linked = _link(lab, made.browser, f"ada {made.id}", email=made.email, email_verified=True)
    assert (linked["provider"], linked["is_last"]) == ("The Lab", False)
    token = people.token(lab.api, made.id)
    by_provider = lab.sign_in(f"ada {made.id}", **known_as(made.email))
    assert by_provider.me()["person"]["id"] == made.id
    _unlink(made.browser, linked).ok(204)
    assert _identities(made.browser) == []
    assert by_provider.is_signed_in(), "sessions stay"
    assert lab.api.as_(token.secret).get("/me").ok()["emails"] == [made.email]
    (event,) = [item for item in lab.api.events(linked["id"]) if item["operation"] == "identity.unlink"]
    assert (event["resource_name"], event["before"]["email"]) == ("The Lab", made.email)
    sign_in(Browser(lab.api), made.email)
    _unlink(made.browser, linked).refused(404, "not_found")


def test_an_unlinked_identity_is_linked_again_only_by_the_signed_in_person(lab: Lab) -> None:
    made = account(lab.api)
    subject = f"back {made.id}"
    linked = _link(lab, made.browser, subject, **known_as(made.email))
    _unlink(made.browser, linked).ok(204)
    assert "was unlinked here" in lab.refuses(subject, **known_as(made.email))
    assert "belongs to another identity" in lab.refuses(f"other {subject}", **known_as(made.email))
    assert _identities(made.browser) == []
    again = _link(lab, made.browser, subject, **known_as(made.email))
    assert again["id"] == linked["id"]
    assert lab.sign_in(subject, **known_as(made.email)).me()["person"]["id"] == made.id
    # Another person who proves to own the identity may link it after it was unlinked.
    _unlink(made.browser, again).ok(204)
    other = account(lab.api)
    _link(lab, other.browser, subject, email=any_email())
    assert lab.sign_in(subject).me()["person"]["id"] == other.id


def test_the_last_sign_in_method_cannot_be_unlinked(lab: Lab) -> None:
    browser = lab.sign_in("only", **known_as(any_email()))
    (only,) = _identities(browser)
    assert only["is_last"] is True
    assert "last way to sign in" in _unlink(browser, only).refused(409, "last_sign_in_method")["detail"]
    second = _link(lab, browser, "only's second")
    assert [item["is_last"] for item in _identities(browser)] == [False, False]
    _unlink(browser, only).ok(204)
    _unlink(browser, second).refused(409, "last_sign_in_method")
    assert lab.sign_in("only's second").me()["person"]["id"] == browser.me()["person"]["id"]


def test_one_of_two_sign_in_methods_removed_at_the_same_time_remains(lab: Lab) -> None:
    browser = lab.sign_in("hasty twin", **known_as(any_email()))
    _link(lab, browser, "hasty twin's other")
    with ThreadPoolExecutor(2) as pool:
        answers = [*pool.map(lambda item: _unlink(browser.other_tab(), item).status, _identities(browser))]
    assert sorted(answers) == [204, 409]
    assert len(_identities(browser)) == 1


def test_a_password_without_local_accounts_is_no_sign_in_method(start_api: StartApi, lab: Lab) -> None:
    settings = provider_settings("lab", lab.provider.url)
    here = Lab(start_api(oidc_providers=[settings], local_accounts=False), lab.provider)
    email = any_email()
    browser = here.sign_in("switched", **known_as(email))
    person_id = browser.me()["person"]["id"]
    here.api.sql("INSERT INTO password (person_id, hash) VALUES (%s, '$argon2id$x') RETURNING person_id", person_id)
    _unlink(browser, _identities(browser)[0]).refused(409, "last_sign_in_method")
    assert browser.get("/api/v1/me/account").ok()["has_password"] is False


def test_a_removed_provider_is_no_sign_in_method(lab: Lab) -> None:
    browser = lab.sign_in("remains", **known_as(any_email()))
    lab.api.sql(
        "INSERT INTO identity (id, person_id, issuer, subject)"
        " VALUES (gen_random_uuid(), %s, 'https://gone.example', 'x') RETURNING id",
        browser.me()["person"]["id"],
    )
    known, gone = _identities(browser)
    assert (gone["provider"], gone["is_last"], known["is_last"]) == (None, False, True)
    _unlink(browser, known).refused(409, "last_sign_in_method")
    _unlink(browser, gone).ok(204)


def test_the_owner_link_is_a_sign_in_method(lab: Lab) -> None:
    owner = lab.api.get("/me").ok()["person"]["id"]
    assert owner == str(OWNER_ID)
    link = lab.api.post("/auth/owner-link").ok()["url"]
    browser = Browser(lab.api)
    browser.post("/auth/link", {"code": link.partition("#")[2]}).ok()
    _unlink(browser, _link(lab, browser, "the owner")).ok(204)


def test_identities_of_others_cannot_be_unlinked(lab: Lab) -> None:
    browser = lab.sign_in("theirs", **known_as(any_email()))
    other = account(lab.api, name="Bob")
    _link(lab, other.browser, f"bob {other.id}")
    _unlink(other.browser, _identities(browser)[0]).refused(404, "not_found")
    lab.sign_in("theirs")
    # Nor is it linked to them while it is.
    lab.provider.sign_in_as("theirs")
    begun = other.browser.post("/auth/providers/lab/link", {}).ok()
    assert "another person" in sentence(other.browser.get(lab.provider.authorize(begun["url"])))


def test_sdk_and_cli_unlink_identities(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    made = account(lab.api)
    linked = _link(lab, made.browser, f"terminal {made.id}", email="x@lab.example")
    token = people.token(lab.api, made.id).secret
    monkeypatch.setenv("KLEINKRAM_URL", lab.api.url)
    monkeypatch.setenv("KLEINKRAM_TOKEN", token)

    def klein(*arguments: str) -> str:
        ran = CliRunner().invoke(app, ["account", *arguments])
        if ran.exception is not None:
            raise ran.exception
        return ran.stdout

    shown = klein("info")
    assert made.email in shown
    assert "The Lab" in shown
    assert json.loads(klein("info", "--json"))["identities"][0]["id"] == linked["id"]
    assert json.loads(klein("unlink", "the lab", "--yes", "--json")) == {"unlinked": linked["id"]}
    with pytest.raises(NotFound):
        klein("unlink", "the lab", "--yes")
    lab.api.sql("DELETE FROM password WHERE person_id = %s RETURNING person_id", made.id)
    again = _link(lab, made.browser, f"terminal {made.id}")
    with connect(lab.api.url, token) as client:
        assert client.me.account().has_password is False
        assert [item.is_last for item in client.me.identities()] == [True]
        with pytest.raises(LastSignInMethod):
            client.me.unlink_identity(again["id"])


def test_a_changed_password_is_a_sign_in_method(lab: Lab) -> None:
    made = account(lab.api)
    linked = _link(lab, made.browser, f"changed {made.id}")
    new = "staple battery horse"
    made.browser.post("/auth/password/change", {"old_password": PASSWORD, "new_password": new}).ok(204)
    _unlink(made.browser, linked).ok(204)
    sign_in(Browser(lab.api), made.email, new)
