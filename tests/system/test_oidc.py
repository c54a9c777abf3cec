"""Signing in with a real OpenID provider, a real browser and `klein up`, and the failures between them."""

import base64
import hashlib
import json
import re
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlencode, urlsplit

import pytest
import urllib3

from tests.system.cluster import Cluster
from tests.system.oidc_sign_in import CLIENT_ID, CLIENT_SECRET, Chromium, RealProvider, _chromium, _driver, _node

__all__ = ["_chromium", "_driver", "_node"]
pytestmark = pytest.mark.slow
_CALLBACK = "/sign-in/callback/lab"


@dataclass(frozen=True)
class Place:
    """A Kleinkram that trusts a provider for lab.example, and the provider."""

    cluster: Cluster
    provider: RealProvider

    @property
    def url(self) -> str:
        """The server's address."""
        return f"http://127.0.0.1:{self.cluster.port}"

    def ask(self, method: str, path: str, body: object = None, token: str | None = None) -> Any:
        """Send an API request, by default as the owner."""
        owner = (self.cluster.data_dir / "owner-token").read_text().strip()
        headers = {"Authorization": f"Bearer {token or owner}", "Content-Type": "application/json"}
        data = None if body is None else json.dumps(body)
        answer = urllib3.request(method, f"{self.url}/api/v1{path}", body=data, headers=headers)
        assert answer.status < 300, answer.data
        return json.loads(answer.data) if answer.data else None

    def refusals(self) -> list[str]:
        """Return why the last callbacks from the provider were refused, latest first."""
        events = self.ask("GET", "/audit?operation=auth.refused&limit=50")["items"]
        return [str(event["after"]["reason"]) for event in events if _CALLBACK[:17] in event["resource_name"]]


