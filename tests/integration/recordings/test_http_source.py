"""Reading by HTTP ranges from a server that sometimes fails."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from kleinkram.recordings import (
    FailureKind,
    FileSource,
    Recording,
    SourceError,
    SummaryFailed,
    http_source,
    summarise,
)
from kleinkram.recordings.http_source import ATTEMPTS, HttpSource
from kleinkram.recordings.isolation import UrlRequest, summarise_isolated
from kleinkram.recordings.limits import PARALLEL_READS
from kleinkram.recordings.sample import generate_bag, generate_mcap
from tests.http_server import PersistentHandler, serving

DATA = bytes(range(256)) * 40
SECRET = "X-Amz-Signature=hunter2"


@dataclass
class Store:
    """What the server serves, and how its next answers go wrong: one word each."""

    data: bytes = DATA
    mishaps: list[str] = field(default_factory=list)
    requests: int = 0
    connections: int = 0
    port: int = 0
    hung_up: threading.Event = field(default_factory=threading.Event)

    def source(self, size_bytes: int | None = None) -> HttpSource:
        return HttpSource(self.url, size_bytes=size_bytes or len(self.data), name="drive.mcap")

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/bucket/key?{SECRET}"


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
    monkeypatch.setattr(http_source, "FIRST_PAUSE_S", 0)
    state = Store()

    class Handler(PersistentHandler):
        def setup(self) -> None:
            state.connections += 1
            super().setup()

        def do_GET(self) -> None:
            state.requests += 1
            match = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers["Range"])
            assert match is not None
            first, last = int(match[1]), int(match[2])
            mishap = state.mishaps.pop(0) if state.mishaps else ""
            body = state.data[first : last + 1] + (b"HTTP/1.1 206" if mishap == "more" else b"")
            status = int(mishap) if mishap.isdigit() else 206
            shown = first + 1 if mishap == "other range" else first
            self.send_response(status)
            self.send_header("Content-Range", f"bytes {shown}-{last}/{len(state.data)}")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body[: len(body) // 2] if mishap == "cut" else body)
            self.wfile.flush()
            if mishap in ("cut", "hangs up"):
                self.close_connection = True
                self.connection.shutdown(socket.SHUT_RDWR)
                state.hung_up.set()

    with serving(Handler) as state.port:
        yield state


def test_reads_exactly_the_requested_bytes(store: Store) -> None:
    source = store.source()
    assert source.read(300, 700) == DATA[300:1000]
    assert source.read(len(DATA) - 1, 1) == DATA[-1:]
    assert source.read(5, 0) == b""
    assert (source.bytes_read, source.reads, store.requests) == (701, 2, 2)


@pytest.mark.parametrize("mishap", ["500", "503", "429", "cut"])
def test_a_temporary_fault_is_retried(store: Store, mishap: str) -> None:
    store.mishaps = [mishap] * (ATTEMPTS - 1)
    assert store.source().read(0, 100) == DATA[:100]
    assert store.requests == ATTEMPTS


@pytest.mark.parametrize(("mishap", "says"), [("500", "answered 500"), ("cut", "127.0.0.1")])
def test_a_persistent_fault_is_an_error(store: Store, mishap: str, says: str) -> None:
    store.mishaps = [mishap] * ATTEMPTS
    with pytest.raises(SourceError, match=says) as caught:
        store.source().read(0, 100)
    assert "hunter2" not in str(caught.value)


@pytest.mark.parametrize(
    ("mishap", "says"), [("403", "with 403"), ("404", "with 404"), ("200", "ignores range"), ("302", "with 302")]
)
def test_a_refusal_is_not_tried_again(store: Store, mishap: str, says: str) -> None:
    store.mishaps = [mishap]
    with pytest.raises(SourceError, match=says):
        store.source().read(0, 100)
    assert store.requests == 1


def test_another_range_or_another_size_is_refused(store: Store) -> None:
    store.mishaps = ["other range"]
    with pytest.raises(SourceError, match="where 'bytes 0-99/10240' was requested"):
        store.source().read(0, 100)
    with pytest.raises(SourceError, match="where 'bytes 0-99/9999' was requested"):
        store.source(size_bytes=9_999).read(0, 100)


def test_one_connection_serves_all_reads_of_a_thread(store: Store) -> None:
    source = store.source()
    for offset in range(0, 2_000, 100):
        assert source.read(offset, 100) == DATA[offset : offset + 100]
    assert (store.requests, store.connections) == (20, 1)


def test_a_dropped_idle_connection_is_not_used_again(store: Store) -> None:
    source = store.source()
    store.mishaps = ["hangs up"]
    assert source.read(0, 100) == DATA[:100]
    assert store.hung_up.wait(10)
    assert source.read(100, 100) == DATA[100:200]
    assert (store.requests, store.connections) == (2, 2)


def test_unread_bytes_of_a_response_are_not_taken_for_the_next(store: Store) -> None:
    source = store.source()
    store.mishaps = ["more"]
    assert source.read(0, 100) == DATA[:100]
    assert source.read(100, 100) == DATA[100:200]
    assert store.connections == 2


@pytest.mark.parametrize("mishap", ["", "503", "cut", "hangs up", "more"])
def test_short_ranges_come_in_their_order(store: Store, mishap: str) -> None:
    source = store.source()
    store.mishaps = ["", "", mishap, "", mishap]
    ranges = [(offset, 0 if offset == 700 else 90) for offset in range(0, 5_000, 100)]
    assert list(source.read_short(ranges)) == [DATA[offset : offset + length] for offset, length in ranges]
    assert (source.reads, source.bytes_read) == (49, 49 * 90)
    assert store.connections <= PARALLEL_READS + 2


@pytest.mark.parametrize(
    ("mishaps", "says"), [(["", "404"], "with 404"), (["503"] * (PARALLEL_READS + ATTEMPTS), "answered 503")]
)
def test_failures_of_short_ranges_are_reported(store: Store, mishaps: list[str], says: str) -> None:
    store.mishaps = mishaps
    with pytest.raises(SourceError, match=says):
        list(store.source().read_short((offset, 100) for offset in range(0, 5_000, 100)))


def test_unused_requests_ahead_are_abandoned(store: Store) -> None:
    source = store.source()
    for data in source.read_short((offset, 100) for offset in range(0, 5_000, 100)):
        assert data == DATA[:100]
        break
    assert source.read(4_000, 100) == DATA[4_000:4_100]


def test_ranges_end_with_the_file(store: Store) -> None:
    for offset, length in ((0, len(DATA) + 1), (-1, 10), (0, 17 * 2**20)):
        with pytest.raises(SourceError):
            store.source().read(offset, length)
    assert store.requests == 0


def test_a_summary_over_http_is_that_of_the_file(store: Store, tmp_path: Path) -> None:
    for truth in (
        generate_mcap(tmp_path / "drive.mcap", size_bytes=20_000_000),
        generate_bag(tmp_path / "drive.bag", size_bytes=20_000_000),
    ):
        store.data = truth.path.read_bytes()
        with FileSource(truth.path) as source:
            expected = summarise(source)
        url = UrlRequest(store.url, len(store.data), truth.path.name)
        assert summarise_isolated(url) == expected
        assert expected.bytes_read < 1_000_000


def test_a_refusal_of_the_store_is_a_source_failure(store: Store) -> None:
    store.mishaps = ["403"] * 100
    with pytest.raises(SummaryFailed, match="403") as caught:
        summarise_isolated(UrlRequest(store.url, len(DATA), "drive.mcap"))
    assert caught.value.kind is FailureKind.source
    assert "hunter2" not in str(caught.value)


def test_a_slice_survives_an_address_that_expires(store: Store, tmp_path: Path) -> None:
    generate_mcap(tmp_path / "drive.mcap", size_bytes=4_000_000, duration_s=10)
    store.data = (tmp_path / "drive.mcap").read_bytes()
    renewed: list[str] = []

    def renew() -> str:
        renewed.append(f"{store.url}&again={len(renewed)}")
        return renewed[-1]

    source = HttpSource(store.url, size_bytes=len(store.data), name="drive.mcap", renew=renew)
    with Recording.open(source) as far, Recording.open(tmp_path / "drive.mcap") as near:
        store.mishaps = ["", "403"]
        for name, recording in (("far", far), ("near", near)):
            recording.to_mcap(tmp_path / f"{name}.mcap", "/imu/data", start="+2s", end="+8s")
    assert len(renewed) == 1
    assert (tmp_path / "far.mcap").read_bytes() == (tmp_path / "near.mcap").read_bytes()
