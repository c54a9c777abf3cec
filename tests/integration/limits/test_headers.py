"""Security headers of every response, and forwarded headers of trusted proxies."""

import pytest
import urllib3

from tests.integration.api_server import Api
from tests.integration.conftest import StartApi

GUARDS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}


def _headers(api: Api, method: str, path: str, token: str | None, body: bytes | None = None) -> dict[str, str]:
    sent = {} if token is None else {"Authorization": f"Bearer {token}"}
    answer = urllib3.request(method, f"{api.url}{path}", headers=sent, body=body, redirect=False)
    assert len(answer.headers) == len({name.lower() for name in answer.headers}), "no header is said twice"
    return {name.lower(): value for name, value in answer.headers.items()}


@pytest.mark.parametrize(
    ("method", "path", "with_token", "body"),
    [
        ("GET", "/api/v1/projects", True, None),
        ("GET", "/api/v1/projects", False, None),
        ("GET", "/api/v1/service", False, None),
        ("GET", "/api/v1/nowhere", True, None),
        ("DELETE", "/api/v1/projects", True, None),
        ("POST", "/api/v1/projects", True, b"{"),
        ("POST", "/api/v1/projects", True, b"x" * 5_000_000),
        ("GET", "/api/v1/audit/export?until=2000-01-01", True, None),
        ("GET", "/health/live", False, None),
        ("GET", "/openapi.json", False, None),
    ],
)
def test_every_response_has_security_headers(
    api: Api, method: str, path: str, with_token: bool, body: bytes | None
) -> None:
    headers = _headers(api, method, path, api.token if with_token else None, body)
    assert headers.items() >= GUARDS.items()
    policy = dict(part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";"))
    assert policy["default-src"] == policy["frame-ancestors"] == policy["base-uri"] == policy["form-action"] == "'none'"
    assert "strict-transport-security" not in headers
    assert "server" not in headers


def test_hsts_is_sent_behind_tls(start_api: StartApi) -> None:
    api = start_api(public_url="https://lab.example")
    assert _headers(api, "GET", "/health/live", None)["strict-transport-security"] == "max-age=31536000"


def _address_noted(api: Api, **headers: str) -> str:
    answer = api.as_(None).call("PATCH", "/projects/x", {}, headers={"X-Request-Id": "mine", **headers})
    answer.refused(401, "not_authenticated")
    return str(api.all("/audit", {"operation": "a*"})[0]["address"])


def test_forwarded_headers_of_untrusted_peers_are_ignored(api: Api) -> None:
    assert _address_noted(api, **{"X-Forwarded-For": "203.0.113.9"}) == "127.0.0.1"
    assert _address_noted(api, Forwarded="for=203.0.113.9") == "127.0.0.1"


def test_only_entries_of_trusted_proxies_in_forwarded_headers_count(start_api: StartApi) -> None:
    api = start_api(trusted_proxies="127.0.0.0/8, 10.0.0.0/8")
    assert _address_noted(api, **{"X-Forwarded-For": "203.0.113.9"}) == "203.0.113.9"
    assert _address_noted(api, **{"X-Forwarded-For": "192.0.2.1, 203.0.113.9, 10.1.1.1"}) == "203.0.113.9"


@pytest.mark.parametrize("path", ["/api/v1/projects/", "/sign-in/", "/health/live/"])
def test_redirects_ignore_the_host_header(api: Api, path: str) -> None:
    answer = urllib3.request("GET", f"{api.url}{path}", headers={"Host": "evil.example"}, redirect=False)
    assert (answer.status, answer.headers.get("location")) == (404, None)
    assert answer.json()["code"] == "not_found"
