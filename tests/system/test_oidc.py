"""Signing in to `klein up` with a real OpenID provider and a real browser, and failures of that."""

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

from tests.acceptance.conftest import wait_until
from tests.system.backend import sql
from tests.system.cluster import Cluster
from tests.system.oidc_sign_in import CLIENT_ID, CLIENT_SECRET, Chromium, RealProvider, _chromium, _driver, _node

__all__ = ["_chromium", "_driver", "_node"]
pytestmark = pytest.mark.slow
_CALLBACK = "/sign-in/callback/lab"
# Makes all checks of accounts due, and starts the job.
_CHECK = """
WITH due AS (UPDATE identity SET checked_at = NULL)
INSERT INTO procrastinate_jobs (queue_name, task_name, args)
  VALUES ('default', 'check_provider_accounts', '{}') RETURNING id
"""


@dataclass(frozen=True)
class Deployment:
    """An instance that trusts a provider for lab.example, and that provider."""

    cluster: Cluster
    provider: RealProvider

    @property
    def url(self) -> str:
        """The server's address."""
        return f"http://127.0.0.1:{self.cluster.port}"

    def request(self, method: str, path: str, body: object = None, token: str | None = None) -> Any:
        """Send an API request, by default as the owner."""
        owner = (self.cluster.data_dir / "owner-token").read_text().strip()
        headers = {"Authorization": f"Bearer {token or owner}", "Content-Type": "application/json"}
        data = None if body is None else json.dumps(body)
        answer = urllib3.request(method, f"{self.url}/api/v1{path}", body=data, headers=headers)
        assert answer.status < 300, answer.data
        return json.loads(answer.data) if answer.data else None

    def refusals(self) -> list[str]:
        """Return why the last callbacks from the provider were refused, latest first."""
        events = self.request("GET", "/audit?operation=auth.refused&limit=50")["items"]
        return [str(event["after"]["reason"]) for event in events if _CALLBACK[:17] in event["resource_name"]]


@pytest.fixture(name="deployment", scope="module")
def _deployment(node: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployment]:
    cluster = Cluster(tmp_path_factory.mktemp("oidc"))
    provider = RealProvider(node, f"http://127.0.0.1:{cluster.port}{_CALLBACK}")
    known = {"name": "lab", "title": "The Lab", "issuer": provider.url, "client_id": CLIENT_ID}
    scopes = ["openid", "profile", "email", "offline_access"]
    settings = [
        {**known, "scopes": scopes, "client_secret": CLIENT_SECRET, "trusted_domains": ["lab.example"], "timeout_s": 3}
    ]
    cluster.settings["KLEINKRAM_OIDC_PROVIDERS"] = json.dumps(settings)
    cluster.settings["KLEINKRAM_SIGN_INS_PER_MINUTE"] = "0"
    provider.start()
    try:
        cluster.start()
        yield Deployment(cluster, provider)
    finally:
        cluster.end()
        provider.end()


def go_to_provider(deployment: Deployment, chromium: Chromium, name: str) -> None:
    """Sign in at the provider, and wait for its consent page."""
    chromium.goto(f"{deployment.url}/sign-in?{urlencode({'return_to': '/account'})}")
    chromium.click("[data-provider=lab]")
    chromium.fill("login", name)
    chromium.fill("password", "any")
    chromium.click("button[type=submit]")
    chromium.see("Authorize")


def sign_in(deployment: Deployment, chromium: Chromium, name: str) -> None:
    """Sign in through the provider."""
    go_to_provider(deployment, chromium, name)
    chromium.click("button[type=submit]")
    chromium.arrive("/account")
    chromium.see(f"Signed in as {name}")


def get_callback(deployment: Deployment, chromium: Chromium, name: str) -> str:
    """Sign in at the provider, and return the callback URL without opening it."""
    go_to_provider(deployment, chromium, name)
    chromium.intercept(f"*{_CALLBACK}*")
    chromium.click("button[type=submit]")
    return chromium.intercepted()


def test_signing_in_and_out_with_a_provider(deployment: Deployment, chromium: Chromium) -> None:
    sign_in(deployment, chromium, "ada")
    (cookie,) = (cookie for cookie in chromium.do("cookies") if cookie["name"] == "kleinkram")
    assert (cookie["httpOnly"], cookie["sameSite"]) == (True, "Lax")
    chromium.click("[data-sign-out]")
    chromium.arrive("/sign-in")
    chromium.goto(f"{deployment.url}/account")
    chromium.arrive("/sign-in")
    assert chromium.do("complaints") == []


