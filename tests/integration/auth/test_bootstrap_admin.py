"""The first admin of a new server and the owner link, for people who can read the server's output."""

import asyncio
import logging
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from kleinkram.contract.token_format import has_valid_checksum
from kleinkram.server.access.builtin_groups import ADMINS_ID
from kleinkram.server.app import create_app
from kleinkram.server.auth import bootstrap as owner
from kleinkram.server.auth.bootstrap import log_bootstrap_code
from kleinkram.server.auth.one_time_codes import delete_expired_codes
from kleinkram.server.context import AppContext
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.auth.accounts import PASSWORD, account, any_email, code_of, signed_in
from tests.integration.auth.browser import Browser
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site


@pytest.fixture(name="server", scope="module")
def _server(start_api: StartApi) -> Api:
    return start_api()


@pytest.fixture(name="fresh")
def _fresh(server: Api) -> Api:
    """A server without an admin."""
    server.sql("DELETE FROM membership WHERE group_id = %s", ADMINS_ID)
    server.sql("DELETE FROM one_time_code")
    return server


async def _start(context: AppContext) -> None:
    async with context.database.begin() as db:
        await log_bootstrap_code(db)


def _code(api: Api, caplog: pytest.LogCaptureFixture) -> str:
    """Start the server as far as this goes, and read its log."""
    with caplog.at_level(logging.WARNING, logger="kleinkram.auth"):
        on_site(api, _start)
    codes = re.findall(r"bootstrap code: (\S+)", caplog.text)
    assert codes
    return str(codes[-1])


def _bootstrap(code: str, **more: Any) -> dict[str, Any]:
    return {"code": code, "name": "Ada", "email": any_email(), "password": PASSWORD, **more}


def test_the_code_in_the_log_makes_the_first_admin_once(fresh: Api, caplog: pytest.LogCaptureFixture) -> None:
    assert Browser(fresh).get("/api/v1/auth/methods").ok()["bootstrap"] is True
    earlier, code = _code(fresh, caplog), _code(fresh, caplog)
    assert fresh.sql("SELECT 1 FROM one_time_code WHERE encode(secret_sha256, 'escape') = %s", code) == []
    ada = Browser(fresh)
    ada.post("/auth/bootstrap", _bootstrap(code)).ok()
    assert ada.me()["is_admin"] is True
    for used in (earlier, code):
        Browser(fresh).post("/auth/bootstrap", _bootstrap(used)).refused(410, "code_gone")
    assert Browser(fresh).get("/api/v1/auth/methods").ok()["bootstrap"] is False
    event = ada.get("/api/v1/audit?operation=server.bootstrap").ok()["items"][0]
    assert event["resource_id"] == ada.me()["person"]["id"]


def test_a_wrong_code_makes_no_admin(fresh: Api, caplog: pytest.LogCaptureFixture) -> None:
    _code(fresh, caplog)
    Browser(fresh).post("/auth/bootstrap", _bootstrap("x" * 43)).refused(410, "code_gone")
    assert fresh.sql("SELECT count(*) FROM membership WHERE group_id = %s", ADMINS_ID) == [(0,)]


def test_concurrent_bootstraps_make_one_admin(fresh: Api, caplog: pytest.LogCaptureFixture) -> None:
    codes = [_code(fresh, caplog), _code(fresh, caplog)]
    with ThreadPoolExecutor(2) as pool:
        calls = [pool.submit(Browser(fresh).post, "/auth/bootstrap", _bootstrap(code)) for code in codes]
    assert sorted(call.result().status for call in calls) == [200, 410]
    assert fresh.sql("SELECT count(*) FROM membership WHERE group_id = %s", ADMINS_ID) == [(1,)]


def test_a_signed_in_person_becomes_admin_with_the_code_alone(fresh: Api, caplog: pytest.LogCaptureFixture) -> None:
    ben = signed_in(fresh, "Ben")
    ben.browser.post("/auth/bootstrap", {"code": _code(fresh, caplog)}).ok()
    me = ben.browser.me()
    assert (me["person"]["id"], me["is_admin"]) == (ben.id, True)


def test_a_failed_bootstrap_does_not_use_the_code(fresh: Api, caplog: pytest.LogCaptureFixture) -> None:
    code = _code(fresh, caplog)
    problem = Browser(fresh).post("/auth/bootstrap", {"code": code}).refused(422, "invalid_request")
    assert {item["field"] for item in problem["problems"]} == {"name", "email", "password"}
    Browser(fresh).post("/auth/bootstrap", _bootstrap(code, password="short")).refused(422, "invalid_request")
    Browser(fresh).post("/auth/bootstrap", _bootstrap(code)).ok()


def test_a_server_with_an_admin_logs_no_code(api: Api, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, logger="kleinkram.auth"):
        on_site(api, _start)
    assert "bootstrap code" not in caplog.text


