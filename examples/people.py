"""Another person's browser and terminal, for the part of the demo about access.

This script stands in for the browser in which they choose a password and approve `klein login`.
"""

import json
import subprocess
import urllib.request
from collections.abc import Callable, Mapping
from http.cookiejar import CookieJar
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit


class Browser:
    """The requests that a browser sends for the pages of the server."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(CookieJar()))

    def accept_invitation(self, link: str, password: str) -> None:
        """Choose a password on the invitation page, which also signs the browser in."""
        self._post("/auth/invitation", {"code": urlsplit(link).fragment, "password": password})

    def approve_login(self, link: str) -> None:
        """Approve the program on the page that `klein login` opens, and follow the redirect."""
        request = {name: value for name, (value,) in parse_qs(urlsplit(link).query).items()}
        answer = self._post("/auth/cli/approve", {**request, "port": int(request["port"])})
        self._opener.open(answer["url"], timeout=20).close()

    def _post(self, path: str, body: Mapping[str, object]) -> Any:  # Any: JSON
        headers = {"Content-Type": "application/json", "Origin": self.url}
        request = urllib.request.Request(f"{self.url}/api/v1{path}", json.dumps(body).encode(), headers)
        with self._opener.open(request, timeout=20) as answer:
            return json.load(answer)


def log_in(klein: Path, browser: Browser, environment: Mapping[str, str], say: Callable[[str], None]) -> int:
    """Run `klein login` and approve it in the browser; returns its exit code."""
    process = subprocess.Popen([klein, "login", browser.url], stderr=subprocess.PIPE, text=True, env=dict(environment))
    assert process.stderr is not None
    for line in process.stderr:
        words = line.split()
        if "/sign-in/cli?" in line:
            browser.approve_login(words[-1])
            line = f"{' '.join(words[:-1])} {words[-1].partition('?')[0]}?…"
        say(line.rstrip())
    return process.wait(timeout=60)
