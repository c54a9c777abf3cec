"""Invite people and accept invitations, for tests of signing in."""

import uuid
from dataclasses import dataclass

from kleinkram.server.http.dependencies import session_cookie
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.auth.browser import Browser

PASSWORD = "correct horse battery"


@dataclass(frozen=True)
class Account:
    """A person with a local account, and the browser in which they created it."""

    id: str
    name: str
    email: str
    browser: Browser


def code_of(link: str) -> str:
    """Return the code that a link carries behind its #."""
    return link.partition("#")[2]


def any_email() -> str:
    """Return an unused address."""
    return f"{uuid.uuid4().hex[:12]}@lab.example"


def account(api: Api, *, name: str = "Ada", email: str | None = None) -> Account:
    """Make a local account by an admin's invitation."""
    email = email or any_email()
    link = api.post("/people/invitations", {"email": email}).ok(201)["url"]
    browser = Browser(api)
    made = browser.post("/auth/invitation", {"code": code_of(link), "name": name, "password": PASSWORD}).ok()
    return Account(made["person"]["id"], name, email, browser)


def signed_in(api: Api, name: str = "Ada") -> Account:
    """Insert a person without a password and a session: for tests that need a signed-in person."""
    email = any_email()
    put = people.person(api, name, email=email)
    browser = Browser(api)
    browser.cookies[session_cookie(api.app.state.settings)] = people.session(api, put)
    return Account(put.id, name, email, browser)


def sign_in(browser: Browser, email: str, password: str = PASSWORD) -> None:
    """Sign in with a password."""
    browser.post("/auth/password", {"email": email, "password": password}).ok()
