"""The S3 client of the server with error responses of a failing store."""

import asyncio
import http.server
import json
import os
import ssl
import subprocess
import sys
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from pydantic import SecretStr

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.server.s3.client import S3Error, S3Request, open_s3
from kleinkram.server.s3.signing import Presigner
from kleinkram.server.s3.storage import Storage, open_storage
from kleinkram.server.settings import Settings
from tests.certificate import make_certificate
from tests.http_server import Server
from tests.integration.api_server import Api
from tests.ports import choose_port


@dataclass(frozen=True)
class ScriptedReply:
    """One answer: its status, its body, and how much longer than that it claims to be."""

    status: int
    body: bytes = b""
    missing_bytes: int = 0


@contextmanager
def _store(
    answers: list[ScriptedReply], certificate: tuple[Path, Path] | None = None
) -> Iterator[tuple[Settings, list[str]]]:
    """Serve these answers, one after the other; yields its settings and the requests it has seen."""
    seen: list[str] = []

    class Scripted(http.server.BaseHTTPRequestHandler):
        def _answer(self) -> None:
            self.rfile.read(int(self.headers.get("Content-Length", 0)))
            seen.append(f"{self.command} {self.path.partition('?')[0]}")
            reply = answers[min(len(seen), len(answers)) - 1]
            self.send_response(reply.status)
            self.send_header("Content-Length", str(len(reply.body) + reply.missing_bytes))
            self.end_headers()
            self.wfile.write(reply.body)

        do_GET = do_PUT = do_POST = do_HEAD = _answer

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002  (the name it has in the base class)
            """Say nothing."""

    with Server(("127.0.0.1", 0), Scripted) as server:
        if certificate is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(*certificate)
            server.socket = context.wrap_socket(server.socket, server_side=True)
        scheme = "http" if certificate is None else "https"
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        settings = {
            "database_url": "postgresql://a@b/c",
            "s3_internal_url": f"{scheme}://127.0.0.1:{server.server_port}",
        }
        try:
            yield Settings.model_validate({**settings, "s3_access_key": "key", "s3_secret_key": "secret"}), seen
        finally:
            server.shutdown()
            thread.join()


def _ask(settings: Settings, question: S3Request) -> str:
    async def run() -> str:
        async with open_s3(settings, Presigner(settings, settings.s3_internal_url)) as s3:
            return (await s3.request(question)).text("UploadId")

    return asyncio.run(run())


_DONE = ScriptedReply(200, b"<R xmlns='urn:any'><UploadId>7</UploadId></R>")


def test_transient_errors_are_retried() -> None:
    with _store([ScriptedReply(503), ScriptedReply(500, b"<Error><Code>InternalError</Code></Error>"), _DONE]) as (
        settings,
        seen,
    ):
        assert _ask(settings, S3Request("POST", "a b", {"uploads": ""})) == "7"
    assert seen == ["POST /kleinkram/a%20b"] * 3


def test_persistent_errors_are_raised_after_three_attempts() -> None:
    with (
        _store([ScriptedReply(503, b"<Error><Code>SlowDown</Code><Message>less</Message></Error>")]) as (
            settings,
            seen,
        ),
        pytest.raises(S3Error, match="SlowDown: less"),
    ):
        _ask(settings, S3Request("PUT", "a", body=b"bytes"))
    assert len(seen) == 3


def test_a_refusal_is_not_tried_again() -> None:
    with (
        _store([ScriptedReply(403, b"<html>a proxy's page"), _DONE]) as (settings, seen),
        pytest.raises(S3Error, match="403"),
    ):
        _ask(settings, S3Request("GET", "a"))
    assert len(seen) == 1


@pytest.mark.parametrize("before", [b"", b"  \n ", b" <?xml version='1.0'?>"])
def test_an_error_after_status_200_is_an_error(before: bytes) -> None:
    late = before + b"<Error><Code>InternalError</Code><Message>late</Message></Error>"
    with (
        _store([ScriptedReply(200, late)]) as (settings, _),
        pytest.raises(S3Error, match="InternalError: late"),
    ):
        _ask(settings, S3Request("POST", "a", {"uploadId": "7"}))


@pytest.mark.parametrize("body", [b"", b"<html><title>404</title></html>"])
def test_a_404_that_is_no_stores_word_does_not_mean_gone(body: bytes) -> None:
    async def run(settings: Settings) -> None:
        async with open_storage(settings) as storage:
            with pytest.raises(StoreUnavailable):
                await storage.list_parts("a", "7")
            with pytest.raises(StoreUnavailable):
                _ = [piece async for piece in storage.read("a")]

    with _store([ScriptedReply(404, body)]) as (settings, _):
        asyncio.run(run(settings))


def test_an_object_that_ends_early_is_no_object() -> None:
    async def run(settings: Settings) -> None:
        async with open_storage(settings) as storage:
            pieces = storage.read("a")
            assert await anext(pieces) == b"half"
            with pytest.raises(StoreUnavailable, match="stopped"):
                await anext(pieces)

    with _store([ScriptedReply(200, b"half", missing_bytes=4)]) as (settings, _):
        asyncio.run(run(settings))


