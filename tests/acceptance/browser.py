"""The browsers of people who sign in to a real `klein up`, driven over plain HTTP."""

import json
import subprocess
import uuid
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

import pytest
import urllib3

if TYPE_CHECKING:
    from .conftest import Terminal


@dataclass(frozen=True)
class Browser:
    """A person's browser, as far as pages use it: a cookie, and requests that say which page they come from."""

    url: str
    cookie: str
    pool: urllib3.PoolManager

    def sign_in(self, path: str, body: dict[str, Any]) -> str:
        """Sign in as a page of the server would, and return the cookie."""
        return str(self._ask(path, body).headers["Set-Cookie"]).partition(";")[0]

    def post(self, path: str, body: dict[str, Any]) -> Any:
        """Ask for something as a page of the server would."""
        return json.loads(self._ask(path, body).data or b"null")

    def _ask(self, path: str, body: dict[str, Any]) -> urllib3.BaseHTTPResponse:
        headers = {"Cookie": self.cookie, "Origin": self.url, "Content-Type": "application/json"}
        answer = self.pool.request("POST", f"{self.url}/api/v1{path}", body=json.dumps(body), headers=headers)
        assert answer.status < 300, (answer.status, answer.data)
        return answer

    def status_of(self, token: str) -> int:
        """Return how the server answers whoever comes with a token."""
        headers = {"Authorization": f"Bearer {token}"}
        return self.pool.request("GET", f"{self.url}/api/v1/me", headers=headers).status

    def agree_to_login(self, url: str) -> int:
        """Open the page that `klein login` wants opened, agree on it, and go where it sends the browser."""
        assert url.startswith(f"{self.url}/sign-in/cli?")
        query = {name: value for name, (value,) in parse_qs(urlsplit(url).query).items()}
        answer = self.post("/auth/cli/approve", {**query, "port": int(query["port"])})
        return self.pool.request("GET", answer["url"]).status

    def accept_invitation(self, link: str) -> "Browser":
        """Return the browser of whom a link invites, signed in with a password that they chose."""
        chosen = {"code": urlsplit(link).fragment, "password": uuid.uuid4().hex}
        return replace(self, cookie=self.sign_in("/auth/invitation", chosen))


def line_with(process: "subprocess.Popen[str]", words: str) -> str:
    """Return the first line on stderr that has these words."""
    assert process.stderr is not None
    for line in process.stderr:
        if words in line:
            return line.strip()
    pytest.fail(f"klein did not say {words!r}")


def log_in(terminal: "Terminal", browser: Browser, *options: str) -> Any:
    """Sign in by the browser and return what klein says of it."""
    process = terminal.start("login", browser.url, "--json", *options)
    assert browser.agree_to_login(line_with(process, "/sign-in/cli?").split()[-1]) == 200
    out, err = process.communicate(timeout=100)
    assert process.returncode == 0, err
    return json.loads(out)
