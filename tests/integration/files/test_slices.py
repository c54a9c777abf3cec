"""Slices over HTTP: the same bytes as `to_mcap`, rights, limits, and failures before and after the first bytes."""

from __future__ import annotations

import asyncio
import random
import socket
import threading
import uuid
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import urllib3

from kleinkram.recordings import Recording
from kleinkram.recordings.writing.mcap import MADE_FROM
from kleinkram.server.s3.storage import open_storage
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.fault_proxy import Middleman, ProxiedRequest, Reply, Rule, standing_before
from tests.integration.sample import Sample
from tests.integration.upload_client import wait_until
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.whole_mcap import read_whole_mcap
from tests.recording_files.writers import McapWriter
from tests.services import RunningStore

T0 = 1_700_000_000_000_000_000
SECOND = 10**9
_RANDOM = random.Random(26)
_POOL = urllib3.PoolManager(retries=False, timeout=30)


def _recording(*, messages: int = 40, message_bytes: int = 100) -> bytes:
    """Return an MCAP of two topics, with a message of each every second."""
    out = BytesIO()
    writer = McapWriter(out, profile="ros2", chunk_bytes=max(1000, 4 * message_bytes))
    schema = writer.add_schema("pkg/msg/Blob", "ros2msg", b"uint8[] data")
    channels = [writer.add_channel(topic, schema, "cdr") for topic in ("/a", "/b")]
    for number in range(messages):
        for channel in channels:
            writer.add_message(channel, T0 + number * SECOND, _RANDOM.randbytes(message_bytes))
    writer.finish()
    return out.getvalue()


def _store(api: Api, mission_id: str, body: bytes, *, path: str = "day/drive.mcap", **columns: Any) -> str:
    """Put a recording with its bytes; returns the id of the file."""
    key = f"blobs/{uuid.uuid4()}"

    async def put() -> None:
        async with open_storage(api.app.state.settings) as storage:
            await storage.put_object(key, body)

    asyncio.run(put())
    span: dict[str, Any] = {"start_ns": T0, "end_ns": T0 + 39 * SECOND}
    return Sample(api).file(mission_id, path, key=key, size_bytes=len(body), **{**span, **columns})


def _get(api: Api, file_id: str, *query: tuple[str, str]) -> urllib3.BaseHTTPResponse:
    headers = {} if api.token is None else {"Authorization": f"Bearer {api.token}"}
    url = f"{api.url}/api/v1/files/{file_id}/slice.mcap"
    return _POOL.request("GET", url, fields=list(query), headers=headers, preload_content=False)


@pytest.fixture(name="middleman", scope="module")
def _middleman(store: RunningStore) -> Iterator[Middleman]:
    with standing_before(store.endpoint) as middleman:
        yield middleman


@pytest.fixture(name="lab", scope="module")
def _lab(start_api: StartApi, middleman: Middleman) -> Api:
    return start_api(s3_internal_url=middleman.url, slices_at_once=2, slices_per_account=1)


@pytest.fixture(autouse=True)
def _honest_again(middleman: Middleman) -> Iterator[None]:
    yield
    middleman.rule = lambda _proxied: None


@pytest.fixture(name="mission")
def _mission(lab: Api) -> str:
    return str(lab.mission(lab.project()["id"])["id"])


def test_a_slice_has_the_bytes_that_to_mcap_makes(lab: Api, mission: str, tmp_path: Path) -> None:
    body = _recording()
    file_id = _store(lab, mission, body, sha256=bytes(32))
    answer = _get(lab, file_id, ("topics", "/a"), ("start", "+10s"), ("end", str(T0 + 20 * SECOND)))
    assert (answer.status, answer.headers["content-type"]) == (200, "application/octet-stream")
    assert answer.headers["content-disposition"] == 'attachment; filename="drive.slice.mcap"'
    sliced = answer.read()
    with Recording.open(MemorySource(body, "drive.mcap")) as recording:
        recording.to_mcap(
            tmp_path / "cut.mcap",
            ["/a"],
            start=T0 + 10 * SECOND,
            end=T0 + 20 * SECOND,
            sha256={"drive.mcap": bytes(32).hex()},
        )
    assert sliced == (tmp_path / "cut.mcap").read_bytes()
    whole = read_whole_mcap(tmp_path / "cut.mcap")
    assert [message[1] for message in whole.messages] == [T0 + number * SECOND for number in range(10, 20)]
    assert whole.metadata_of(MADE_FROM)["topics"] == '["/a"]'


def test_a_slice_is_recorded_as_a_download_of_what_was_selected(lab: Api, mission: str) -> None:
    file_id = _store(lab, mission, _recording())
    assert _get(lab, file_id, ("topics", "/a,/b"), ("start", "+1s")).read()
    (event,) = lab.events(file_id)
    assert event["operation"] == "file.download"
    assert event["after"] == {"topics": ["/a", "/b"], "start": "+1s", "end": None}


