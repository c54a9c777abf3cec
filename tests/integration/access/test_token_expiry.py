"""Tokens expire: after the default time, and never later than the settings allow."""

import datetime
from typing import Any

import pytest

from tests.integration.api_server import Api
from tests.integration.conftest import StartApi


@pytest.fixture(name="lasting", scope="module")
def _valid_until(start_api: StartApi) -> Api:
    return start_api(token_days_max=0)


def _days(made: Any) -> float:
    ends = datetime.datetime.fromisoformat(made["token"]["expires_at"].replace("Z", "+00:00"))
    return (ends - datetime.datetime.now(datetime.timezone.utc)).total_seconds() / 86_400


def _in_days(days: float) -> str:
    return (datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=days)).isoformat()


@pytest.mark.parametrize(("kind", "days"), [("personal", 90), ("runner", 365)])
@pytest.mark.parametrize("text", [{}, {"expires_at": None}])
def test_a_token_expires_after_the_default_lifetime(api: Api, kind: str, days: float, text: dict[str, None]) -> None:
    made = api.post("/tokens", {"name": "usual", "kind": kind, **text}).ok(201)
    assert _days(made) == pytest.approx(days, abs=0.1)


def test_the_expiry_of_a_token_is_limited_by_the_maximum(api: Api) -> None:
    assert _days(api.post("/tokens", {"name": "a", "expires_at": _in_days(365)}).ok(201)) == pytest.approx(365, abs=0.1)
    refused = api.post("/tokens", {"name": "b", "expires_at": _in_days(366)}).refused(422, "invalid_request")
    assert "365 days" in str(refused["problems"])
    api.post("/tokens", {"name": "c", "no_end": True}).refused(422, "invalid_request")


def test_a_server_may_allow_tokens_without_an_end(lasting: Api) -> None:
    assert lasting.post("/tokens", {"name": "a", "no_end": True}).ok(201)["token"]["expires_at"] is None
    assert _days(lasting.post("/tokens", {"name": "b"}).ok(201)) == pytest.approx(90, abs=0.1)
    lasting.post("/tokens", {"name": "c", "no_end": True, "expires_at": _in_days(1)}).refused(422, "invalid_request")


def test_the_service_endpoint_returns_the_lifetimes_of_tokens(api: Api, lasting: Api) -> None:
    text = [item.get("/service").ok() for item in (api, lasting)]
    assert [(item["token_days_default"], item["token_days_max"]) for item in text] == [(90, 365), (90, 0)]
