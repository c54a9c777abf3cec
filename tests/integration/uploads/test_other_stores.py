"""The upload protocol on stores without CRC-64/NVME: one verifies SHA-256, one Content-MD5 only."""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import urllib3

from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.fault_proxy import ProxiedRequest, Reply, standing_before
from tests.integration.jobs import on_site, run_jobs
from tests.integration.upload_client import begin, complete, fetch, put, send, sign, upload, wait_until
from tests.ports import choose_port
from tests.services import RunningStore

_PART = 5 * 1024 * 1024


class _Sha256Alone:
    """Refuses CRC-64/NVME, and lists with each part the sha256 it was verified by, which Amazon's S3 does too."""

    def __init__(self) -> None:
        self._parts: dict[tuple[str, str], str] = {}

    def rule(self, requested: ProxiedRequest) -> Reply | None:
        """Refuse what such a store does not know."""
        if "uploadId" in requested.query and (checksum := requested.headers.get("x-amz-checksum-sha256")):
            self._parts[requested.query["uploadId"], requested.query["partNumber"]] = checksum
        algorithm = requested.headers.get("x-amz-checksum-algorithm", "").lower()
        named = "crc64nvme" in algorithm or any("crc64nvme" in name for name in requested.headers)
        return Reply(501, "NotImplemented") if named else None

    def edit(self, requested: ProxiedRequest, body: bytes) -> bytes:
        """List the checksums of parts."""
        if requested.method != "GET" or "uploadId" not in requested.query:
            return body

        def listed(result: "re.Match[str]") -> str:
            checksum = self._parts[requested.query["uploadId"], result[1]]
            return f"{result[0]}<ChecksumSHA256>{checksum}</ChecksumSHA256>"

        return re.sub(r"<PartNumber>(\d+)</PartNumber>", listed, body.decode()).encode()


@contextmanager
def _rclone(folder: Path) -> Iterator[dict[str, str]]:
    """Run a second S3 implementation, which verifies Content-MD5 and nothing else; yields the settings for it."""
    program = shutil.which("rclone", path=str(Path(sys.executable).parent)) or shutil.which("rclone")
    assert program, "rclone belongs to the pinned requirements"
    (folder / "lab").mkdir()
    address = f"127.0.0.1:{choose_port()}"
    command = [program, "serve", "s3", str(folder), "--addr", address, "--auth-key", "key,secret", "--config", ""]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: _answers(f"http://{address}/"))
        yield {
            "s3_internal_url": f"http://{address}",
            "s3_bucket": "lab",
            "s3_access_key": "key",
            "s3_secret_key": "secret",
        }
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(10)


def _answers(url: str) -> bool:
    try:
        urllib3.request("GET", url, retries=False, timeout=1)
    except urllib3.exceptions.HTTPError:
        return False
    return True


@pytest.fixture(name="api", scope="module", params=["sha256", "md5"])
def _api(
    request: pytest.FixtureRequest,
    start_api: StartApi,
    store: RunningStore,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Api]:
    """An API on the store that verifies this."""
    if request.param == "md5":
        with _rclone(tmp_path_factory.mktemp("rclone")) as settings:
            yield start_api(**settings)
        return
    behind = _Sha256Alone()
    with standing_before(store.endpoint) as middleman:
        middleman.rule, middleman.edit = behind.rule, behind.edit
        yield start_api(s3_internal_url=middleman.url)


def test_the_probe_detects_the_checksums_of_the_store(api: Api, request: pytest.FixtureRequest) -> None:
    assert api.get("/service").ok()["checksum"] == request.node.callspec.params["api"]


@pytest.mark.parametrize("size_bytes", [0, 100, 2 * _PART + 5])
def test_a_file_is_uploaded_downloaded_and_verified_unchanged(api: Api, mission_id: str, size_bytes: int) -> None:
    body = os.urandom(size_bytes)
    file = upload(api, mission_id, "run.bin", body)
    assert file["crc64nvme"] is None, "these stores verify no checksum of the whole, so none is their word"
    run_jobs(api)
    assert api.get(f"/files/{file['id']}").ok()["state"] == "verified"
    link = api.post("/files/download", {"file_ids": [file["id"]]}).ok()["items"][0]
    status, read = fetch(link["url"])
    assert (status, read == body) == (200, True)


@pytest.mark.parametrize("size_bytes", [1000, _PART + 1000])
def test_other_bytes_are_refused(api: Api, mission_id: str, size_bytes: int) -> None:
    body = os.urandom(size_bytes)
    started: dict[str, Any] = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    first = body[:_PART]
    signed = sign(api, started, [(1, first)]).ok()["items"][0]
    assert put(signed, first[:-1] + bytes([first[-1] ^ 1])) in {400, 403}
    # A store that says of an upload of several parts, none of which came, that it knows none, is believed.
    (multipart_id,) = api.sql("SELECT multipart_id FROM upload WHERE id = %s", started["id"])[0]
    key = api.sql("SELECT key FROM upload WHERE id = %s", started["id"])[0][0]
    is_known = multipart_id is None or on_site(api, lambda site: site.storage.list_parts(key, multipart_id)) == []
    expected = "upload_incomplete" if is_known else "upload_gone"
    assert complete(api, started, body)["problem"]["code"] == expected


def test_a_resumed_upload_sends_only_the_rest(api: Api, mission_id: str) -> None:
    body = os.urandom(2 * _PART + 5)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body, only=[2])
    resumed = begin(api, mission_id, {"run.bin": body}, upload_id=started["id"])[0]["upload"]
    assert [part["number"] for part in resumed["parts"]] == [2]
    send(api, started, body, only=[1, 3])
    assert complete(api, started, body)["outcome"] == "completed"