def test_a_file_name_cannot_change_the_headers_and_ranges_are_ignored(lab: Api, mission: str) -> None:
    file_id = _store(lab, mission, _recording(), path='day/a"; filename="bé.mcap')
    headers = {"Authorization": f"Bearer {lab.token}", "Range": "bytes=0-9"}
    answer = _POOL.request("GET", f"{lab.url}/api/v1/files/{file_id}/slice.mcap", headers=headers)
    assert (answer.status, answer.headers["accept-ranges"]) == (200, "none")
    assert answer.data[:8] == answer.data[-8:] == b"\x89MCAP0\r\n"
    assert answer.headers["content-disposition"] == 'attachment; filename="a_; filename=_b_.slice.mcap"'


def test_only_readers_of_the_mission_get_a_slice(lab: Api, mission: str) -> None:
    file_id = _store(lab, mission, _recording())
    path = f"/files/{file_id}/slice.mcap"
    lab.as_(people.person(lab).token).get(path).refused(404, "not_found")
    lab.as_(None).get(path).refused(404, "not_found")
    assert lab.events(file_id) == []


def test_a_link_gives_slices_of_its_files_and_counts_them(lab: Api, mission: str) -> None:
    file_id = _store(lab, mission, _recording())
    made = people.share(lab, mission, file_ids=[file_id])
    guest = lab.as_(made.secret)
    sliced = _get(guest, file_id, ("topics", "/a")).read()
    assert sliced
    other = _store(lab, lab.mission(lab.project()["id"])["id"], _recording())
    guest.get(f"/files/{other}/slice.mcap").refused(404, "not_found")

    def counted() -> tuple[int, int]:
        ((count, size_bytes),) = lab.sql("SELECT download_count, download_bytes FROM share WHERE id = %s", made.id)
        return count, size_bytes

    wait_until(lambda: counted() == (1, len(sliced)))


@pytest.mark.parametrize(
    ("query", "field", "sentence"),
    [
        ({"start": "never"}, "start", "is no time"),
        ({"end": "yesterday"}, "end", "is no time"),
        ({"start": "+20s", "end": "+20s"}, "end", "is not after the start"),
        ({"start": "+1h"}, "start", "nothing was recorded"),
        ({"start": "nan"}, "start", "is no time"),
        ({"start": "-5"}, "start", "is no time"),
        ({"start": "+" + "9" * 60}, "start", "is not after the start"),
        ({"end": "1970-01-01"}, "start", "is not after the start"),
        ({"end": "+10s\0"}, "query.end", "U+0000"),
        ({"topics": ", ,"}, "query.topics", "names no topic"),
        ({"topics": ",".join(map(str, range(1001)))}, "query.topics", "1000"),
        ({"topics": "/c"}, "topics", "there is no topic /c"),
        ({"topics": "/c*"}, "topics", "there is no topic /c*"),
    ],
)
def test_bad_requests_are_refused_by_field(
    lab: Api, mission: str, query: dict[str, str], field: str, sentence: str
) -> None:
    file_id = _store(lab, mission, _recording())
    problem = lab.get(f"/files/{file_id}/slice.mcap", query).refused(422, "invalid_request")
    (field_problem,) = problem["problems"]
    assert field_problem["field"] == field
    assert sentence in field_problem["message"]


def test_other_formats_and_damaged_bytes_are_refused(lab: Api, mission: str) -> None:
    database = _store(lab, mission, b"x" * 100, format="db3")
    assert "MCAP" in lab.get(f"/files/{database}/slice.mcap").refused(409, "cannot_slice")["reason"]
    mission = lab.mission(lab.project()["id"])["id"]
    broken = _store(lab, mission, b"no recording at all" * 300)
    lab.get(f"/files/{broken}/slice.mcap").refused(409, "cannot_slice")


