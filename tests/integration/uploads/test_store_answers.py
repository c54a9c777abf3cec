"""Interpretation of store responses: an upload is gone only when the store says that it does not know it."""

import os
import re
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from kleinkram.client import Client, connect
from kleinkram.client.transfer import Outcome, TransferResult, download, plan_download, plan_upload, upload
from kleinkram.client.transfer.download import fetch
from kleinkram.client.transfer.report import Watcher
from kleinkram.contract.errors import UploadGone
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.fault_proxy import Lost, Middleman, ProxiedRequest, Reply, standing_before
from tests.integration.upload_client import begin, complete, crc64, send, sha256
from tests.integration.upload_client import upload as upload_whole
from tests.services import RunningStore

_PART = 5 * 1024 * 1024
_PASSING: "list[Reply | Lost]" = [
    Reply(400, "RequestTimeout"),
    Reply(403, "AccessDenied"),
    Reply(404),
    Reply(404, "NoSuchBucket"),
    Reply(410),
    Reply(429, "TooManyRequests"),
    Reply(500, "InternalError"),
    Reply(503, "SlowDown"),
    Lost(),
]


@pytest.fixture(name="middleman", scope="module")
def _middleman(store: RunningStore) -> Iterator[Middleman]:
    with standing_before(store.endpoint) as middleman:
        yield middleman


@pytest.fixture(name="api", scope="module")
def _api(start_api: StartApi, middleman: Middleman) -> Api:
    return start_api(s3_internal_url=middleman.url)


@pytest.fixture(autouse=True)
def _honest_again(middleman: Middleman) -> Iterator[None]:
    yield
    middleman.rule = lambda _requests: None
    middleman.edit = lambda _requests, content: content


@pytest.fixture(name="client")
def _client(api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with connect(api.url, api.token) as client:
        yield client


def _once(
    expected: Callable[[ProxiedRequest], bool], answers: "list[Reply | Lost]"
) -> "Callable[[ProxiedRequest], Reply | Lost | None]":
    """Give each answer once to what is wanted, then let everything through."""
    left = [*answers]
    return lambda requested: left.pop(0) if left and expected(requested) else None


def _is_multipart(requested: ProxiedRequest) -> bool:
    return "uploadId" in requested.query


@pytest.mark.parametrize("shown", [item for item in _PASSING if isinstance(item, Reply)], ids=repr)
def test_an_unavailable_store_does_not_end_an_upload(
    api: Api, middleman: Middleman, mission_id: str, shown: Reply
) -> None:
    body = os.urandom(_PART + 100)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body)
    middleman.rule = lambda requested: shown if _is_multipart(requested) else None
    finish = {"upload_id": started["id"], "sha256": sha256(body), "crc64nvme": crc64(body)}
    api.post("/uploads/complete", {"uploads": [finish]}).refused(503, "store_unavailable")
    middleman.rule = lambda _requests: None
    assert complete(api, started, body)["outcome"] == "completed"


@pytest.mark.parametrize("size_bytes", [1000, _PART + 100])
def test_a_404_of_a_proxy_does_not_end_an_upload(
    api: Api, middleman: Middleman, mission_id: str, size_bytes: int
) -> None:
    """A response to HEAD has only a status, whether a proxy or the store sends it."""
    body = os.urandom(size_bytes)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body)
    middleman.rule = lambda requested: Reply(404) if requested.method == "HEAD" else None
    finish = {"upload_id": started["id"], "sha256": sha256(body), "crc64nvme": crc64(body)}
    api.post("/uploads/complete", {"uploads": [finish]}).refused(503, "store_unavailable")
    middleman.rule = lambda _requests: None
    assert complete(api, started, body)["outcome"] == "completed"


def test_an_upload_that_the_store_does_not_know_is_gone(api: Api, middleman: Middleman, mission_id: str) -> None:
    body = os.urandom(_PART + 100)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body)
    middleman.rule = lambda requested: Reply(404, "NoSuchUpload") if _is_multipart(requested) else None
    assert complete(api, started, body)["problem"]["code"] == "upload_gone"