def test_signing_in_again_uses_the_same_account(deployment: Deployment, chromium: Chromium) -> None:
    sign_in(deployment, chromium, "grace")
    chromium.do("fresh")
    sign_in(deployment, chromium, "grace")
    chromium.see("Your only sign-in method; it cannot be removed.")
    events = deployment.request("GET", "/audit?operation=person.create&limit=100")["items"]
    assert [event["resource_name"] for event in events].count("grace") == 1


def test_a_refused_consent_is_reported(deployment: Deployment, chromium: Chromium) -> None:
    go_to_provider(deployment, chromium, "no")
    chromium.click("text=Cancel")
    chromium.see("denied access")
    assert "denied access" in deployment.refusals()[0]


def test_a_wrong_state_is_refused(deployment: Deployment, chromium: Chromium) -> None:
    callback_url = get_callback(deployment, chromium, "ada")
    chromium.goto(re.sub("state=[^&]+", f"state={secrets.token_urlsafe(32)}", callback_url))
    chromium.see("was not started in this browser")
    chromium.goto(f"{deployment.url}/account")
    chromium.arrive("/sign-in")


def test_a_callback_of_another_browser_is_refused(deployment: Deployment, chromium: Chromium) -> None:
    callback_url = get_callback(deployment, chromium, "mallory")
    chromium.do("fresh")
    chromium.goto(callback_url)
    chromium.see("was not started in this browser")


def test_a_replayed_code_is_refused(deployment: Deployment, chromium: Chromium) -> None:
    first = get_callback(deployment, chromium, "ada")
    chromium.goto(first)
    chromium.arrive("/account")
    chromium.goto(first)
    chromium.see("was finished before")
    # The same code with a valid state: the provider must refuse it.
    chromium.do("fresh")
    second = get_callback(deployment, chromium, "ada")
    code = parse_qs(urlsplit(first).query)["code"][0]
    chromium.goto(re.sub("code=[^&]+", f"code={code}", second))
    chromium.see("did not accept its own code")


def is_signed_in(deployment: Deployment, chromium: Chromium) -> bool:
    """Whether the server knows the browser."""
    (cookie,) = (cookie for cookie in chromium.do("cookies") if cookie["name"] == "kleinkram")
    headers = {"Cookie": f"kleinkram={cookie['value']}"}
    return urllib3.request("GET", f"{deployment.url}/api/v1/me", headers=headers).status == 200


def test_signing_out_at_the_provider_signs_out_here(deployment: Deployment, chromium: Chromium) -> None:
    sign_in(deployment, chromium, "leaving")
    assert is_signed_in(deployment, chromium)
    chromium.goto(f"{deployment.provider.url}/session/end")
    chromium.click("button[name=logout]")
    chromium.see("Sign-out Success")
    wait_until(lambda: not is_signed_in(deployment, chromium), "the logout token to arrive")
    chromium.goto(f"{deployment.url}/account")
    chromium.arrive("/sign-in")


def test_access_ends_when_the_account_is_removed_at_the_provider(deployment: Deployment, chromium: Chromium) -> None:
    def check() -> None:
        ((job,),) = sql(deployment.cluster, _CHECK)
        state = "SELECT status::text FROM procrastinate_jobs WHERE id = %s"
        wait_until(lambda: sql(deployment.cluster, state, job) in ([], [("succeeded",)]), "the check")

    sign_in(deployment, chromium, "removed")
    check()
    assert is_signed_in(deployment, chromium)
    deployment.provider.remove("removed")
    check()
    assert not is_signed_in(deployment, chromium)


def test_rotated_keys_are_fetched_again(deployment: Deployment, chromium: Chromium) -> None:
    sign_in(deployment, chromium, "ada")
    deployment.provider.start()
    chromium.do("fresh")
    sign_in(deployment, chromium, "ada")


def test_an_expired_token_is_rejected(deployment: Deployment, chromium: Chromium) -> None:
    deployment.provider.start(late_s=2 * 3600)
    try:
        callback_url = get_callback(deployment, chromium, "ada")
        chromium.goto(callback_url)
        chromium.see("could not confirm who you are")
        assert "expired_token" in chromium.text()
    finally:
        deployment.provider.start()


