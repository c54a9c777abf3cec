"""Request bodies are bounded, more tightly without credentials, and so are error lists."""

import json
import uuid

import pytest
import urllib3

from kleinkram.contract.reports import MAX_REPORT_BODY_BYTES
from tests.integration.api_server import Api

_MANY_KEYS = json.dumps({f"k{number}": 1 for number in range(20_000)}).encode()


def _post(api: Api, path: str, headers: dict[str, str]) -> urllib3.BaseHTTPResponse:
    sent = {"Content-Type": "application/json", **headers}
    return urllib3.request("POST", f"{api.url}/api/v1{path}", headers=sent, body=_MANY_KEYS, timeout=30)


@pytest.mark.parametrize("more", [{}, {"Cookie": "kleinkram=nobody's"}, {"Authorization": "Bearer nobody's"}])
@pytest.mark.parametrize("path", ["/auth/password", "/auth/device"])
def test_sign_in_bodies_are_limited(api: Api, path: str, more: dict[str, str]) -> None:
    refused = _post(api, path, more)
    assert refused.status == 413
    assert refused.json()["limit_bytes"] == 64 * 1024


def test_the_problems_of_an_invalid_request_are_limited_to_100(api: Api) -> None:
    answer = _post(api, "/projects", {"Authorization": f"Bearer {api.token}"})
    assert answer.status == 422
    assert 0 < len(answer.json()["problems"]) <= 100


@pytest.mark.parametrize(
    ("path", "limit_bytes"),
    [
        ("/runner/runs/{id}/finish", MAX_REPORT_BODY_BYTES),
        ("/missions/{id}/check-reports", MAX_REPORT_BODY_BYTES),
        ("/missions/{id}/check-reports/more", 4 * 2**20),
        ("/missions/{id}/check-notes", 4 * 2**20),
    ],
)
def test_only_reports_may_be_larger_than_other_bodies(api: Api, path: str, limit_bytes: int) -> None:
    address = f"{api.url}/api/v1{path.replace('{id}', str(uuid.uuid4()))}"
    headers = {"Content-Type": "application/json", "Authorization": f"Bearer {api.token}"}
    answer = urllib3.request("POST", address, headers=headers, body=b" " * (limit_bytes + 1), timeout=30)
    assert (answer.status, answer.json()["limit_bytes"]) == (413, limit_bytes)
    answer = urllib3.request("POST", address, headers={}, body=b" " * (64 * 1024 + 1), timeout=30)
    assert (answer.status, answer.json()["limit_bytes"]) == (413, 64 * 1024)
