"""A minimal browser for sign-in tests: it stores cookies, sends Origin, and follows no redirect."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from http.cookies import SimpleCookie
from typing import Any

import urllib3

from tests.integration.api_server import Answer, Api

USER_AGENT = "a browser of the tests"


@dataclass
class Browser:
    """A browser of one API. `origin` is the origin of the page that sends requests, by default that of the server."""

    api: Api
    origin: str | None = None
    cookies: dict[str, str] = field(default_factory=dict)
    _pool: urllib3.PoolManager = field(default_factory=lambda: urllib3.PoolManager(retries=False, timeout=30))

    @property
    def public_url(self) -> str:
        """What the server takes for its address, whatever port the tests gave it."""
        return str(self.api.app.state.settings.public_url)

    def other_tab(self) -> "Browser":
        """Return another page of the same browser."""
        return replace(self)

    def from_page_of(self, origin: str | None) -> "Browser":
        """Return a page of another site in the same browser; None for a request that does not say where it is from."""
        return replace(self, origin=origin or "")

    def get(self, path: str) -> Answer:
        """Open a path of the server, without following where it leads."""
        return self.call("GET", path)

    def post(self, path: str, body: object = None) -> Answer:
        """Have a page's script send JSON to the API."""
        return self.call("POST", f"/api/v1{path}", body)

    def call(self, method: str, path: str, body: object = None) -> Answer:
        """Make one request; `path` may be an address of the server, as it names itself."""
        headers = {"User-Agent": USER_AGENT}
        if self.cookies:
            headers["Cookie"] = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        origin = self.public_url if self.origin is None else self.origin
        if method != "GET" and origin:
            headers["Origin"] = origin
        data = None
        if body is not None:
            headers["Content-Type"] = "application/json"
            data = json.dumps(body).encode()
        address = self.api.url + path.removeprefix(self.public_url)
        answer = self._pool.request(method, address, body=data, headers=headers, redirect=False)
        self._keep(answer.headers.getlist("set-cookie"))
        message = {name.lower(): value for name, value in answer.headers.items()}
        return Answer(answer.status, message, _parsed(message, answer.data))

    def me(self) -> Any:
        """Return who the server takes the browser for."""
        return self.call("GET", "/api/v1/me").ok()

    def is_signed_in(self) -> bool:
        """Say whether the server knows the browser."""
        return self.call("GET", "/api/v1/me").status == 200

    def _keep(self, set_cookies: list[str]) -> None:
        for line in set_cookies:
            for name, morsel in SimpleCookie(line).items():
                if morsel["max-age"] == "0":
                    self.cookies.pop(name, None)
                else:
                    self.cookies[name] = morsel.value


def _parsed(headers: Mapping[str, str], data: bytes) -> Any:
    if not data:
        return None
    return json.loads(data) if "json" in headers.get("content-type", "") else data.decode()