@pytest.fixture(name="place", scope="module")
def _place(node: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    cluster = Cluster(tmp_path_factory.mktemp("oidc"))
    provider = RealProvider(node, f"http://127.0.0.1:{cluster.port}{_CALLBACK}")
    known = {"name": "lab", "title": "The Lab", "issuer": provider.url, "client_id": CLIENT_ID}
    settings = [{**known, "client_secret": CLIENT_SECRET, "trusted_domains": ["lab.example"], "timeout_s": 3}]
    cluster.settings["KLEINKRAM_OIDC_PROVIDERS"] = json.dumps(settings)
    cluster.settings["KLEINKRAM_SIGN_INS_PER_MINUTE"] = "0"
    provider.start()
    try:
        cluster.start()
        yield Place(cluster, provider)
    finally:
        cluster.end()
        provider.end()


def go_to_provider(place: Place, chromium: Chromium, name: str) -> None:
    """Sign in at the provider, up to its consent page."""
    chromium.goto(f"{place.url}/sign-in?{urlencode({'return_to': '/account'})}")
    chromium.click("[data-provider=lab]")
    chromium.fill("login", name)
    chromium.fill("password", "any")
    chromium.click("button[type=submit]")
    chromium.see("Authorize")


def sign_in(place: Place, chromium: Chromium, name: str) -> None:
    """Sign in through the provider."""
    go_to_provider(place, chromium, name)
    chromium.click("button[type=submit]")
    chromium.arrive("/account")
    chromium.see(f"Signed in as {name}")


def come_back(place: Place, chromium: Chromium, name: str) -> str:
    """Sign in at the provider, and return the callback address without opening it."""
    go_to_provider(place, chromium, name)
    chromium.intercept(f"*{_CALLBACK}*")
    chromium.click("button[type=submit]")
    return chromium.intercepted()


def test_somebody_signs_in_and_out(place: Place, chromium: Chromium) -> None:
    sign_in(place, chromium, "ada")
    (cookie,) = (cookie for cookie in chromium.do("cookies") if cookie["name"] == "kleinkram")
    assert (cookie["httpOnly"], cookie["sameSite"]) == (True, "Lax")
    chromium.click("[data-sign-out]")
    chromium.arrive("/sign-in")
    chromium.goto(f"{place.url}/account")
    chromium.arrive("/sign-in")
    assert chromium.do("complaints") == []


def test_signing_in_again_uses_the_same_account(place: Place, chromium: Chromium) -> None:
    sign_in(place, chromium, "grace")
    chromium.do("fresh")
    sign_in(place, chromium, "grace")
    chromium.see("Your only sign-in method; it cannot be removed.")
    events = place.ask("GET", "/audit?operation=person.create&limit=100")["items"]
    assert [event["resource_name"] for event in events].count("grace") == 1


def test_a_refused_consent_is_reported(place: Place, chromium: Chromium) -> None:
    go_to_provider(place, chromium, "no")
    chromium.click("text=Cancel")
    chromium.see("denied access")
    assert "denied access" in place.refusals()[0]


def test_a_wrong_state_signs_nobody_in(place: Place, chromium: Chromium) -> None:
    back = come_back(place, chromium, "ada")
    chromium.goto(re.sub("state=[^&]+", f"state={secrets.token_urlsafe(32)}", back))
    chromium.see("was not started in this browser")
    chromium.goto(f"{place.url}/account")
    chromium.arrive("/sign-in")


def test_a_callback_that_another_browser_began_signs_nobody_in(place: Place, chromium: Chromium) -> None:
    back = come_back(place, chromium, "mallory")
    chromium.do("fresh")
    chromium.goto(back)
    chromium.see("was not started in this browser")


def test_a_replayed_code_signs_nobody_in(place: Place, chromium: Chromium) -> None:
    first = come_back(place, chromium, "ada")
    chromium.goto(first)
    chromium.arrive("/account")
    chromium.goto(first)
    chromium.see("was finished before")
    # The same code with a state that is good: the provider itself must say that it was used.
    chromium.do("fresh")
    second = come_back(place, chromium, "ada")
    code = parse_qs(urlsplit(first).query)["code"][0]
    chromium.goto(re.sub("code=[^&]+", f"code={code}", second))
    chromium.see("did not accept its own code")


def test_rotated_keys_are_fetched_again(place: Place, chromium: Chromium) -> None:
    sign_in(place, chromium, "ada")
    place.provider.start()
    chromium.do("fresh")
    sign_in(place, chromium, "ada")


def test_an_expired_token_is_rejected(place: Place, chromium: Chromium) -> None:
    place.provider.start(late_s=2 * 3600)
    try:
        back = come_back(place, chromium, "ada")
        chromium.goto(back)
        chromium.see("could not confirm who you are")
        assert "expired_token" in chromium.text()
    finally:
        place.provider.start()


def test_a_provider_that_dies_during_sign_in_is_reported(place: Place, chromium: Chromium) -> None:
    back = come_back(place, chromium, "ada")
    place.provider.end()
    try:
        chromium.goto(back)
        chromium.see("The sign-in with The Lab failed")
        assert "cannot be reached" in place.refusals()[0]
        chromium.goto(f"{place.url}/account")
        chromium.arrive("/sign-in")
    finally:
        place.provider.start()
    chromium.do("fresh")
    sign_in(place, chromium, "ada")


def test_an_invited_person_links_the_provider_to_their_account(place: Place, chromium: Chromium) -> None:
    link = place.ask("POST", "/people/invitations", {"email": "someone@elsewhere.example", "name": "Some One"})["url"]
    chromium.goto(link)
    chromium.see("someone@elsewhere.example")
    chromium.fill("password", "correct horse battery")
    chromium.intercept(f"{place.url}/")
    chromium.click("form button")
    chromium.intercepted()
    chromium.goto(f"{place.url}/account")
    chromium.see("Signed in as Some One")
    chromium.click("[data-methods] [data-provider=lab]")
    chromium.fill("login", "linked")
    chromium.fill("password", "any")
    chromium.click("button[type=submit]")
    chromium.see("Authorize")
    chromium.click("button[type=submit]")
    chromium.arrive("/account")
    chromium.see("linked@")
    chromium.do("fresh")
    go_to_provider(place, chromium, "linked")
    chromium.click("button[type=submit]")
    chromium.see("Signed in as Some One")
    chromium.click("[data-methods] [aria-label='Unlink The Lab']")
    chromium.click("dialog[open] [type=submit]")
    chromium.see("The Lab unlinked.")
    chromium.do("fresh")
    go_to_provider(place, chromium, "linked")
    chromium.click("button[type=submit]")
    chromium.see("was unlinked here")


def test_the_owner_s_link_signs_in_once(place: Place, chromium: Chromium) -> None:
    link = place.ask("POST", "/auth/owner-link")["url"]
    chromium.intercept(f"{place.url}/")
    chromium.goto(link)
    chromium.intercepted()
    chromium.goto(f"{place.url}/account")
    chromium.see("Signed in as owner")
    chromium.do("fresh")
    chromium.goto(link)
    chromium.see("This link or code is not valid")


def test_a_program_on_this_machine_signs_in_after_approval(place: Place, chromium: Chromium) -> None:
    verifier = secrets.token_urlsafe(48)
    challenge = base64.urlsafe_b64encode(hashlib.sha256(verifier.encode()).digest()).decode().rstrip("=")
    query = {"port": 40123, "state": "a" * 20, "code_challenge": challenge, "client": "klein on <b>anymal</b>"}
    sign_in(place, chromium, "ada")
    chromium.goto(f"{place.url}/sign-in/cli?{urlencode(query)}")
    chromium.see("klein on <b>anymal</b>")
    chromium.intercept("http://127.0.0.1:40123/*")
    chromium.click("[data-act=approve]")
    brought = parse_qs(urlsplit(chromium.intercepted()).query)
    assert brought["state"] == ["a" * 20]
    runtime_info = place.ask("POST", "/auth/cli/token", {"code": brought["code"][0], "code_verifier": verifier})
    assert place.ask("GET", "/me", token=runtime_info["token"])["person"]["name"] == "ada"


def test_a_program_on_this_machine_gets_the_refusal(place: Place, chromium: Chromium) -> None:
    sign_in(place, chromium, "ada")
    query = {"port": 40123, "state": "a" * 20, "code_challenge": "A" * 43, "client": "klein"}
    chromium.goto(f"{place.url}/sign-in/cli?{urlencode(query)}")
    chromium.see("asks to sign in")
    chromium.intercept("http://127.0.0.1:40123/*")
    chromium.click("[data-act=deny]")
    assert parse_qs(urlsplit(chromium.intercepted()).query) == {"error": ["denied"], "state": ["a" * 20]}


def test_a_robot_signs_in_by_a_code_that_somebody_types(place: Place, chromium: Chromium) -> None:
    began = place.ask("POST", "/auth/device", {"client": "klein on spot"})
    chromium.goto(began["verification_url_complete"])
    chromium.arrive("/sign-in")
    chromium.click("[data-provider=lab]")
    chromium.fill("login", "ada")
    chromium.fill("password", "any")
    chromium.click("button[type=submit]")
    chromium.see("Authorize")
    chromium.click("button[type=submit]")
    chromium.arrive("/sign-in/device")
    chromium.click("form button")
    chromium.see("klein on spot")
    chromium.click("[data-act=approve]")
    chromium.see("You can close this page")
    runtime_info = place.ask("POST", "/auth/device/token", {"device_code": began["device_code"]})
    assert place.ask("GET", "/me", token=runtime_info["token"])["person"]["name"] == "ada"
