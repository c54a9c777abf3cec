"""Memory, time and number of unauthenticated connections are bounded."""

import ipaddress
import resource
import socket
import time
from contextlib import ExitStack
from typing import cast
from urllib.parse import urlsplit

import psutil
import pytest

from kleinkram.server.http import uvicorn_server
from kleinkram.server.http.uvicorn_server import LimitedHttp, OpenConnections
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi

_POST = b"POST /api/v1/auth/password HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
_BEGUN_BODY = _POST + b"Content-Length: 60000\r\n\r\n{"
_CHUNKED = _POST + b"Transfer-Encoding: chunked\r\n\r\n"
_LIVE = b"GET /health/live HTTP/1.1\r\nHost: x\r\n\r\n"


def _connect(api: Api) -> socket.socket:
    parts = urlsplit(api.url)
    return socket.create_connection((parts.hostname or "", parts.port or 0), timeout=20)


def test_a_head_without_end_is_cut_off(api: Api) -> None:
    with _connect(api) as connection:
        connection.sendall(b"GET /health/live HTTP/1.1\r\nHost: x\r\nX-Much: ")
        with pytest.raises(ConnectionError):
            connection.sendall(b"a" * 100_000_000)


def test_a_request_with_too_large_headers_is_refused(api: Api) -> None:
    with _connect(api) as connection:
        connection.sendall(b"GET /health/live HTTP/1.1\r\nHost: x\r\nX-Much: " + b"a" * (64 * 1024))
        assert connection.recv(100).startswith(b"HTTP/1.1 431 ")


def test_many_allowed_heads_on_one_connection_are_read(api: Api) -> None:
    request = b"GET /health/live HTTP/1.1\r\nHost: x\r\nX-Much: " + b"a" * 40_000 + b"\r\n\r\n"
    with _connect(api) as connection:
        for _ in range(3):
            connection.sendall(request)
            answer = b""
            while not answer.endswith(b"\r\n\r\nlive\n"):  # head and body may arrive in two packets
                received = connection.recv(100_000)
                assert received
                answer += received
            assert answer.startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize("begun", [b"", b"GET /health/live HTTP/1.1\r\nHost:"])
def test_an_incomplete_head_times_out(api: Api, begun: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uvicorn_server, "_HEAD_TIMEOUT_S", 0.2)
    with _connect(api) as connection:
        connection.sendall(begun)
        assert connection.recv(100) == b""


@pytest.mark.parametrize(
    "begun",
    [
        pytest.param(_CHUNKED + b"2\r\n{}\r\n0\r\nX-Trailer: ", id="trailer"),
        pytest.param(_CHUNKED + b"2;extension=", id="chunk extension"),
        pytest.param(_CHUNKED + b"2\r\n{}\r\n0;extension=", id="extension of the last chunk"),
    ],
)
def test_oversized_chunk_framing_is_cut_off(api: Api, begun: bytes) -> None:
    before = psutil.Process().memory_info().rss
    with _connect(api) as connection:
        connection.sendall(begun)
        with pytest.raises(ConnectionError):
            connection.sendall(b"a" * 100_000_000)
    assert psutil.Process().memory_info().rss - before < 150_000_000, "what this test sends is 100 MB of it"


def test_many_small_trailers_are_cut_off(api: Api) -> None:
    with _connect(api) as connection:
        connection.sendall(_CHUNKED + b"2\r\n{}\r\n0\r\n")
        with pytest.raises(ConnectionError):
            connection.sendall(b"X-Trailer: 1\r\n" * 4_000_000)


def test_chunk_extensions_that_outweigh_the_body_are_cut_off(api: Api) -> None:
    with _connect(api) as connection:
        connection.sendall(_CHUNKED)
        with pytest.raises(ConnectionError):
            connection.sendall((b"1;e=" + b"a" * 1000 + b"\r\n \r\n") * 60_000)


def test_a_body_in_chunks_of_one_byte_is_read(api: Api) -> None:
    body = b"".join(b"1;e=1\r\n%c\r\n" % byte for byte in b'{"email": "nobody@example.org", "password": "none"}')
    with _connect(api) as connection:
        connection.sendall(_CHUNKED + body + b"0\r\nX-Trailer: 1\r\n\r\n")
        assert connection.recv(100).startswith(b"HTTP/1.1 401 ")


def test_trailers_are_not_headers(api: Api) -> None:
    """A proxy that we trust may pass on trailers, whose content is the client's."""
    with _connect(api) as connection:
        connection.sendall(
            b"POST /api/v1/projects HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
            b"Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n"
            b"Authorization: Bearer " + (api.token or "").encode() + b"\r\n\r\n"
        )
        assert connection.recv(100).startswith(b"HTTP/1.1 401 ")


def test_a_slow_body_times_out(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uvicorn_server, "_BODY_TIMEOUT_S", 0.2)
    with _connect(api) as connection:
        connection.sendall(_BEGUN_BODY)
        assert connection.recv(100).startswith(b"HTTP/1.1 408 ")


