"""The store in trouble while bytes move: away for half a minute, and full. Clients wait or say so; nothing is lost."""

import contextlib
import filecmp
import os
import shlex
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.acceptance.conftest import end, wait_until
from tests.lacking import missing
from tests.system import behind
from tests.system.house import House

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

Trouble = Callable[[House], None]
_MIB = 1024 * 1024
_AWAY_S = 30.0
_ROOM = 160 * _MIB


def _file(path: Path, size_bytes: int) -> Path:
    path.write_bytes(os.urandom(size_bytes))
    os.utime(path, (1_700_000_000, 1_700_000_000))
    return path


def _files_of(house: House, mission: str) -> list[str]:
    statement = "SELECT path FROM file JOIN mission ON mission.id = mission_id WHERE mission.name = %s"
    return [path for (path,) in behind.sql(house, statement, mission)]


def _silent(house: House) -> None:
    """The store takes connections, and no byte moves."""
    pid = house.told()["parts"]["store"]
    os.kill(pid, signal.SIGSTOP)
    threading.Event().wait(_AWAY_S)
    os.kill(pid, signal.SIGCONT)


def _dying(house: House) -> None:
    """The store dies as often as it is started."""
    ends_at = time.monotonic() + _AWAY_S
    while time.monotonic() < ends_at:
        with contextlib.suppress(ProcessLookupError):
            house.kill("store")
        threading.Event().wait(0.1)


@pytest.mark.parametrize("away", [_silent, _dying])
def test_a_store_that_is_away_for_half_a_minute_is_waited_for(house: House, tmp_path: Path, away: Trouble) -> None:
    house.start()
    terminal = house.terminal
    terminal.run("project", "create", "p")
    there = _file(tmp_path / "there.bin", 60 * _MIB)
    terminal.run("upload", "-p", "p", "-m", "old", "--create", there)
    coming = _file(tmp_path / "coming.bin", 60 * _MIB)
    slowly = ["--limit-rate", "12MiB"]
    back = tmp_path / "back"
    transfers = [
        terminal.start("upload", "-p", "p", "-m", "new", "--create", coming, *slowly),
        terminal.start("download", "-p", "p", "-m", "old", "--dest", back, *slowly),
    ]
    wait_until(lambda: terminal.parts_sent() >= 1 and _fetched(back) >= 1, "both transfers to be half-way")
    away(house)
    assert [transfer.poll() for transfer in transfers] == [None, None], "nobody gave up"
    for transfer in transfers:
        ended = end(transfer)
        assert ended.code == 0, ended.err
    assert filecmp.cmp(there, back / "there.bin", shallow=False)
    terminal.run("verify", "-p", "p", "-m", "new", coming)
    terminal.run("verify", "-p", "p", "-m", "new", "--remote")


def _fetched(back: Path) -> int:
    journal = back / "there.bin.klein-journal"
    return len(journal.read_text().splitlines()) - 1 if journal.exists() else 0


def test_a_store_without_room_says_so_and_goes_on_when_there_is_some(house: House, tmp_path: Path) -> None:
    _require_private_mounts()
    house.start()
    house.end()
    house.inside = _on_a_small_disk(house.data_dir / "store")
    house.start()
    terminal = house.terminal
    terminal.run("project", "create", "p")
    kept = _file(tmp_path / "kept.bin", 20 * _MIB)
    terminal.run("upload", "-p", "p", "-m", "m", "--create", kept)
    ballast = _seen_inside(house, house.data_dir / "store" / "ballast")
    _fill(ballast)
    large = _file(tmp_path / "large.bin", 40 * _MIB)
    process = terminal.start("upload", "-p", "p", "-m", "m", large)
    assert process.stderr is not None
    assert "waiting for the store, which is away or full" in process.stderr.readline()
    assert _files_of(house, "m") == ["kept.bin"], "what did not arrive is not there"
    terminal.run("verify", "-p", "p", "-m", "m", kept)
    ballast.unlink()
    ended = end(process)
    assert ended.code == 0, ended.err
    terminal.run("verify", "-p", "p", "-m", "m", kept, large)
    terminal.run("verify", "-p", "p", "-m", "m", "--remote")


def _on_a_small_disk(folder: Path) -> tuple[str, ...]:
    """A command prefix: the program sees a small disk of its own at `folder`, which is gone when it ends."""
    mount = f"mount -t tmpfs -o size={_ROOM} small {shlex.quote(str(folder))}"
    return ("unshare", "--mount", "--propagation", "private", "sh", "-c", f'{mount} && exec "$@"', "sh")


def _seen_inside(house: House, path: Path) -> Path:
    """Return a file of the house's as this process can reach it."""
    assert house.process is not None
    return Path(f"/proc/{house.process.pid}/root{path}")


def _fill(ballast: Path) -> None:
    with ballast.open("wb", buffering=0) as out:
        try:
            while True:
                out.write(bytes(_MIB))
        except OSError:
            return


def _require_private_mounts() -> None:
    trial = subprocess.run(
        ["unshare", "--mount", "--propagation", "private", "mount", "-t", "tmpfs", "small", "/mnt"],
        check=False,
        capture_output=True,
        text=True,
    )
    if trial.returncode != 0:
        missing(f"a small disk needs a mount namespace, which is not allowed here: {trial.stderr}")