@pytest.mark.parametrize("listed", [0, 1])
def test_concurrent_completions_do_not_end_the_upload(
    api: Api, middleman: Middleman, mission_id: str, listed: int
) -> None:
    """Between the answer to the first and its file, a second asks, and the store lists what is left of the parts."""
    body = os.urandom(_PART + 100)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body)
    seconds: list[Any] = []

    def fewer(requested: ProxiedRequest, content: bytes) -> bytes:
        if not _is_multipart(requested) or requested.method != "GET":
            return content
        entries = re.findall(rb"<Part>.*?</Part>", content)
        return content.replace(b"".join(entries), b"".join(entries[:listed]))

    def interrupt(requested: ProxiedRequest) -> None:
        if requested.method == "POST" and _is_multipart(requested) and not seconds:
            middleman.edit = fewer
            seconds.append(complete(api, started, body))
            middleman.edit = lambda _requests, content: content

    middleman.rule = interrupt
    first = complete(api, started, body)
    assert [second["problem"]["code"] for second in seconds] == ["upload_incomplete"]
    assert first["outcome"] == "completed"
    assert complete(api, started, body)["file"]["id"] == first["file"]["id"]


def _sent(client: Client, mission_id: str, file: Path) -> TransferResult:
    report = upload(client, uuid.UUID(mission_id), plan_upload([file]), connections=1)
    return report.results[0]


@pytest.mark.parametrize("size_bytes", [1000, _PART + 1000])
def test_an_upload_is_retried_until_the_store_is_available(
    middleman: Middleman, client: Client, mission_id: str, tmp_path: Path, size_bytes: int
) -> None:
    file = tmp_path / "run.bin"
    file.write_bytes(os.urandom(size_bytes))
    os.utime(file, (1_700_000_000, 1_700_000_000))
    for shown in _PASSING:
        middleman.rule = _once(lambda requested: requested.method == "PUT", [shown])
        result = _sent(client, mission_id, file)
        assert result.outcome is Outcome.uploaded, (shown, result)
        assert result.file_id is not None
        client.files.delete(result.file_id)


def test_an_unknown_upload_is_reported_to_the_client(
    api: Api, middleman: Middleman, client: Client, mission_id: str, tmp_path: Path
) -> None:
    file = tmp_path / "run.bin"
    file.write_bytes(os.urandom(2 * _PART))
    os.utime(file, (1_700_000_000, 1_700_000_000))
    middleman.rule = _once(lambda requested: requested.method == "PUT", [Reply(404, "NoSuchUpload")])
    result = _sent(client, mission_id, file)
    assert (result.outcome, type(result.error)) == (Outcome.refused, UploadGone)
    assert _sent(client, mission_id, file).outcome is Outcome.uploaded, "the same command starts a new upload"
    assert api.all(f"/missions/{mission_id}/uploads") == []


def test_a_download_is_retried_until_the_store_is_available(
    api: Api, middleman: Middleman, client: Client, mission_id: str, tmp_path: Path
) -> None:
    body = os.urandom(_PART + 100)
    file = upload_whole(api, mission_id, "run.bin", body)
    plan = plan_download([client.files.get(uuid.UUID(file["id"]))], tmp_path / "back")
    middleman.rule = _once(
        lambda requested: requested.method == "GET", [Reply(404), Reply(400, "RequestTimeout"), Lost()]
    )
    (result,) = download(client, plan, connections=1).results
    assert result.outcome is Outcome.downloaded, result.error
    assert (tmp_path / "back" / "run.bin").read_bytes() == body


def test_a_file_that_the_store_does_not_return_blocks_no_other(
    middleman: Middleman, client: Client, mission_id: str, tmp_path: Path
) -> None:
    """Both are so large that one of them fills a link that has not proved to be fast."""
    folder = tmp_path / "day"
    folder.mkdir()
    for name in ("a.bin", "b.bin"):
        (folder / name).write_bytes(os.urandom(_PART + 100))
        os.utime(folder / name, (1_700_000_000, 1_700_000_000))
    upload(client, uuid.UUID(mission_id), plan_upload([f"{folder}/"]))
    bad: list[str] = []
    order: list[str] = []
    most_refused = 8  # some seconds of tries

    def rule(requested: ProxiedRequest) -> Reply | None:
        is_bad = requested.method == "GET" and requested.key == (bad or [requested.key])[0]
        if not is_bad or order or len(bad) > most_refused:
            return None
        bad.append(requested.key)
        return Reply(500, "InternalError")

    class Noted(Watcher):
        def ended(self, path: str, outcome: str, reason: str | None) -> None:
            order.append(outcome)

    middleman.rule = rule
    plan = plan_download(client.files.list(mission=mission_id), tmp_path / "back")
    fetch(lambda file_ids: client.files.links(file_ids).items, client.endpoint.url, plan, watcher=Noted())
    assert order == ["downloaded", "downloaded"]
    assert 0 < len(bad) <= most_refused
