"""File slices arrive unchanged at any speed; a file that changed is not reported as a fault of the store."""

import contextlib
import errno
import io
import os
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from kleinkram.client.errors import FileChanged, FileUnreadable
from kleinkram.client.transfer import store
from kleinkram.client.transfer.plan import SLICE_BYTES, LocalFile, OpenFile, identity_of
from kleinkram.client.transfer.store import PutResult, StoreAnswer, StoreClient
from tests.certificate import make_certificate

Pause = Callable[[], None]
_SLICES = 10  # more than the kernel's buffers hold


class Taker:
    """A store that takes one PUT a connection, at its own pace."""

    def __init__(self, pause: Pause) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 32 * 1024)
        self.url = f"http://127.0.0.1:{self.listener.getsockname()[1]}/bucket/key"
        self.body = b""
        self._pause = pause
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        # The client may leave in the middle: some of the tests are about that.
        with contextlib.suppress(OSError), self.listener.accept()[0] as connection, connection.makefile("rb") as stream:
            length = 0
            while line := stream.readline().strip():
                name, _, value = line.partition(b":")
                length = int(value) if name.lower() == b"content-length" else length
            while len(self.body) < length and (piece := stream.read(min(3_000_000, length - len(self.body)))):
                self.body += piece
                self._pause()
            connection.sendall(b'HTTP/1.1 200 OK\r\nETag: "e"\r\nContent-Length: 0\r\n\r\n')


@pytest.fixture
def source(tmp_path: Path) -> Iterator[OpenFile]:
    path = tmp_path / "a.bin"
    path.write_bytes(os.urandom(_SLICES * SLICE_BYTES + 5))
    source = OpenFile(LocalFile(path, "a.bin", identity_of(path.stat())))
    yield source
    source.close()


_TAKEN = b'HTTP/1.1 200 OK\r\nETag: "e"\r\nContent-Length: 0\r\n\r\n'


class Scripted:
    """A store that gives one answer after the other, over as few connections as it is asked by."""

    def __init__(self, *answers: bytes, tls: ssl.SSLContext | None = None) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        if tls:
            self.listener = tls.wrap_socket(self.listener, server_side=True)
        self.url = (
            f"{'https' if tls else 'http'}://127.0.0.1:{self.listener.getsockname()[1]}/bucket/key?X-Amz-Signature=ab"
        )
        self.connections = 0
        self.requests: list[bytes] = []
        self._answers = [*answers]
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while self._answers:
                with self.listener.accept()[0] as connection, connection.makefile("rb") as stream:
                    self.connections += 1
                    self._converse(connection, stream)

    def _converse(self, connection: socket.socket, stream: io.BufferedReader) -> None:
        while self._answers and (line := stream.readline()):
            self.requests.append(line)
            while (line := stream.readline()) != b"\r\n":
                self.requests[-1] += line
            self.requests[-1] += stream.read(4)
            answer = self._answers.pop(0)
            middle = answer.find(b"|")  # there it comes in two pieces
            connection.sendall(answer[: max(middle, 0)])
            connection.sendall(answer[middle + 1 :])
            if b"close" in answer:
                return


def put_each(*answers: bytes) -> tuple[list[PutResult], Scripted]:
    """PUT four bytes for each answer, one after the other by one client."""
    store, client = Scripted(*answers), StoreClient(1)
    try:
        return [client.put(store.url, {"X-Checksum": "1"}, 4, [b"abcd"]) for _ in answers], store
    finally:
        client.close()
        store.listener.close()


def wait_for(event: threading.Event, seconds: float) -> None:
    event.wait(seconds)


def put(source: OpenFile, pause: Pause = lambda: None) -> tuple[PutResult, bytes]:
    taker, client = Taker(pause), StoreClient(1)
    try:
        length = _SLICES * SLICE_BYTES
        answer = client.put(taker.url, {}, length, source.file_slices(5, length))
        return answer, taker.body
    finally:
        client.close()
        taker.listener.close()


def test_the_kernel_sends_the_bytes(source: OpenFile) -> None:
    answer, body = put(source)
    assert answer == PutResult(StoreAnswer.taken, etag="e")
    assert body == source.file.source.read_bytes()[5:]


def test_bytes_are_read_where_sendfile_is_unavailable(source: OpenFile, monkeypatch: pytest.MonkeyPatch) -> None:
    def cannot(*_: object) -> int:
        raise OSError(errno.EINVAL, "not this file system")

    monkeypatch.setattr(os, "sendfile", cannot)
    assert put(source)[1] == source.file.source.read_bytes()[5:]


def test_a_put_is_not_limited_by_the_connect_timeout(source: OpenFile, monkeypatch: pytest.MonkeyPatch) -> None:
    waited = threading.Event()  # never set: waiting for it is the store's slowness
    monkeypatch.setattr(store, "CONNECT_TIMEOUT_S", 0.05)
    answer, body = put(source, pause=lambda: wait_for(waited, 0.3))
    assert answer.answer is StoreAnswer.taken, answer.why
    assert body == source.file.source.read_bytes()[5:]


def test_a_put_to_a_store_that_reads_nothing_times_out(source: OpenFile, monkeypatch: pytest.MonkeyPatch) -> None:
    released = threading.Event()
    monkeypatch.setattr(store, "READ_TIMEOUT_S", 0.2)
    answer, _ = put(source, pause=lambda: wait_for(released, 20))
    released.set()
    assert answer.answer is StoreAnswer.try_again


def test_a_file_that_became_shorter_is_reported(source: OpenFile) -> None:
    os.truncate(source.file.source, SLICE_BYTES)
    with pytest.raises(FileChanged):
        put(source)


