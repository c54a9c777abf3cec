"""Parts sent twice, late, concurrently or with other bytes before: the file is correct.

Deleted objects remain readable until the store vacuums its volumes, so files are compared after that.
"""

import filecmp
import itertools
import json
import os
import random
import subprocess
import time
import uuid
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest
import urllib3

from kleinkram.client import Client, connect
from kleinkram.contract.uploads import MIN_PART_BYTES, PartToSign, UploadFile, UploadFinish, UploadRead, UploadRequired
from kleinkram.standalone.object_store import locate_weed
from tests.integration.upload_client import checksum, crc64, sha256
from tests.system.cluster import Cluster

# SeaweedFS marks deleted objects after about a second. Their bytes remain readable until their volume is vacuumed.
_MARKED_S = 3
_CONCURRENCY = 3
_STORE = urllib3.PoolManager(retries=False, timeout=60, maxsize=_CONCURRENCY)

# The number of a sent part, and whether its bytes are those of the file.
Sent = tuple[int, bool]


@dataclass(frozen=True)
class History:
    """The requests for the parts of one upload, by round; the requests of a round overlap."""

    rounds: tuple[tuple[Sent, ...], ...]
    is_joined_early: bool  # a completion is requested after the first round, when parts are missing
    callers: int  # concurrent requests to complete it
    tail_bytes: int = 1000  # size of the last part

    @property
    def parts(self) -> set[int]:
        """The numbers of the parts, counted from 1."""
        return {number for number, _ in itertools.chain(*self.rounds)}


_OTHER_BYTES_FIRST_THEN_TWICE = History(
    rounds=(((1, False), (2, False), (3, False)), *[((1, True), (2, True), (3, True))] * 2),
    is_joined_early=False,
    callers=1,
)
_JOINED_BY_TWO = History(rounds=(((1, True), (1, True)), ((2, True), (2, True))), is_joined_early=True, callers=2)


def _random_history(rng: random.Random) -> History:
    """Generate a history in which the last request for each part has the bytes of the file."""
    numbers = [number for number in range(1, rng.randint(2, 3) + 1) for _ in range(rng.randint(1, 3))]
    rng.shuffle(numbers)
    left = {number: numbers.count(number) for number in numbers}
    rounds: list[list[Sent]] = []
    for number in numbers:
        left[number] -= 1
        sent = (number, left[number] == 0 or rng.random() < 0.6)
        # Overlapping requests for one part have the same bytes, because their order is unknown.
        fits = rounds and len(rounds[-1]) < _CONCURRENCY and (number, not sent[1]) not in rounds[-1]
        if fits and rng.random() < 0.5:
            rounds[-1].append(sent)
        else:
            rounds.append([sent])
    is_missing = len({number for number, _ in rounds[0]}) < len(left)
    is_joined_early = is_missing and rng.random() < 0.3
    tail_bytes = rng.randint(1, MIN_PART_BYTES)
    return History(tuple(map(tuple, rounds)), is_joined_early, callers=rng.randint(1, 3), tail_bytes=tail_bytes)


def _upload_by(client: Client, mission_id: uuid.UUID, history: History, file: Path) -> None:
    """Write random bytes to `file`, and upload it by a history."""
    body = os.urandom((len(history.parts) - 1) * MIN_PART_BYTES + history.tail_bytes)
    file.write_bytes(body)
    announced = UploadFile(path=file.name, size_bytes=len(body), sha256=sha256(body), crc64nvme=crc64(body))
    (decision,) = client.uploads.begin(mission_id, [announced]).items
    assert isinstance(decision, UploadRequired)
    upload = decision.upload
    finish = UploadFinish(upload_id=upload.id, sha256=sha256(body), crc64nvme=crc64(body))
    with ThreadPoolExecutor(_CONCURRENCY) as pool:
        for count, sends in enumerate(history.rounds):
            if count == 1 and history.is_joined_early:
                assert _outcomes(pool, client, finish, callers=1) == {"refused"}
            for status in [future.result() for future in [pool.submit(_send, client, upload, body, s) for s in sends]]:
                assert status == 200
        assert _outcomes(pool, client, finish, callers=history.callers) == {"completed"}


def _send(client: Client, upload: UploadRead, body: bytes, sent: Sent) -> int:
    number, is_right = sent
    start = (number - 1) * upload.part_size_bytes
    piece = body[start : start + upload.part_size_bytes]
    piece = piece if is_right else os.urandom(len(piece))
    part = PartToSign(upload_id=upload.id, number=number, checksum=checksum(upload.checksum.value, piece))
    (signed,) = client.uploads.sign([part]).items
    return _STORE.request("PUT", signed.url, body=piece, headers=signed.headers).status


def _outcomes(pool: ThreadPoolExecutor, client: Client, finish: UploadFinish, *, callers: int) -> set[str]:
    futures = [pool.submit(client.uploads.complete, [finish]) for _ in range(callers)]
    return {item.outcome for future in futures for item in future.result().items}


def _vacuum(cluster: Cluster) -> None:
    """Make the store vacuum its volumes, which it does by itself only when a third of a volume is deleted."""
    ports = json.loads((cluster.data_dir / "ports.json").read_text())
    shell = [str(locate_weed()), "shell", "-master", f"127.0.0.1:{ports['master']}.{ports['master_grpc']}"]
    text = "lock\nvolume.vacuum -garbageThreshold 0.00001\nunlock\n"
    done = subprocess.run(shell, input=text, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def _check_histories(cluster: Cluster, folder: Path, histories: Sequence[History], mission: str) -> None:
    """Upload files by these histories into one mission, vacuum the store, download the files and compare them."""
    terminal = cluster.terminal
    mission_id = terminal.run("mission", "create", mission, "-p", "p", "--json").json()["id"]
    token = (cluster.data_dir / "owner-token").read_text().strip()
    sent = folder / mission
    sent.mkdir()
    names = {f"{number:03}.bin": history for number, history in enumerate(histories)}
    with connect(cluster.runtime_info()["url"], token) as client:
        for name, history in names.items():
            _upload_by(client, uuid.UUID(mission_id), history, sent / name)
    time.sleep(_MARKED_S)
    _vacuum(cluster)
    back = folder / f"{mission}-back"
    terminal.run("download", "-p", "p", "-m", mission, "--dest", back)
    for name, history in names.items():
        assert filecmp.cmp(sent / name, back / name, shallow=False), history


@pytest.mark.slow
@pytest.mark.timeout(280)
def test_files_are_correct_whatever_the_history_of_their_parts(cluster: Cluster, tmp_path: Path) -> None:
    cluster.start()
    cluster.terminal.run("project", "create", "p")
    rng = random.Random(1)
    histories = [_random_history(rng) for _ in range(6)]
    _check_histories(cluster, tmp_path, [_OTHER_BYTES_FIRST_THEN_TWICE, _JOINED_BY_TWO, *histories], "m")


@pytest.mark.soak
def test_files_are_correct_after_many_random_histories_of_their_parts(cluster: Cluster, tmp_path: Path) -> None:
    cluster.start()
    cluster.terminal.run("project", "create", "p")
    for seed in range(1, int(os.environ.get("KLEINKRAM_SOAK_ROUNDS", "20")) + 1):
        rng = random.Random(seed)
        _check_histories(cluster, tmp_path, [_random_history(rng) for _ in range(20)], f"m{seed}")