def test_a_damaged_recording_is_sliced_and_says_what_is_lost(lab: Api, mission: str, tmp_path: Path) -> None:
    body = bytearray(_recording())
    body[len(body) // 2] ^= 0xFF
    path = tmp_path / "slice.mcap"
    path.write_bytes(_get(lab, _store(lab, mission, bytes(body))).read())
    whole = read_whole_mcap(path)
    assert 0 < len(whole.messages) < 80
    assert "losses" in whole.metadata_of(MADE_FROM)


def test_a_store_that_fails_before_the_start_is_a_problem_document(
    lab: Api, mission: str, middleman: Middleman
) -> None:
    file_id = _store(lab, mission, _recording())
    middleman.rule = lambda proxied: Reply(403, "AccessDenied") if proxied.method == "GET" else None
    lab.get(f"/files/{file_id}/slice.mcap").refused(503, "store_unavailable")
    assert lab.app.state.slice_slots.taken == 0


def test_a_store_that_fails_later_cuts_the_connection(lab: Api, mission: str, middleman: Middleman) -> None:
    body = _recording(message_bytes=500_000)
    file_id = _store(lab, mission, body)
    middleman.rule = _beyond(len(body) // 2, lambda: Reply(403, "AccessDenied"), tail=len(body) - 100_000)
    answer = _get(lab, file_id)
    assert answer.status == 200
    with pytest.raises(urllib3.exceptions.HTTPError):
        answer.read()
    wait_until(lambda: lab.app.state.slice_slots.taken == 0)


def test_a_client_that_leaves_before_the_first_bytes_ends_the_process_and_frees_its_slot(
    lab: Api, mission: str, middleman: Middleman
) -> None:
    body = _recording(message_bytes=500_000)
    file_id = _store(lab, mission, body)
    with _Barrier() as barrier:
        middleman.rule = _beyond(0, barrier.wait, tail=len(body) + 1)
        with socket.create_connection(("127.0.0.1", _port(lab))) as client:
            client.sendall(_request(lab, file_id))
            wait_until(lambda: lab.app.state.slice_slots.taken == 1)
        wait_until(lambda: lab.app.state.slice_slots.taken == 0)


def test_a_client_that_leaves_ends_the_process_and_frees_its_slot(lab: Api, mission: str, middleman: Middleman) -> None:
    body = _recording(message_bytes=500_000)
    file_id = _store(lab, mission, body)
    with _Barrier() as barrier:
        middleman.rule = _beyond(len(body) // 2, barrier.wait, tail=len(body) - 100_000)
        answer = _get(lab, file_id)
        assert answer.read(1000)
        assert lab.app.state.slice_slots.taken == 1
        answer.close()
        wait_until(lambda: lab.app.state.slice_slots.taken == 0)


def test_slices_at_once_are_limited_for_an_account_and_in_total(lab: Api, mission: str, middleman: Middleman) -> None:
    body = _recording(message_bytes=500_000)
    file_id = _store(lab, mission, body)
    path = f"/files/{file_id}/slice.mcap"
    admins = [people.person(lab, admin=True) for _ in range(2)]
    with _Barrier() as barrier:
        middleman.rule = _beyond(len(body) // 2, barrier.wait, tail=len(body) - 100_000)
        running = [_get(lab, file_id)]
        problem = lab.get(path).refused(429, "too_many_slices")
        assert (problem["limit"], problem["scope"]) == (1, "for one account")
        running.append(_get(lab.as_(admins[0].token), file_id))
        problem = lab.as_(admins[1].token).get(path).refused(429, "too_many_slices")
        assert (problem["limit"], problem["scope"]) == (2, "by this server")
        for answer in running:
            answer.close()
    wait_until(lambda: lab.app.state.slice_slots.taken == 0)


def test_a_slice_that_takes_too_long_is_cut_off_also_for_a_client_that_does_not_read(
    start_api: StartApi, middleman: Middleman
) -> None:
    lab = start_api(s3_internal_url=middleman.url, slice_timeout_s=4)
    body = _recording(message_bytes=500_000)
    file_id = _store(lab, lab.mission(lab.project()["id"])["id"], body)
    with _Barrier() as barrier, socket.create_connection(("127.0.0.1", _port(lab))) as client:
        middleman.rule = _beyond(len(body) * 3 // 4, barrier.wait, tail=len(body) - 100_000)
        client.sendall(_request(lab, file_id))
        answer = _get(lab, file_id)
        assert answer.status == 200
        assert lab.app.state.slice_slots.taken == 2
        with pytest.raises(urllib3.exceptions.HTTPError):
            answer.read()
        wait_until(lambda: lab.app.state.slice_slots.taken == 0)


def _port(api: Api) -> int:
    return urlsplit(api.url).port or 80


def _request(api: Api, file_id: str) -> bytes:
    head = f"GET /api/v1/files/{file_id}/slice.mcap HTTP/1.1\r\nHost: {urlsplit(api.url).netloc}\r\n"
    return f"{head}Authorization: Bearer {api.token}\r\n\r\n".encode()


class _Barrier:
    """Holds requests to the store until the block ends."""

    def __init__(self) -> None:
        self._open = threading.Event()

    def wait(self) -> None:
        self._open.wait(60)

    def __enter__(self) -> _Barrier:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.set()


def _beyond(offset: int, then: Callable[[], Reply | None], *, tail: int) -> Rule:
    """Return a rule for ranges between an offset and the tail of a file, which holds the index."""

    def rule(proxied: ProxiedRequest) -> Reply | None:
        start = int(proxied.headers.get("range", "bytes=0-").removeprefix("bytes=").split("-")[0])
        return then() if proxied.method == "GET" and offset <= start < tail else None

    return rule
