"""Slices of files arrive as they are, however sent, and slowly too; a file that changed is no fault of the store."""

import contextlib
import errno
import os
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from kleinkram.client.errors import FileChanged, FileUnreadable
from kleinkram.client.transfer import _connections
from kleinkram.client.transfer._source import SLICE_BYTES, Source
from kleinkram.client.transfer._store import Answer, PutAnswer, StoreDoor
from kleinkram.client.transfer.plan import LocalFile, identity_of

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
def source(tmp_path: Path) -> Iterator[Source]:
    path = tmp_path / "a.bin"
    path.write_bytes(os.urandom(_SLICES * SLICE_BYTES + 5))
    source = Source(LocalFile(path, "a.bin", identity_of(path.stat())))
    yield source
    source.close()


def wait_for(event: threading.Event, seconds: float) -> None:
    event.wait(seconds)


def put(source: Source, pause: Pause = lambda: None) -> tuple[PutAnswer, bytes]:
    taker, door = Taker(pause), StoreDoor(1)
    try:
        length = _SLICES * SLICE_BYTES
        answer = door.put(taker.url, {}, length, source.stretches(5, length))
        return answer, taker.body
    finally:
        door.close()
        taker.listener.close()


def test_the_kernel_sends_the_bytes(source: Source) -> None:
    answer, body = put(source)
    assert answer == PutAnswer(Answer.taken, etag="e")
    assert body == source.file.source.read_bytes()[5:]


def test_where_the_kernel_cannot_the_bytes_are_read(source: Source, monkeypatch: pytest.MonkeyPatch) -> None:
    def cannot(*_: object) -> int:
        raise OSError(errno.EINVAL, "not this file system")

    monkeypatch.setattr(os, "sendfile", cannot)
    assert put(source)[1] == source.file.source.read_bytes()[5:]


def test_a_slow_store_has_more_time_than_connecting_has(source: Source, monkeypatch: pytest.MonkeyPatch) -> None:
    waited = threading.Event()  # never set: waiting for it is the store's slowness
    monkeypatch.setattr(_connections, "CONNECT_TIMEOUT_S", 0.05)
    answer, body = put(source, pause=lambda: wait_for(waited, 0.3))
    assert answer.answer is Answer.taken, answer.why
    assert body == source.file.source.read_bytes()[5:]


def test_a_store_that_takes_nothing_is_left_after_a_while(source: Source, monkeypatch: pytest.MonkeyPatch) -> None:
    released = threading.Event()
    monkeypatch.setattr(_connections, "READ_TIMEOUT_S", 0.2)
    answer, _ = put(source, pause=lambda: wait_for(released, 20))
    released.set()
    assert answer.answer is Answer.try_again


def test_a_file_that_became_shorter_is_told_as_such(source: Source) -> None:
    os.truncate(source.file.source, SLICE_BYTES)
    with pytest.raises(FileChanged):
        put(source)


def test_a_disk_that_fails_is_told_as_such(source: Source, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> int:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "sendfile", fails)
    monkeypatch.setattr(os, "preadv", fails)
    with pytest.raises(FileUnreadable):
        put(source)
