"""The same protocol on a second S3 implementation, which verifies Content-MD5 and nothing else: `rclone serve s3`."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import urllib3

from kleinkram.standalone import ports
from tests.integration.jobs import run_jobs
from tests.integration.running import Api
from tests.integration.uploading import begin, complete, fetch, put, send, sign, upload, wait_until

_PART = 8 * 1024 * 1024


@pytest.fixture(name="api", scope="module")
def _api(start_api: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    program = shutil.which("rclone", path=str(Path(sys.executable).parent)) or shutil.which("rclone")
    assert program, "rclone belongs to the pinned requirements"
    folder = tmp_path_factory.mktemp("rclone")
    (folder / "lab").mkdir()
    address = f"127.0.0.1:{ports.choose_port()}"
    command = [program, "serve", "s3", str(folder), "--addr", address, "--auth-key", "key,secret", "--config", ""]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: _answers(f"http://{address}/"))
        yield start_api(
            s3_internal_url=f"http://{address}", s3_bucket="lab", s3_access_key="key", s3_secret_key="secret"
        )
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(10)


def _answers(url: str) -> bool:
    try:
        urllib3.request("GET", url, retries=False, timeout=1)
    except urllib3.exceptions.HTTPError:
        return False
    return True


@pytest.fixture(name="mission_id")
def _mission_id(api: Api) -> str:
    return str(api.mission(api.project()["id"])["id"])


def test_the_probe_finds_what_this_store_verifies(api: Api) -> None:
    assert api.get("/service").ok()["checksum"] == "md5"


@pytest.mark.parametrize("size_bytes", [0, 100, 2 * _PART + 5])
def test_a_file_comes_back_as_it_went_and_is_proven(api: Api, mission_id: str, size_bytes: int) -> None:
    body = os.urandom(size_bytes)
    file = upload(api, mission_id, "run.bin", body)
    assert file["crc64nvme"] is None, "this store verifies no checksum of the whole, so none is its word"
    run_jobs(api)
    assert api.get(f"/files/{file['id']}").ok()["state"] == "proven"
    link = api.post("/files/download", {"file_ids": [file["id"]]}).ok()["items"][0]
    status, read = fetch(link["url"])
    assert (status, read == body) == (200, True)


def test_other_bytes_are_refused(api: Api, mission_id: str) -> None:
    body = os.urandom(1000)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    signed = sign(api, started, [(1, body)]).ok()["items"][0]
    assert put(signed, body[:-1] + b"!") in {400, 403}
    assert complete(api, started, body)["problem"]["code"] == "upload_incomplete"


def test_a_resumed_upload_sends_only_the_rest(api: Api, mission_id: str) -> None:
    body = os.urandom(2 * _PART + 5)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body, only=[2])
    resumed = begin(api, mission_id, {"run.bin": body}, upload_id=started["id"])[0]["upload"]
    assert [part["number"] for part in resumed["parts"]] == [2]
    send(api, started, body, only=[1, 3])
    assert complete(api, started, body)["outcome"] == "completed"
