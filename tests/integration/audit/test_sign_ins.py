"""Sign-ins and sign-outs are recorded with method and address, and so are failures."""

from typing import Any

import pytest

from tests.integration.api_server import Api
from tests.integration.auth.accounts import account, any_email, code_of, sign_in
from tests.integration.auth.browser import Browser
from tests.integration.conftest import StartApi


@pytest.fixture(scope="module")
def api(start_api: StartApi) -> Api:
    """An API of its own without limits on sign-in attempts."""
    return start_api(sign_ins_per_minute=0)


def _latest(api: Api, operation: str) -> Any:
    return api.get("/audit", {"operation": operation, "limit": "1"}).ok()["items"][0]


def test_sign_in_and_sign_out_are_recorded_with_their_session(api: Api) -> None:
    ada = account(api)
    made = _latest(api, "person.create")
    assert (made["actor"], made["resource_id"], made["address"]) == (None, ada.id, "127.0.0.1")
    browser = Browser(api)
    sign_in(browser, ada.email)
    began = _latest(api, "session.create")
    assert (began["actor"]["id"], began["session_id"]) == (ada.id, began["resource_id"])
    assert (began["after"], began["address"]) == ({"method": "password"}, "127.0.0.1")
    browser.post("/auth/sign-out").ok(204)
    ended = _latest(api, "session.revoke")
    assert (ended["resource_id"], ended["actor"]["id"]) == (began["resource_id"], ada.id)


def test_a_failed_sign_in_is_recorded_without_the_input(api: Api) -> None:
    typed = any_email()
    Browser(api).post("/auth/password", {"email": typed, "password": "not the right one"}).refused(
        401, "sign_in_failed"
    )
    event = _latest(api, "auth.refused")
    assert (event["resource_name"], event["address"]) == ("POST /api/v1/auth/password", "127.0.0.1")
    assert typed not in str(event)


def test_creation_and_use_of_the_owner_link_are_recorded(api: Api) -> None:
    link = code_of(api.post("/auth/owner-link").ok()["url"])
    made = _latest(api, "link.create")
    assert (made["actor"]["name"], made["token"]["name"]) == ("owner", "local owner")
    Browser(api).post("/auth/link", {"code": link}).ok()
    assert _latest(api, "session.create")["after"] == {"method": "link"}


@pytest.mark.parametrize(("act", "message"), [("approve", "login.approve"), ("deny", "login.deny")])
def test_approval_of_a_program_is_recorded(api: Api, act: str, message: str) -> None:
    ada = account(api)
    shown = api.as_(None).post("/auth/device", {"client": "klein on anymal"}).ok()["user_code"]
    ada.browser.post(f"/auth/device/{act}", {"user_code": shown}).ok()
    event = _latest(api, message)
    assert (event["actor"]["id"], event["resource_name"]) == (ada.id, "klein on anymal")
    assert event["session_id"] is not None


def test_too_many_attempts_are_refused_and_recorded(start_api: StartApi) -> None:
    api = start_api(sign_ins_per_minute=2)
    wrong = {"email": any_email(), "password": "not the right one"}
    answers = [Browser(api).post("/auth/password", wrong) for _ in range(5)]
    assert {answer.status for answer in answers} == {401, 429}
    assert _latest(api, "rate.limited")["resource_name"] == "POST /api/v1/auth/password"


def test_reuse_of_a_code_is_recorded(api: Api) -> None:
    link = code_of(api.post("/auth/owner-link").ok()["url"])
    Browser(api).post("/auth/link", {"code": link}).ok()
    Browser(api).post("/auth/link", {"code": link}).refused(410, "code_gone")
    event = _latest(api, "auth.refused")
    assert (event["resource_name"], event["actor"]) == ("POST /api/v1/auth/link", None)
    assert link not in str(event)
