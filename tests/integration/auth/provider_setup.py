"""A server with one OpenID provider, for tests of accounts and linked identities."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from kleinkram.server.settings import OidcProvider
from tests.integration.api_server import Answer, Api
from tests.integration.auth.browser import Browser
from tests.integration.auth.fake_provider import CLIENT_ID, CLIENT_SECRET, FakeProvider, running_provider
from tests.integration.conftest import StartApi


@dataclass(frozen=True)
class Lab:
    """A server with one provider, which the settings trust for lab.example and which opens accounts for that."""

    api: Api
    provider: FakeProvider

    def come_back(self, browser: Browser, *, return_to: str = "/") -> Answer:
        """Sign in as far as the provider sends the browser back, and return what the server says then."""
        message = browser.post("/auth/providers/lab", {"return_to": return_to}).ok()
        return browser.get(self.provider.authorize(message["url"]))

    def sign_in(self, subject: str, **claims: Any) -> Browser:
        """Sign in a new browser as a person; check that it succeeds."""
        self.provider.sign_in_as(subject, **claims)
        browser = Browser(self.api)
        answer = self.come_back(browser)
        assert (answer.status, answer.headers.get("location")) == (303, "/"), answer.body
        return browser

    def refuses(self, subject: str = "ada", **claims: Any) -> str:
        """Sign in as a person; check that it is refused, and return the sentence of the page."""
        self.provider.sign_in_as(subject, **claims)
        browser = Browser(self.api)
        answer = self.come_back(browser)
        assert answer.status in {403, 503}
        assert not browser.is_signed_in()
        return sentence(answer)


def sentence(answer: Answer) -> str:
    """Return what the page of a failure says."""
    actual = re.search(r'<p role="alert">(.*?)</p>', str(answer.body))
    assert actual is not None, answer.body
    return actual.group(1)


def provider_settings(name: str, url: str, **settings: Any) -> OidcProvider:
    """Return what a server's settings say of a provider."""
    known = {"client_id": CLIENT_ID, "client_secret": CLIENT_SECRET, "trusted_domains": ["lab.example"]}
    return OidcProvider.model_validate({"name": name, "title": "The Lab", "issuer": url, **known, **settings})


@pytest.fixture(name="provider", scope="module")
def _fake() -> Iterator[FakeProvider]:
    with running_provider() as provider:
        yield provider


@pytest.fixture(name="shared", scope="module")
def _shared(start_api: StartApi, provider: FakeProvider) -> Api:
    return start_api(oidc_providers=[provider_settings("lab", provider.url, timeout_s=1)])


@pytest.fixture(name="lab")
def _lab(shared: Api, provider: FakeProvider) -> Lab:
    provider.reset()
    # What the process keeps of a provider, it keeps for an hour: each test begins without.
    known = shared.app.state.providers.get("lab")
    known._discovery = known._keys = None
    return Lab(shared, provider)


def known_as(email: str, **more: Any) -> dict[str, Any]:
    """Return the claims of a person with a verified address."""
    return {"email": email, "email_verified": True, "name": "Ada Lovelace", **more}
