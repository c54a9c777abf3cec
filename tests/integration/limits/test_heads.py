"""What comes before a request is bounded: nobody fills the server's memory, or keeps its connections, with a head."""

import socket
from urllib.parse import urlsplit

import pytest

from kleinkram.server import serving
from tests.integration.running import Api


def _connect(api: Api) -> socket.socket:
    parts = urlsplit(api.url)
    return socket.create_connection((parts.hostname or "", parts.port or 0), timeout=20)


def test_a_head_without_end_is_cut_off(api: Api) -> None:
    with _connect(api) as connection:
        connection.sendall(b"GET /health/live HTTP/1.1\r\nHost: x\r\nX-Much: ")
        with pytest.raises(ConnectionError):
            connection.sendall(b"a" * 100_000_000)


def test_who_sends_too_large_a_head_is_told(api: Api) -> None:
    with _connect(api) as connection:
        connection.sendall(b"GET /health/live HTTP/1.1\r\nHost: x\r\nX-Much: " + b"a" * (64 * 1024))
        assert connection.recv(100).startswith(b"HTTP/1.1 431 ")


def test_a_head_that_is_allowed_is_read_as_often_as_one_likes(api: Api) -> None:
    request = b"GET /health/live HTTP/1.1\r\nHost: x\r\nX-Much: " + b"a" * 40_000 + b"\r\n\r\n"
    with _connect(api) as connection:
        for _ in range(3):
            connection.sendall(request)
            assert connection.recv(100_000).startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize("begun", [b"", b"GET /health/live HTTP/1.1\r\nHost:"])
def test_a_head_that_never_ends_is_not_waited_for(api: Api, begun: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "_HEAD_WITHIN_S", 0.2)
    with _connect(api) as connection:
        connection.sendall(begun)
        assert connection.recv(100) == b""
