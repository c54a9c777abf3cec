"""A part whose answer was lost is sent again: the file is there all the same, also once the store has cleared up."""

import filecmp
import json
import os
import subprocess
import time
import uuid
from pathlib import Path

import pytest
import urllib3

from kleinkram.client import Client, connect
from kleinkram.contract.uploads import MIN_PART_BYTES, PartToSign, Send, UploadFile, UploadFinish
from kleinkram.standalone.binaries import locate_weed
from tests.integration.uploading import checksum, crc64, sha256
from tests.system.house import House

_NAME = "run.bin"
# What SeaweedFS is to drop, it marks within a second or so; the bytes can be read until their volume is cleared up.
_MARKED_S = 3


def _send_again(client: Client, mission_id: uuid.UUID, body: bytes) -> None:
    announced = UploadFile(path=_NAME, size_bytes=len(body), sha256=sha256(body), crc64nvme=crc64(body))
    (decision,) = client.uploads.begin(mission_id, [announced]).items
    assert isinstance(decision, Send)
    upload = decision.upload
    starts = range(0, len(body), upload.part_size_bytes)
    # Other bytes first: the file may have changed between two runs of its upload.
    for sent in (os.urandom(len(body)), body, body):
        for number, start in enumerate(starts, start=1):
            piece = sent[start : start + upload.part_size_bytes]
            part = PartToSign(upload_id=upload.id, number=number, checksum=checksum(upload.checksum.value, piece))
            (signed,) = client.uploads.sign([part]).items
            answer = urllib3.request("PUT", signed.url, body=piece, headers=signed.headers, retries=False)
            assert answer.status == 200
    finish = UploadFinish(upload_id=upload.id, sha256=sha256(body), crc64nvme=crc64(body))
    (outcome,) = client.uploads.complete([finish]).items
    assert outcome.outcome == "completed"


def _clear_up(house: House) -> None:
    """Have the store give back the room of all that it has marked, which it does by itself where that is a third."""
    ports = json.loads((house.data_dir / "ports.json").read_text())
    shell = [str(locate_weed()), "shell", "-master", f"127.0.0.1:{ports['master']}.{ports['master_grpc']}"]
    text = "lock\nvolume.vacuum -garbageThreshold 0.00001\nunlock\n"
    said = subprocess.run(shell, input=text, capture_output=True, text=True, timeout=60, check=False)
    assert said.returncode == 0, said.stderr


@pytest.mark.slow
@pytest.mark.timeout(280)
def test_parts_that_were_sent_twice_are_there_once_the_store_has_cleared_up(house: House, tmp_path: Path) -> None:
    house.start()
    terminal, file = house.terminal, tmp_path / _NAME
    file.write_bytes(os.urandom(2 * MIN_PART_BYTES + 1000))
    terminal.run("project", "create", "p")
    mission = terminal.run("mission", "create", "m", "-p", "p", "--json").json()["id"]
    token = (house.data_dir / "owner-token").read_text().strip()
    with connect(house.told()["url"], token) as client:
        _send_again(client, uuid.UUID(mission), file.read_bytes())
    time.sleep(_MARKED_S)
    _clear_up(house)
    back = tmp_path / "back"
    terminal.run("download", "-p", "p", "-m", "m", "--dest", back)
    assert filecmp.cmp(file, back / _NAME, shallow=False)
    terminal.run("verify", back / _NAME, "-p", "p", "-m", "m")
