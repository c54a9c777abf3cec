"""Browsers that sign in to a real `klein up`, simulated by HTTP requests."""

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
    """A browser, as far as pages need it: its cookie, and requests with the origin of the page."""

    url: str
    cookie: str
    pool: urllib3.PoolManager

    def sign_in(self, path: str, body: dict[str, Any]) -> str:
        """Sign in as a page of the server would, and return the cookie."""
        return str(self._post(path, body).headers["Set-Cookie"]).partition(";")[0]

    def post(self, path: str, body: dict[str, Any]) -> Any:
        """POST as a page of the server would, and return the body of the response."""
        return json.loads(self._post(path, body).data or b"null")

    def _post(self, path: str, body: dict[str, Any]) -> urllib3.BaseHTTPResponse:
        headers = {"Cookie": self.cookie, "Origin": self.url, "Content-Type": "application/json"}
        answer = self.pool.request("POST", f"{self.url}/api/v1{path}", body=json.dumps(body), headers=headers)
        assert answer.status < 300, (answer.status, answer.data)
        return answer

    def status_of(self, token: str) -> int:
        """Return the status of a request with a token."""
        headers = {"Authorization": f"Bearer {token}"}
        return self.pool.request("GET", f"{self.url}/api/v1/me", headers=headers).status

    def approve_login(self, url: str) -> int:
        """Approve a login on the page that `klein login` opens, and follow its redirect; return the status."""
        assert url.startswith(f"{self.url}/sign-in/cli?")
        query = {name: value for name, (value,) in parse_qs(urlsplit(url).query).items()}
        answer = self.post("/auth/cli/approve", {**query, "port": int(query["port"])})
        return self.pool.request("GET", answer["url"]).status

    def accept_invitation(self, link: str) -> "Browser":
        """Accept an invitation with a new password, and return the signed-in browser."""
        account = {"code": urlsplit(link).fragment, "password": uuid.uuid4().hex}
        return replace(self, cookie=self.sign_in("/auth/invitation", account))


def line_with(process: "subprocess.Popen[str]", words: str) -> str:
    """Return the first line on stderr that contains these words."""
    assert process.stderr is not None
    for line in process.stderr:
        if words in line:
            return line.strip()
    pytest.fail(f"klein did not print {words!r}")


def log_in(terminal: "Terminal", browser: Browser, *options: str) -> Any:
    """Sign in a terminal by the browser, and return the JSON that klein prints."""
    process = terminal.start("login", browser.url, "--json", *options)
    assert browser.approve_login(line_with(process, "/sign-in/cli?").split()[-1]) == 200
    out, err = process.communicate(timeout=100)
    assert process.returncode == 0, err
    return json.loads(out)