def test_a_body_that_is_fast_enough_may_take_longer(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uvicorn_server, "_BODY_TIMEOUT_S", 0.3)
    monkeypatch.setattr(uvicorn_server, "_BODY_BYTES_PER_S", 40_000)
    with _connect(api) as connection:
        connection.sendall(_BEGUN_BODY)
        began = time.monotonic()
        for _ in range(6):
            connection.sendall(b" " * 9_999)
        assert connection.recv(100).startswith(b"HTTP/1.1 4"), "it is no JSON, or its time is over"
        assert time.monotonic() - began > 1


def test_the_connection_of_a_refused_body_is_closed_soon(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uvicorn_server, "_LINGER_S", 0.2)
    too_large = _BEGUN_BODY.replace(b"60000", b"600000000")
    with _connect(api) as connection:
        connection.sendall(too_large)
        assert connection.recv(10_000).startswith(b"HTTP/1.1 413 ")
        while connection.recv(10_000):
            pass


def test_empty_lines_keep_no_connection_open(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uvicorn_server, "_HEAD_TIMEOUT_S", 2.0)
    with _connect(api) as connection:
        connection.sendall(_LIVE)
        # Its head and its body may arrive one after the other.
        response = connection.recv(10_000)
        while not response.endswith(b"live\n"):
            response += connection.recv(10_000)
        assert response.startswith(b"HTTP/1.1 200 ")
        connection.sendall(b"\r\n")
        assert connection.recv(100) == b""


def test_incomplete_bodies_do_not_lock_others_out(start_api: StartApi) -> None:
    api = start_api(connections_per_address=16)
    with ExitStack() as stack:
        attackers = [stack.enter_context(_connect(api)) for _ in range(40)]
        for attacker in attackers:
            attacker.sendall(_BEGUN_BODY)
        with _connect(api) as connection:
            connection.sendall(_LIVE)
            assert connection.recv(100).startswith(b"HTTP/1.1 200 ")
        assert attackers[0].recv(100)[:13] in {b"HTTP/1.1 408 ", b""}


def test_connections_with_a_response_in_progress_are_not_replaced(start_api: StartApi) -> None:
    api = start_api(connections_per_address=16)
    stream = f"GET /api/v1/events HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {api.token}\r\n\r\n".encode()
    with ExitStack() as stack:
        streams = [stack.enter_context(_connect(api)) for _ in range(16)]
        for connection in streams:
            connection.sendall(stream)
            assert connection.recv(100).startswith(b"HTTP/1.1 200 ")
        with _connect(api) as one_more:
            assert one_more.recv(100).startswith(b"HTTP/1.1 503 ")
        streams[0].close()
        deadline = time.monotonic() + 60
        while not _is_alive(api):
            assert time.monotonic() < deadline


def _is_alive(api: Api) -> bool:
    with _connect(api) as connection:
        connection.sendall(_LIVE)
        try:
            return connection.recv(100).startswith(b"HTTP/1.1 200 ")
        except ConnectionError:
            return False


class _Connection:
    """A connection, as far as counting goes."""

    is_receiving = False

    def refuse(self, status: int) -> None:
        """Note nothing."""


def _count(connections: OpenConnections, peer: str, *, most: int) -> int:
    return sum(connections.add(cast("LimitedHttp", _Connection()), peer) for _ in range(most))


def test_connections_are_counted_by_address() -> None:
    connections = OpenConnections(per_address=3, total=100, unlimited=[ipaddress.ip_network("10.0.0.0/8")])
    assert _count(connections, "192.0.2.1", most=5) == 3
    assert _count(connections, "::ffff:192.0.2.1", most=5) == 0, "the same address, written as IPv6"
    assert _count(connections, "192.0.2.2", most=5) == 3
    assert _count(connections, "2001:db8::1", most=2) == 2
    assert _count(connections, "2001:db8::2", most=2) == 1, "of the same network, which is one subscriber's"
    assert _count(connections, "2001:db8:0:1::2", most=5) == 3
    assert _count(connections, "10.1.2.3", most=50) == 50, "a trusted proxy"


def test_the_total_of_connections_is_limited() -> None:
    connections = OpenConnections(per_address=3, total=5)
    assert [_count(connections, f"192.0.2.{number}", most=3) for number in range(3)] == [3, 2, 0]


def test_a_closed_connection_is_not_counted() -> None:
    connections = OpenConnections(per_address=1, total=1)
    one = cast("LimitedHttp", _Connection())
    for _ in range(3):
        assert connections.add(one, "192.0.2.1")
        connections.remove(one)


def test_the_soft_limit_of_open_files_is_raised() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(soft, 1024), hard))
        assert uvicorn_server.raise_open_files_limit() == hard
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == (hard, hard)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
