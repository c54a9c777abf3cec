"""Rounds of kill -9 in the middle of an upload: what is killed when, what was stored, what was sent again.

A round is seeded: the processes, the moments, and the bytes.
"""

import contextlib
import hashlib
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from kleinkram.contract.errors import StoreUnavailable
from tests.acceptance.conftest import wait_until
from tests.system import backend
from tests.system.cluster import Cluster

VICTIMS = ("client", "api", "worker", "runner", "postgres", "store", "supervisor")
CONNECTIONS = 4
MB = 1_000_000
_KILLS_A_ROUND = 2
_ATTEMPTS = 6
# Large files have parts of 5 MiB, and a round's small ones are more than are announced at once.
_SMALL_FILES = 75


@dataclass
class Round:
    """One round: its mission's local folder, the processes to kill, and the results."""

    seed: int
    victims: list[str]
    folder: Path
    size_bytes: int
    sha256: dict[str, str] = field(default_factory=dict)
    sent_again_bytes: int = 0
    runs: list[str] = field(default_factory=list)

    @property
    def mission(self) -> str:
        """The mission's name."""
        return self.folder.name


def turns(chance: random.Random) -> Iterator[list[str]]:
    """Yield the processes to kill in each round: two different ones, all in turn, in random order."""
    waiting: list[str] = []
    while True:
        while len(set(waiting[:_KILLS_A_ROUND])) < _KILLS_A_ROUND:
            waiting += chance.sample(VICTIMS, k=len(VICTIMS))
            if waiting[0] == waiting[1]:
                del waiting[1]
        yield waiting[:_KILLS_A_ROUND]
        del waiting[:_KILLS_A_ROUND]


def fill(one: Round, chance: random.Random) -> None:
    """Write the round's files: two or more large ones, and many small."""
    one.folder.mkdir()
    small = [20_000 * (1 + number % 25) for number in range(_SMALL_FILES)]
    left = one.size_bytes - sum(small)
    count = max(2, left // (60 * MB))
    large = [left // count] * (count - 1) + [left - left // count * (count - 1)]
    for number, size in enumerate([*large, *small]):
        path = one.folder / f"{number:03}.bin"
        content = chance.randbytes(size)
        path.write_bytes(content)
        os.utime(path, (1_700_000_000, 1_700_000_000))
        one.sha256[f"{one.mission}/{path.name}"] = hashlib.sha256(content).hexdigest()


def upload_under_fire(cluster: Cluster, one: Round, chance: random.Random, *, rate_mb_s: int) -> None:
    """Upload once, killing at random moments meanwhile, then again until it is done; note what was sent again."""
    before = _stored_bytes(cluster)
    command = [*_upload(one), "--limit-rate", f"{rate_mb_s}MB"]
    upload = cluster.terminal.start(*command)
    wait_until(lambda: bool(cluster.terminal.journals()) or upload.poll() is not None, "the upload to begin")
    started = time.monotonic()
    moments = sorted(chance.uniform(0, one.size_bytes / MB / rate_mb_s) for _ in one.victims)
    for moment, victim in zip(moments, one.victims, strict=True):
        _let_run(upload, started + moment)
        say(f"  {time.monotonic() - started:5.2f} s: kill {victim}")
        if victim == "client":
            upload.kill()
        else:
            cluster.start_again_if_dead()
            cluster.kill(victim)
    cluster.start_again_if_dead()  # while the client still waits for it
    out, err = upload.communicate(timeout=100)
    say(f"  {time.monotonic() - started:5.2f} s: the client ended with {upload.returncode}")
    assert "Traceback" not in out + err
    stored = _stored_bytes(cluster) - before
    moved = _upload_until_done(cluster, one)
    one.sent_again_bytes = max(0, stored + moved - one.size_bytes)
    say(
        f"  {time.monotonic() - started:5.2f} s: done; stored {stored}, then sent {moved}: again {one.sent_again_bytes}"
    )


def _stored_bytes(cluster: Cluster) -> int:
    """Return the bytes in the store, waiting until it is available."""
    weighed: list[int] = []

    def is_weighed() -> bool:
        with contextlib.suppress(StoreUnavailable):
            weighed.append(backend.stored_bytes(cluster))
        return bool(weighed)

    wait_until(is_weighed, "the store to be back")
    return weighed[0]


def _upload_until_done(cluster: Cluster, one: Round) -> int:
    """Upload until it succeeds; return the bytes that the last run sent."""
    reports: list[str] = []
    for _ in range(_ATTEMPTS):
        cluster.start_again_if_dead()
        ran = cluster.terminal.run(*_upload(one), "--json", code=None)
        reports.append(f"{ran.code}: {ran.err}")
        assert "Traceback" not in ran.err
        if ran.code == 0:
            return sum(item["moved_bytes"] for item in ran.json()["items"])
    pytest.fail("never done:\n" + "\n".join(reports))


def _let_run(upload: "subprocess.Popen[str]", until: float) -> None:
    try:
        upload.wait(timeout=max(0.0, until - time.monotonic()))
    except subprocess.TimeoutExpired:
        return


def _upload(one: Round) -> list[str]:
    return ["upload", "-p", "p", "-m", one.mission, "--create", str(one.folder), "--connections", str(CONNECTIONS)]


def say(line: str) -> None:
    """Print a line; pytest shows it if a round fails."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
