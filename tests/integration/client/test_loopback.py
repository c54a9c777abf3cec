"""The loopback port of a login accepts only the browser of that login."""

import socket
from collections.abc import Iterator

import pytest
import urllib3

from kleinkram.client.sign_in import Loopback
from kleinkram.contract.errors import SignInDenied, SignInExpired

STATE = "a-secret-state"


@pytest.fixture
def loopback() -> Iterator[Loopback]:
    with Loopback(STATE) as waiting:
        yield waiting


def visit(loopback: Loopback, target: str) -> urllib3.BaseHTTPResponse:
    with urllib3.PoolManager(retries=False, timeout=5) as pool:
        return pool.request("GET", f"http://127.0.0.1:{loopback.port}{target}")


def test_the_code_is_received_and_the_browser_shows_the_result(loopback: Loopback) -> None:
    answer = visit(loopback, f"/?code=the-code&state={STATE}")
    assert loopback.wait(5) == "the-code"
    assert answer.status == 200
    assert "terminal" in answer.data.decode()
    assert "the-code" not in answer.data.decode()
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert "default-src 'none'" in answer.headers["Content-Security-Policy"]


@pytest.mark.parametrize(
    ("target", "status"),
    [
        ("/?code=stolen&state=guessed", 400),
        ("/?code=stolen", 400),
        ("/?error=denied&state=", 400),
        ("/?code=stolen&state=%C3%BC%00%FF", 400),
        (f"/favicon.ico?code=x&state={STATE}", 404),
        ("/", 400),
    ],
)
def test_requests_without_the_state_are_rejected(loopback: Loopback, target: str, status: int) -> None:
    assert visit(loopback, target).status == status
    visit(loopback, f"/?code=right&state={STATE}")
    assert loopback.wait(5) == "right"


def test_a_refusal_raises_sign_in_denied(loopback: Loopback) -> None:
    assert visit(loopback, f"/?error=denied&state={STATE}").status == 200
    with pytest.raises(SignInDenied):
        loopback.wait(5)


def test_a_silent_connection_does_not_block_others(loopback: Loopback) -> None:
    with socket.create_connection(("127.0.0.1", loopback.port)):
        visit(loopback, f"/?code=right&state={STATE}")
        assert loopback.wait(5) == "right"


def test_waiting_for_the_browser_ends(loopback: Loopback) -> None:
    with pytest.raises(SignInExpired):
        loopback.wait(0.01)


def test_the_port_is_closed_after_the_login() -> None:
    with Loopback(STATE) as waiting:
        port = waiting.port
    with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port)):
        pass
