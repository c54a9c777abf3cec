"""Getting a token: requests, polling interval, and errors."""

import base64
import datetime
import hashlib
import threading
import uuid
from urllib.parse import parse_qs, urlsplit

import pytest
import urllib3

from kleinkram.client.config import Endpoint, EndpointSource
from kleinkram.client.errors import AnswerNotUnderstood, ServerUnreachable
from kleinkram.client.sign_in import begin_browser, begin_device, check_server, end_token, wait_for_device, who_has
from kleinkram.contract.access import Scope
from kleinkram.contract.accounts import CredentialKind, CredentialRead, DeviceCode, MeRead, SignedIn
from kleinkram.contract.errors import (
    KleinkramError,
    NotAuthenticated,
    RateLimited,
    SignInDenied,
    SignInExpired,
    SignInPending,
    SlowDown,
)
from kleinkram.contract.people import PersonRef
from tests.scripted_server import scripted

ADA = PersonRef(id=uuid.uuid4(), name="Ada")
SIGNED_IN = SignedIn(token="t" * 30, person=ADA, expires_at=datetime.datetime(2030, 1, 1, tzinfo=datetime.timezone.utc))
CODE = DeviceCode(
    device_code="d" * 30,
    user_code="BCDF-GHJK",
    verification_url="http://x/sign-in/device",
    verification_url_complete="http://x/sign-in/device?user_code=BCDF-GHJK",
    interval_s=5,
    expires_s=60,
)
ME = MeRead.model_validate(
    {
        "person": ADA,
        "emails": ["ada@lab.example"],
        "groups": [],
        "is_admin": False,
        "credential": CredentialRead(
            id=uuid.uuid4(),
            kind=CredentialKind.personal,
            name="laptop",
            scopes=[Scope.write],
            is_limited=False,
            expires_at=None,
        ),
    }
)


def test_a_device_code_is_requested_without_a_token() -> None:
    with scripted(CODE) as server:
        assert begin_device(server.url, "klein on anymal-3") == CODE
    (request,) = server.requests
    assert (request.method, request.path, request.authorization) == ("POST", "/api/v1/auth/device", None)
    assert request.body == {"client": "klein on anymal-3"}


def test_polling_waits_for_the_requested_interval() -> None:
    waited: list[float] = []
    limited = RateLimited(what="sign-ins", limit=10, window_s=60, retry_after_s=7)
    answers = [
        SignInPending(interval_s=5),
        SlowDown(interval_s=10),
        SignInPending(interval_s=5),
        limited,
        None,
        SIGNED_IN,
    ]
    with scripted(*answers) as server:
        assert wait_for_device(server.url, CODE, waited.append) == SIGNED_IN
    assert waited == [5, 5, 10, 10, 7, 10, 20], "longer after SlowDown, and while the server does not answer"
    assert {(request.path, request.body["device_code"]) for request in server.requests} == {
        ("/api/v1/auth/device/token", CODE.device_code)
    }


@pytest.mark.parametrize("refusal", [SignInDenied(), SignInExpired()])
def test_a_refusal_ends_the_waiting(refusal: KleinkramError) -> None:
    with scripted(SignInPending(interval_s=5), refusal) as server, pytest.raises(type(refusal)):
        wait_for_device(server.url, CODE, lambda _: None)
    assert len(server.requests) == 2


def test_waiting_for_a_device_code_ends() -> None:
    waited: list[float] = []
    with scripted(*[SignInPending(interval_s=5)] * 20) as server, pytest.raises(SignInExpired):
        wait_for_device(server.url, CODE, waited.append)
    assert sum(waited) == CODE.expires_s


def test_the_code_of_a_browser_login_requires_the_verifier_of_this_process() -> None:
    with scripted(SIGNED_IN) as server, begin_browser(f"{server.url}/", "klein on anymal-3") as waiting:
        page = urlsplit(waiting.url)
        query = {name: value for name, (value,) in parse_qs(page.query).items()}
        assert f"{page.scheme}://{page.netloc}{page.path}" == f"{server.url}/sign-in/cli"
        assert query["client"] == "klein on anymal-3"
        visit = f"http://127.0.0.1:{query['port']}/?code={'c' * 30}&state={query['state']}"
        with urllib3.PoolManager(retries=False, timeout=5) as pool:
            browser = threading.Thread(target=lambda: pool.request("GET", visit))
            browser.start()
            assert waiting.wait(10) == SIGNED_IN
            browser.join()
    (request,) = server.requests
    digest = hashlib.sha256(request.body["code_verifier"].encode()).digest()
    assert base64.urlsafe_b64encode(digest).decode().rstrip("=") == query["code_challenge"]
    assert request.body["code"] == "c" * 30
    assert request.body["code_verifier"] not in waiting.url
    assert request.body["code_verifier"] not in repr(waiting)


def test_no_two_logins_have_the_same_secrets() -> None:
    with begin_browser("http://lab", "klein") as one, begin_browser("http://lab", "klein") as other:
        answers = [parse_qs(urlsplit(login.url).query) for login in (one, other)]
    for name in ("state", "code_challenge", "port"):
        assert answers[0][name] != answers[1][name]


def test_a_token_passed_to_login_is_tried() -> None:
    with scripted(ME) as server:
        assert who_has(server.url, "brought") == ME
    assert (server.requests[0].path, server.requests[0].authorization) == ("/api/v1/me", "Bearer brought")


def test_a_refused_token_explains_how_to_get_another(monkeypatch: pytest.MonkeyPatch) -> None:
    refusal = NotAuthenticated(reason="the token is not valid here")
    monkeypatch.delenv("KLEINKRAM_TOKEN", raising=False)
    with scripted(refusal, refusal) as server:
        with pytest.raises(NotAuthenticated, match=f"`klein login {server.url}`") as refused:
            who_has(server.url, "brought")
        assert "KLEINKRAM_TOKEN" not in str(refused.value)
        monkeypatch.setenv("KLEINKRAM_TOKEN", "brought")
        with pytest.raises(NotAuthenticated, match="KLEINKRAM_TOKEN"):
            who_has(server.url, "brought")


def test_ending_a_token_revokes_only_that_token() -> None:
    with scripted(ME, b"") as server:
        assert end_token(server.url, "mine") is True
    assert [(request.method, request.path) for request in server.requests] == [
        ("GET", "/api/v1/me"),
        ("DELETE", f"/api/v1/tokens/{ME.credential.id}?made=valid"),
    ]
    assert {request.authorization for request in server.requests} == {"Bearer mine"}


def test_ending_an_invalid_token_does_nothing() -> None:
    with scripted(NotAuthenticated(reason="the token is not valid here")) as server:
        assert end_token(server.url, "mine") is False


def test_only_a_kleinkram_server_is_accepted() -> None:
    with scripted(NotAuthenticated(reason="the request has no bearer token")) as server:
        check_server(server.url)
    with scripted(b"<html>a printer</html>") as printer, pytest.raises(AnswerNotUnderstood):
        check_server(printer.url)
    with pytest.raises(ServerUnreachable):
        begin_device(printer.url, "klein")
    with (
        scripted(ME, (502, b"<html>Bad Gateway</html>")) as proxy,
        pytest.raises(ServerUnreachable, match=r"what stands before it says 502"),
    ):
        end_token(proxy.url, "mine")


def test_a_token_is_not_in_what_is_printed() -> None:
    assert "secret" not in repr(Endpoint("lab", "https://lab", "secret", EndpointSource.chosen))