def test_the_owner_s_link_signs_a_browser_in_once(api: Api) -> None:
    link = api.post("/auth/owner-link").ok()["url"]
    browser = Browser(api)
    assert link.startswith(f"{browser.public_url}/sign-in/link#")
    browser.post("/auth/link", {"code": code_of(link)}).ok()
    me = browser.me()
    assert (me["person"]["name"], me["is_admin"], me["credential"]["name"]) == ("owner", True, "link")
    Browser(api).post("/auth/link", {"code": code_of(link)}).refused(410, "code_gone")


def test_a_link_ends_with_a_newer_link_or_its_expiry(api: Api) -> None:
    older, newer = (code_of(api.post("/auth/owner-link").ok()["url"]) for _ in range(2))
    Browser(api).post("/auth/link", {"code": older}).refused(410, "code_gone")
    api.sql("UPDATE one_time_code SET expires_at = now() WHERE purpose = 'owner' AND used_at IS NULL")
    Browser(api).post("/auth/link", {"code": newer}).refused(410, "code_gone")


def test_only_the_owner_gets_a_link_and_only_our_pages_accept_it(api: Api) -> None:
    admin = people.person(api, admin=True)
    api.as_(admin.token).post("/auth/owner-link").refused(403, "forbidden")
    code = code_of(api.post("/auth/owner-link").ok()["url"])
    foreign = Browser(api, origin="https://evil.example")
    foreign.post("/auth/link", {"code": code}).refused(401, "not_authenticated")
    assert foreign.cookies == {}


def test_codes_and_logins_are_deleted_after_retention(api: Api) -> None:
    link = api.post("/people/invitations", {"email": any_email()}).ok(201)["url"]
    api.sql("UPDATE one_time_code SET expires_at = now() - interval '31 days' WHERE purpose = 'invitation'")
    remaining = api.sql("SELECT count(*) FROM one_time_code WHERE purpose <> 'invitation'")

    async def forget(context: AppContext) -> None:
        async with context.database.begin() as db:
            await delete_expired_codes(db)

    on_site(api, forget)
    assert api.sql("SELECT count(*) FROM one_time_code") == remaining
    Browser(api).post("/auth/codes", {"code": code_of(link)}).refused(410, "code_gone")


def test_a_link_is_not_valid_for_another_purpose(api: Api) -> None:
    made = account(api)
    reset = code_of(api.post(f"/people/{made.id}/reset").ok(201)["url"])
    Browser(api).post("/auth/link", {"code": reset}).refused(410, "code_gone")
    Browser(api).post("/auth/invitation", {"code": reset, "password": PASSWORD}).refused(410, "code_gone")
    owner = code_of(api.post("/auth/owner-link").ok()["url"])
    Browser(api).post("/auth/reset", {"code": owner, "password": PASSWORD}).refused(410, "code_gone")


def _start_again(api: Api) -> str:
    """Start another process of the server, end it, and return what is in the owner's file then."""
    app = create_app(api.app.state.settings)

    async def start() -> None:
        async with app.router.lifespan_context(app):
            pass

    asyncio.run(start())
    return _file(api).read_text().strip()


def _file(api: Api) -> Path:
    file: Path = api.app.state.settings.owner_token_file
    return file


def test_a_revoked_owner_token_is_replaced_at_the_next_start(start_api: StartApi) -> None:
    api = start_api()
    revoked = api.token or ""
    assert _start_again(api) == revoked, "as long as it is good, it stays"
    api.delete(f"/tokens/{api.get('/me').ok()['credential']['id']}").ok(204)
    renewed = _start_again(api)
    assert renewed != revoked
    assert has_valid_checksum(renewed)
    assert _file(api).stat().st_mode & 0o777 == 0o600
    api.get("/me").refused(401, "not_authenticated")
    assert api.as_(renewed).get("/me").ok()["is_admin"]
    assert _start_again(api) == renewed
    # One that was the file's before is no good either when it is put back there.
    _file(api).write_text(revoked)
    api.get("/me").refused(401, "not_authenticated")
    assert _start_again(api) not in {revoked, renewed}
    api.as_(renewed).get("/me").refused(401, "not_authenticated")


def test_an_owner_token_file_that_cannot_be_written_is_named(
    start_api: StartApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    api = start_api()
    api.delete(f"/tokens/{api.get('/me').ok()['credential']['id']}").ok(204)

    def refuse(_path: Path, _text: str) -> None:
        raise PermissionError("read-only")

    monkeypatch.setattr(owner, "_write_private", refuse)
    with pytest.raises(RuntimeError, match="takes no other: read-only"):
        _start_again(api)
    # No token remains that was never delivered.
    assert api.sql("SELECT 1 FROM token WHERE revoked_at IS NULL") == []
