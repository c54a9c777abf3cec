"""Log lines, audit log, error responses and representations of objects contain no secret."""

import datetime
import json
import logging
import secrets
from collections.abc import Iterator
from urllib.parse import parse_qs, urlsplit

import pytest
from pydantic import ValidationError
from sqlalchemy import text

from kleinkram.json_logs import JsonLines
from kleinkram.server.access.actor import find_actor
from kleinkram.server.context import AppContext
from kleinkram.server.http.dependencies import Transaction
from kleinkram.server.logs import quiet_libraries
from kleinkram.server.settings import Settings
from tests.integration.api_server import Answer, Api
from tests.integration.auth.accounts import PASSWORD, account, any_email, code_of, sign_in
from tests.integration.auth.browser import Browser
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site, run_jobs
from tests.integration.upload_client import begin, complete, parts_of, put, sign


class Story:
    """What a test did: every secret that it saw, every answer that was a failure, every line that was logged."""

    def __init__(self, api: Api) -> None:
        self.api = api
        self.secrets: dict[str, str] = {}
        self.failures: list[str] = []
        self.lines: list[str] = []

    def keep(self, **named: str) -> None:
        """Remember secrets; each must be one."""
        for name, secret in named.items():
            assert len(secret) >= 8, name
            self.secrets[name] = secret

    def fails(self, answer: Answer) -> None:
        """Note an answer that must be a failure."""
        assert answer.status >= 400, answer
        self.failures.append(json.dumps(answer.body))

    def found_in(self, texts: list[str]) -> set[str]:
        """Return the names of the secrets that are in one of these."""
        whole = "\n".join(texts)
        return {name for name, secret in self.secrets.items() if secret in whole}


class _LogCollector(logging.Handler):
    def __init__(self, lines: list[str]) -> None:
        super().__init__(logging.DEBUG)
        self.setFormatter(JsonLines("api"))
        self._lines = lines

    def emit(self, record: logging.LogRecord) -> None:
        self._lines.append(self.format(record))


@pytest.fixture
def story(start_api: StartApi) -> Iterator[Story]:
    """A story on an API of its own, with all that is logged meanwhile, of our own code in every detail."""
    story = Story(start_api(sign_ins_per_minute=0))
    collector, root, ours = _LogCollector(story.lines), logging.getLogger(), logging.getLogger("kleinkram")
    levels = root.level, ours.level
    root.addHandler(collector)
    root.setLevel(logging.INFO)
    ours.setLevel(logging.DEBUG)
    quiet_libraries()
    yield story
    root.removeHandler(collector)
    root.setLevel(levels[0])
    ours.setLevel(levels[1])


def test_no_secret_is_stored_or_logged(story: Story) -> None:
    settings: Settings = story.api.app.state.settings
    s3_key = settings.s3_secret_key.get_secret_value()
    story.keep(owner_token=str(story.api.token), password=PASSWORD, s3_key=s3_key, database=_password(settings))
    _sign_people_in(story)
    _sign_programs_in(story)
    _carry_tokens_and_links(story)
    _move_bytes(story)
    _crash(story)
    run_jobs(story.api)
    assert len(story.secrets) >= 17
    assert len(story.lines) > 20
    assert story.found_in(story.lines) == set()
    assert story.found_in(story.failures) == set()
    rows = story.api.sql("SELECT row_to_json(audit_event)::text FROM audit_event")
    assert len(rows) > 20
    assert story.found_in([row for (row,) in rows]) == set()
    texts = [text for (text,) in story.api.sql("SELECT row_to_json(rate_count)::text FROM rate_count")]
    assert story.found_in(texts) == set()


def _sign_people_in(story: Story) -> None:
    api = story.api
    invitation = api.post("/people/invitations", {"email": any_email()}).ok(201)["url"]
    story.keep(invitation=code_of(invitation))
    ada = account(api)
    sign_in(ada.browser, ada.email)
    story.keep(session=next(iter(ada.browser.cookies.values())))
    reset = code_of(api.post(f"/people/{ada.id}/reset").ok(201)["url"])
    story.keep(reset=reset, new_password="another battery staple", guess="wrong password of hers")
    browser = Browser(api)
    browser.post("/auth/reset", {"code": reset, "password": story.secrets["new_password"]}).ok()
    story.fails(browser.post("/auth/reset", {"code": reset, "password": story.secrets["new_password"]}))
    story.fails(browser.post("/auth/password", {"email": ada.email, "password": story.secrets["guess"]}))
    story.fails(browser.post("/auth/password", {"email": ada.email, "password": story.secrets["guess"], "x": 1}))
    story.fails(browser.post("/auth/password", {"email": ada.email, "password": [story.secrets["guess"]]}))
    story.fails(ada.browser.from_page_of("https://evil.example").post("/projects", {"name": "x"}))
    owner = code_of(api.post("/auth/owner-link").ok()["url"])
    story.keep(owner_link=owner)
    Browser(api).post("/auth/link", {"code": owner}).ok()
    story.fails(Browser(api).post("/auth/link", {"code": owner}))


