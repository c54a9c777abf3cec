"""kill -9 of everything in turn, in the middle of an upload; then the same command again, and all must be well.

Rounds are seeded: what is killed, when, and the bytes. A failure names its seed; KLEINKRAM_KILLS_SEED repeats it.
"""

import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acceptance.conftest import wait_until
from tests.system import behind
from tests.system.house import House

_VICTIMS = ("client", "api", "worker", "postgres", "store", "supervisor")
_KILLS_A_ROUND = 2
_LARGE, _SMALL = [17_000_000, 24_000_001], [20_000 * (1 + number % 25) for number in range(75)]
_RATE, _ABOUT_S = "25MB", 3.0
_ATTEMPTS = 6
_UNFINISHED = "SELECT path, state, failure FROM upload WHERE state IN ('open', 'completing')"
_FILES = """
    SELECT file.path, blob.state FROM file JOIN blob ON blob.id = file.blob_id JOIN mission ON mission.id = mission_id
    WHERE mission.name = %s ORDER BY file.path
"""


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_four_rounds(house: House) -> None:
    _rounds(house, 4)


@pytest.mark.soak
def test_many_rounds(house: House) -> None:
    _rounds(house, int(os.environ.get("KLEINKRAM_SOAK_ROUNDS", "100")))


def _rounds(house: House, count: int) -> None:
    house.start()
    house.terminal.run("project", "create", "p")
    first = int(os.environ.get("KLEINKRAM_KILLS_SEED", "1"))
    turns = _turns(random.Random(first))
    for seed in range(first, first + count):
        victims = [next(turns) for _ in range(_KILLS_A_ROUND)]
        _say(f"\nround {seed}: {', '.join(victims)}")
        folder = _mission(house.home / f"m{seed}", random.Random(seed))
        _upload_under_fire(house, folder, victims, random.Random(seed))
        _upload_until_done(house, folder)
        _all_is_well(house, folder)


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")  # pytest shows it when a round fails


def _turns(chance: random.Random) -> Iterator[str]:
    while True:
        yield from chance.sample(_VICTIMS, k=len(_VICTIMS))


def _mission(folder: Path, chance: random.Random) -> Path:
    """About 60 MB in two large and many small files."""
    folder.mkdir()
    for number, size in enumerate([*_LARGE, *_SMALL]):
        path = folder / f"{number:03}.bin"
        path.write_bytes(chance.randbytes(size))
        os.utime(path, (1_700_000_000, 1_700_000_000))
    return folder


def _upload_under_fire(house: House, folder: Path, victims: list[str], chance: random.Random) -> None:
    upload = house.terminal.start(*_upload(folder), "--limit-rate", _RATE)
    started = time.monotonic()
    for moment, victim in zip(sorted(chance.uniform(0, _ABOUT_S) for _ in victims), victims, strict=True):
        _let_run(upload, started + moment)
        _say(f"  {time.monotonic() - started:5.2f} s: kill {victim}")
        if victim == "client":
            upload.kill()
        else:
            house.start_again_if_dead()
            house.kill(victim)
    house.start_again_if_dead()  # while the client still waits for it
    out, err = upload.communicate(timeout=100)
    _say(f"  {time.monotonic() - started:5.2f} s: the client ended with {upload.returncode}")
    assert "Traceback" not in out + err


def _let_run(upload: "subprocess.Popen[str]", until: float) -> None:
    try:
        upload.wait(timeout=max(0.0, until - time.monotonic()))
    except subprocess.TimeoutExpired:
        return


def _upload_until_done(house: House, folder: Path) -> None:
    said: list[str] = []
    for _ in range(_ATTEMPTS):
        house.start_again_if_dead()
        started = time.monotonic()
        ran = house.terminal.run(*_upload(folder), code=None)
        said.append(f"{time.monotonic() - started:.1f} s, {ran.code}: {ran.err}")
        assert "Traceback" not in ran.err
        if ran.code == 0:
            break
    else:
        pytest.fail("never done:\n" + "\n".join(said))
    _say(f"  again: {[line.split(':')[0] for line in said]}")


def _all_is_well(house: House, folder: Path) -> None:
    terminal, mission = house.terminal, ["-p", "p", "-m", folder.name]
    terminal.run("verify", *mission, folder)
    terminal.run("verify", *mission, "--remote")
    behind.tidy(house)
    assert behind.sql(house, _UNFINISHED) == []
    expected = [(f"{folder.name}/{path.name}", "proven") for path in sorted(folder.iterdir())]
    assert behind.sql(house, _FILES, folder.name) == expected
    again = terminal.run(*_upload(folder), "--json").json()["items"]
    assert {item["moved_bytes"] for item in again} == {0}
    kept = dict(behind.sql(house, "SELECT key, size_bytes FROM blob"))
    assert behind.objects(house) == kept
    assert behind.open_multiparts(house) == []
    wait_until(lambda: all(house.told()["parts"].values()), "every part to run")


def _upload(folder: Path) -> list[str]:
    return ["upload", "-p", "p", "-m", folder.name, "--create", str(folder)]