def test_a_provider_that_dies_during_sign_in_is_reported(deployment: Deployment, chromium: Chromium) -> None:
    callback_url = get_callback(deployment, chromium, "ada")
    deployment.provider.end()
    try:
        chromium.goto(callback_url)
        chromium.see("The sign-in with The Lab failed")
        assert "cannot be reached" in deployment.refusals()[0]
        chromium.goto(f"{deployment.url}/account")
        chromium.arrive("/sign-in")
    finally:
        deployment.provider.start()
    chromium.do("fresh")
    sign_in(deployment, chromium, "ada")


def test_an_invited_person_links_the_provider_to_their_account(deployment: Deployment, chromium: Chromium) -> None:
    link = deployment.request(
        "POST", "/people/invitations", {"email": "someone@elsewhere.example", "name": "Some One"}
    )["url"]
    chromium.goto(link)
    chromium.see("someone@elsewhere.example")
    chromium.fill("password", "correct horse battery")
    chromium.intercept(f"{deployment.url}/")
    chromium.click("form button")
    chromium.intercepted()
    chromium.goto(f"{deployment.url}/account")
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
    go_to_provider(deployment, chromium, "linked")
    chromium.click("button[type=submit]")
    chromium.see("Signed in as Some One")
    chromium.click("[data-methods] [aria-label='Unlink The Lab']")
    chromium.click("dialog[open] [type=submit]")
    chromium.see("The Lab unlinked.")
    chromium.do("fresh")
    go_to_provider(deployment, chromium, "linked")
    chromium.click("button[type=submit]")
    chromium.see("was unlinked here")


def test_the_owner_s_link_signs_in_once(deployment: Deployment, chromium: Chromium) -> None:
    link = deployment.request("POST", "/auth/owner-link")["url"]
    chromium.intercept(f"{deployment.url}/")
    chromium.goto(link)
    chromium.intercepted()
    chromium.goto(f"{deployment.url}/account")
    chromium.see("Signed in as owner")
    chromium.do("fresh")
    chromium.goto(link)
    chromium.see("This link or code is not valid")


def test_a_program_on_this_machine_signs_in_after_approval(deployment: Deployment, chromium: Chromium) -> None:
    verifier = secrets.token_urlsafe(48)
    challenge = base64.urlsafe_b64encode(hashlib.sha256(verifier.encode()).digest()).decode().rstrip("=")
    query = {"port": 40123, "state": "a" * 20, "code_challenge": challenge, "client": "klein on <b>anymal</b>"}
    sign_in(deployment, chromium, "ada")
    chromium.goto(f"{deployment.url}/sign-in/cli?{urlencode(query)}")
    chromium.see("klein on <b>anymal</b>")
    chromium.intercept("http://127.0.0.1:40123/*")
    chromium.click("[data-act=approve]")
    callback = parse_qs(urlsplit(chromium.intercepted()).query)
    assert callback["state"] == ["a" * 20]
    token = deployment.request("POST", "/auth/cli/token", {"code": callback["code"][0], "code_verifier": verifier})
    assert deployment.request("GET", "/me", token=token["token"])["person"]["name"] == "ada"


def test_a_program_on_this_machine_is_notified_of_a_denial(deployment: Deployment, chromium: Chromium) -> None:
    sign_in(deployment, chromium, "ada")
    query = {"port": 40123, "state": "a" * 20, "code_challenge": "A" * 43, "client": "klein"}
    chromium.goto(f"{deployment.url}/sign-in/cli?{urlencode(query)}")
    chromium.see("asks to sign in")
    chromium.intercept("http://127.0.0.1:40123/*")
    chromium.click("[data-act=deny]")
    assert parse_qs(urlsplit(chromium.intercepted()).query) == {"error": ["denied"], "state": ["a" * 20]}


def test_a_robot_signs_in_by_a_device_code(deployment: Deployment, chromium: Chromium) -> None:
    login = deployment.request("POST", "/auth/device", {"client": "klein on spot"})
    chromium.goto(login["verification_url_complete"])
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
    token = deployment.request("POST", "/auth/device/token", {"device_code": login["device_code"]})
    assert deployment.request("GET", "/me", token=token["token"])["person"]["name"] == "ada"
