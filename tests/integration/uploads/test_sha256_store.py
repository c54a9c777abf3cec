"""The same protocol on a store that knows no CRC-64/NVME, so that parts are proven by their sha256."""

import os
import re
from collections.abc import Iterator
from typing import Any

import pytest

from tests.integration.conftest import StartApi
from tests.integration.jobs import run_jobs
from tests.integration.middleman import Asked, Reply, standing_before
from tests.integration.running import Api
from tests.integration.uploading import begin, complete, fetch, put, send, sign, upload
from tests.stack import RunningStore

_PART = 8 * 1024 * 1024


class _Sha256Alone:
    """Refuses CRC-64/NVME, and lists with each part the sha256 it was verified by, which Amazon's S3 does too."""

    def __init__(self) -> None:
        self._parts: dict[tuple[str, str], str] = {}

    def rule(self, asked: Asked) -> Reply | None:
        """Refuse what such a store does not know."""
        if "uploadId" in asked.query and (checksum := asked.headers.get("x-amz-checksum-sha256")):
            self._parts[asked.query["uploadId"], asked.query["partNumber"]] = checksum
        algorithm = asked.headers.get("x-amz-checksum-algorithm", "").lower()
        named = "crc64nvme" in algorithm or any("crc64nvme" in name for name in asked.headers)
        return Reply(501, "NotImplemented") if named else None

    def edit(self, asked: Asked, body: bytes) -> bytes:
        """List the checksums of parts."""
        if asked.method != "GET" or "uploadId" not in asked.query:
            return body

        def listed(found: "re.Match[str]") -> str:
            checksum = self._parts[asked.query["uploadId"], found[1]]
            return f"{found[0]}<ChecksumSHA256>{checksum}</ChecksumSHA256>"

        return re.sub(r"<PartNumber>(\d+)</PartNumber>", listed, body.decode()).encode()


@pytest.fixture(name="api", scope="module")
def _api(start_api: StartApi, store: RunningStore) -> Iterator[Api]:
    behind = _Sha256Alone()
    with standing_before(store.endpoint) as middleman:
        middleman.rule, middleman.edit = behind.rule, behind.edit
        yield start_api(s3_internal_url=middleman.url)


@pytest.fixture(name="mission_id")
def _mission_id(api: Api) -> str:
    return str(api.mission(api.project()["id"])["id"])


def test_the_probe_finds_what_this_store_verifies(api: Api) -> None:
    assert api.get("/service").ok()["checksum"] == "sha256"


@pytest.mark.parametrize("size_bytes", [0, 100, 2 * _PART + 5])
def test_a_file_comes_back_as_it_went_and_is_proven(api: Api, mission_id: str, size_bytes: int) -> None:
    body = os.urandom(size_bytes)
    file = upload(api, mission_id, "run.bin", body)
    run_jobs(api)
    assert api.get(f"/files/{file['id']}").ok()["state"] == "proven"
    link = api.post("/files/download", {"file_ids": [file["id"]]}).ok()["items"][0]
    status, read = fetch(link["url"])
    assert (status, read == body) == (200, True)


@pytest.mark.parametrize("size_bytes", [1000, _PART + 1000])
def test_other_bytes_are_refused(api: Api, mission_id: str, size_bytes: int) -> None:
    body = os.urandom(size_bytes)
    started: dict[str, Any] = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    first = body[:_PART]
    signed = sign(api, started, [(1, first)]).ok()["items"][0]
    assert put(signed, first[:-1] + b"!") in {400, 403}
    assert complete(api, started, body)["problem"]["code"] == "upload_incomplete"


def test_a_resumed_upload_sends_only_the_rest(api: Api, mission_id: str) -> None:
    body = os.urandom(2 * _PART + 5)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body, only=[2])
    resumed = begin(api, mission_id, {"run.bin": body}, upload_id=started["id"])[0]["upload"]
    assert [part["number"] for part in resumed["parts"]] == [2]
    send(api, started, body, only=[1, 3])
    assert complete(api, started, body)["outcome"] == "completed"