def _sign_programs_in(story: Story) -> None:
    api = story.api
    begun = api.as_(None).post("/auth/device", {"client": "klein on anymal"}).ok()
    story.keep(device_code=begun["device_code"])
    story.fails(api.as_(None).post("/auth/device/token", {"device_code": begun["device_code"]}))
    guessed = "g" * 43
    story.keep(wrong_device_code=guessed)
    story.fails(api.as_(None).post("/auth/device/token", {"device_code": guessed}))


def _carry_tokens_and_links(story: Story) -> None:
    api = story.api
    made = api.post("/tokens", {"name": "script", "scopes": ["read"]}).ok(201)
    story.keep(token=made["secret"])
    script = api.as_(made["secret"])
    story.fails(script.post("/projects", {"name": "x"}))
    script.get("/projects").ok()
    api.call("GET", f"/nowhere/{made['secret']}")
    api.call("GET", f"/projects/{made['secret']}").refused(422, "invalid_request")
    api.delete(f"/tokens/{made['token']['id']}")
    story.fails(script.get("/projects"))
    mission = api.mission(api.project()["id"])["id"]
    tomorrow = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=1)
    share = {"name": "partner", "expires_at": tomorrow.isoformat()}
    shared = api.post(f"/missions/{mission}/shares", share).ok(201)
    story.keep(link=shared["secret"])
    guest = api.as_(shared["secret"])
    guest.get("/files").ok()
    story.fails(guest.post("/projects", {"name": "x"}))
    story.fails(api.call("GET", "/projects", headers={"Authorization": f"Basic {made['secret']}"}))


def _signature(url: str) -> str:
    return parse_qs(urlsplit(url).query)["X-Amz-Signature"][0]


def _move_bytes(story: Story) -> None:
    """Send and fetch a file, and give the store's address a wrong answer to write about."""
    api = story.api
    mission = api.mission(api.project()["id"])["id"]
    body = secrets.token_bytes(1000)
    (decision,) = begin(api, mission, {"a.bin": body}, hashed=False)
    signed = sign(api, decision["upload"], parts_of(decision["upload"], body)).ok()["items"][0]
    story.keep(part_url=_signature(signed["url"]))
    put(signed, bytes(len(body)))
    assert put(signed, body) == 200
    made = complete(api, decision["upload"], body)
    link = api.post("/files/download", {"file_ids": [made["file"]["id"]]}).ok()["items"][0]
    story.keep(download_url=_signature(link["url"]))
    run_jobs(api)


def _crash(story: Story) -> None:
    """Fail where a secret is at hand: in a statement that the database refuses, and in code of ours."""
    story.keep(bound="a parameter of a statement")

    async def crash(db: Transaction) -> None:
        values = {"token": story.secrets["bound"]}
        await db.execute(text("SELECT 1 FROM token WHERE name = :token AND 1 / (SELECT 0) = 1"), values)

    story.api.app.add_api_route("/api/v1/crash", crash, operation_id="get_service")
    answer = story.api.get("/crash")
    assert answer.status == 500
    story.fails(answer)
    assert any("DivisionByZero" in line for line in story.lines)


async def _owner(context: AppContext, token: str) -> str:
    async with context.database.begin() as db:
        return repr(await find_actor(db, token))


def test_representations_of_objects_contain_no_secret(api: Api) -> None:
    settings: Settings = api.app.state.settings
    hidden = [
        settings.s3_secret_key.get_secret_value(),
        str(settings.database_url),
        _password(settings),
        str(api.token),
    ]
    shown = f"{settings!r} {settings} {on_site(api, lambda context: _context_text(context))}"
    shown += on_site(api, lambda context: _owner(context, str(api.token)))
    assert [secret for secret in hidden if secret in shown] == []


def _password(settings: Settings) -> str:
    return str(settings.database_url.hosts()[0]["password"])


async def _context_text(context: AppContext) -> str:
    return f"{context!r} {context.database!r} {context.database.engine!r} {context.storage!r}"


def test_an_invalid_setting_is_named_without_its_value(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("S3_INTERNAL_URL", "S3_ACCESS_KEY", "S3_SECRET_KEY"):
        monkeypatch.setenv(f"KLEINKRAM_{name}", "given")
    monkeypatch.setenv("KLEINKRAM_DATABASE_URL", "mysql://me:hunter22@db/kleinkram")
    with pytest.raises(ValidationError) as raised:
        Settings()
    assert "database_url" in str(raised.value)
    assert "hunter22" not in str(raised.value)