_Question = Callable[[Storage], Awaitable[object]]
_LISTS: list[_Question] = [lambda store: store.list_parts("a", "7"), lambda store: store.sizes("a/")]
_REQUESTS: list[_Question] = [
    *_LISTS,
    lambda store: store.create_multipart("a"),
    lambda store: store.list_multiparts("a"),
    lambda store: store.complete_multipart("a", "7", count=1, crc64nvme=bytes(8)),
]


def _unavailable(settings: Settings, question: _Question) -> str:
    async def run() -> str:
        async with open_storage(settings) as storage:
            with pytest.raises(StoreUnavailable) as raised:
                await asyncio.wait_for(question(storage), 10)
            return raised.value.reason

    return asyncio.run(run())


@pytest.mark.parametrize("question", _REQUESTS)
@pytest.mark.parametrize("body", [b"", b"<html>sign in<br>", b"<html xmlns='http://www.w3.org/1999/xhtml'/>"])
def test_a_page_of_a_proxy_is_an_unavailable_store(question: _Question, body: bytes) -> None:
    with _store([ScriptedReply(200, body)]) as (settings, _):
        assert "NotAStore" in _unavailable(settings, question)


def test_a_multipart_upload_without_an_id_is_none() -> None:
    with _store([ScriptedReply(200, b"<R/>")]) as (settings, _):
        assert "no id" in _unavailable(settings, lambda store: store.create_multipart("a"))


@pytest.mark.parametrize("question", _LISTS)
@pytest.mark.parametrize("next_page", [b"", b"<%b>5</%b>"])
def test_a_listing_without_a_next_page_ends(question: _Question, next_page: bytes) -> None:
    named = b"".join(next_page.replace(b"%b", name) for name in (b"NextPartNumberMarker", b"NextContinuationToken"))
    with _store([ScriptedReply(200, b"<R><IsTruncated>true</IsTruncated>" + named + b"</R>")]) as (settings, _):
        assert "where it continues" in _unavailable(settings, question)


def test_a_stores_name_in_capitals_is_signed_as_it_is_sent(api: Api) -> None:
    settings: Settings = api.app.state.settings
    url = settings.s3_internal_url.replace("127.0.0.1", "LocalHost")
    assert url != settings.s3_internal_url

    async def run() -> None:
        async with open_storage(settings.model_copy(update={"s3_internal_url": url})) as storage:
            await storage.check()

    asyncio.run(run())


def test_a_certificate_that_nobody_vouches_for_is_refused(tmp_path: Path) -> None:
    certificate = make_certificate(tmp_path, "127.0.0.1")
    with _store([_DONE], certificate) as (settings, seen):
        assert "KLEINKRAM_S3_CA_FILE" in _unavailable(settings, lambda store: store.check())
        assert seen == []
        settings = settings.model_copy(update={"s3_ca_file": certificate[0]})
        assert _ask(settings, S3Request("POST", "a", {"uploads": ""})) == "7"


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"s3_bucket": "nowhere"}, "there is no bucket 'nowhere': create it, or correct KLEINKRAM_S3_BUCKET"),
        ({"s3_access_key": "nobody"}, "it does not know the access key: correct KLEINKRAM_S3_ACCESS_KEY"),
        ({"s3_secret_key": SecretStr("x")}, "the secret key does not fit the access key: correct KLEINKRAM_S3_SECRET"),
    ],
)
def test_a_wrong_bucket_or_key_is_named(api: Api, changed: dict[str, object], sentence: str) -> None:
    settings = api.app.state.settings.model_copy(update=changed)

    async def check() -> None:
        async with open_storage(settings) as storage:
            await storage.check()

    with pytest.raises(StoreUnavailable) as raised:
        asyncio.run(check())
    assert sentence in str(raised.value)
    assert "does not answer" not in str(raised.value)


def test_an_api_that_cannot_start_says_why_in_one_line(api: Api) -> None:
    settings = api.app.state.settings
    environment = {
        "KLEINKRAM_DATABASE_URL": str(settings.database_url),
        "KLEINKRAM_S3_INTERNAL_URL": settings.s3_internal_url,
        "KLEINKRAM_S3_BUCKET": "nowhere",
        "KLEINKRAM_S3_ACCESS_KEY": settings.s3_access_key,
        "KLEINKRAM_S3_SECRET_KEY": settings.s3_secret_key.get_secret_value(),
    }
    command = [sys.executable, "-m", "kleinkram.server", "api", "--port", str(choose_port())]
    ran = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, check=False)
    assert ran.returncode == 3
    lines = [json.loads(line) for line in ran.stderr.splitlines()]
    assert any("not started: " in line["message"] and "there is no bucket" in line["message"] for line in lines)
    assert "Traceback" not in ran.stderr