def test_a_failing_disk_is_reported(source: OpenFile, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> int:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "sendfile", fails)
    monkeypatch.setattr(os, "preadv", fails)
    with pytest.raises(FileUnreadable):
        put(source)


def test_several_puts_share_one_connection() -> None:
    answers, store = put_each(_TAKEN, _TAKEN, _TAKEN)
    assert answers == [PutResult(StoreAnswer.taken, etag="e")] * 3
    assert store.connections == 1
    host = store.url.split("/")[2].encode()
    head = b"PUT /bucket/key?X-Amz-Signature=ab HTTP/1.1\r\nHost: " + host
    assert [requests.startswith(head) and requests.endswith(b"abcd") for requests in store.requests] == [True] * 3
    assert b"\r\nX-Checksum: 1\r\n" in store.requests[0]
    assert b"\r\nContent-Length: 4\r\n" in store.requests[0]


_BUSY = b"<Error><Code>SlowDown</Code></Error>"


@pytest.mark.parametrize(
    ("reply", "expected"),
    [
        (b"HTTP/1.1 503 Busy\r\nContent-Length: %d\r\n\r\n%b" % (len(_BUSY), _BUSY), "503 SlowDown"),
        (b"HTTP/1.1 503 Busy\r\nTransfer-Encoding: chunked\r\n\r\n24\r\n%b\r\n0\r\n\r\n" % _BUSY, "503 SlowDown"),
        (b"HTTP/1.1 200 OK\r\nETag: e\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", None),
        (b"HTTP/1.1 200 OK\r\nETag: e\r\nContent-Length: 3\r\n\r\nabc", None),
        (b"HTTP/1.1 200 OK\r\netag:e\r\nConten|t-Length: 0\r\n\r\n", None),
        (b"HTTP/1.1 100 Continue\r\n\r\n" + _TAKEN, None),
        (b"HTTP/1.1 412 Precondition Failed\r\nContent-Length: 0\r\n\r\n", None),
    ],
)
def test_the_connection_is_reused_after_any_other_response(reply: bytes, expected: str | None) -> None:
    (first, second), store = put_each(reply, _TAKEN)
    assert first.answer is (StoreAnswer.try_again if expected else StoreAnswer.taken)
    assert first.reason == (f"the store answered {expected}" if expected else "")
    assert second == PutResult(StoreAnswer.taken, etag="e")
    assert store.connections == 1


@pytest.mark.parametrize(
    "reply",
    [
        b"HTTP/1.1 200 OK\r\nConnection: close\r\nETag: e\r\nContent-Length: 0\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nConnection: close\r\nETag: e\r\n\r\n",
        b"HTTP/1.0 200 OK, and I close\r\nETag: e\r\nContent-Length: 0\r\n\r\n",
    ],
)
def test_a_connection_that_the_store_ends_is_followed_by_another(reply: bytes) -> None:
    answers, store = put_each(reply, _TAKEN)
    assert answers == [PutResult(StoreAnswer.taken, etag="e")] * 2
    assert store.connections == 2


@pytest.mark.parametrize(
    "reply", [b"close", b"rubbish, close\r\n\r\n", b"HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\nclose"]
)
def test_a_missing_answer_is_retried(reply: bytes) -> None:
    (first, second), store = put_each(reply, _TAKEN)
    assert first.answer is StoreAnswer.try_again
    assert first.why
    assert second.answer is StoreAnswer.taken
    assert store.connections == 2


def test_a_redirect_is_not_followed() -> None:
    (answer,), _ = put_each(b"HTTP/1.1 307 Elsewhere\r\nLocation: http://127.0.0.1:9/\r\nContent-Length: 0\r\n\r\n")
    assert (answer.answer, answer.reason) == (StoreAnswer.refused, "the store answered 307")


@pytest.mark.parametrize(
    ("target", "headers"),
    [("a b", {}), ("a\r\nX: y", {}), ("a", {"X\r\nY": "z"}), ("a", {"X": "y\r\nZ: z"}), ("a", {"X": "\u00fc"})],
)
def test_header_injection_is_refused(target: str, headers: dict[str, str]) -> None:
    store, client = Scripted(_TAKEN), StoreClient(1)
    try:
        with pytest.raises(ValueError, match="would be read as another"):
            client.put(store.url.replace("key", target), headers, 4, [b"abcd"])
    finally:
        client.close()
        store.listener.close()
    assert store.requests == []


@pytest.mark.parametrize("is_known", [True, False])
def test_a_put_requires_a_trusted_certificate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_known: bool) -> None:
    certificate, key = make_certificate(tmp_path, "127.0.0.1")
    tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    tls.load_cert_chain(certificate, key)
    if is_known:
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    file = tmp_path / "a.bin"
    file.write_bytes(b"abcd")
    source = OpenFile(LocalFile(file, "a.bin", identity_of(file.stat())))
    store, client = Scripted(_TAKEN, _TAKEN, tls=tls), StoreClient(1)
    try:
        answers = [client.put(store.url, {}, 4, source.file_slices(0, 4)) for _ in range(2)]
    finally:
        source.close()
        client.close()
        store.listener.close()
    if is_known:
        assert answers == [PutResult(StoreAnswer.taken, etag="e")] * 2
        assert [requests[-4:] for requests in store.requests] == [b"abcd"] * 2
    else:
        assert [answer.answer for answer in answers] == [StoreAnswer.try_again] * 2
        assert "certificate" in answers[0].why
        assert store.requests == []
