"""The store is unreachable for half a minute, or full, during transfers: clients wait or report it."""

import contextlib
import filecmp
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from tests.acceptance.conftest import end, wait_until
from tests.system import backend
from tests.system.chaos.disks import MIB, SmallDisk, need_small_disks, small_disk
from tests.system.cluster import Cluster

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

_SILENT_S, _DYING_S = 18.0, 12.0
_ROOM = 160 * MIB


def _file(path: Path, size_bytes: int) -> Path:
    path.write_bytes(os.urandom(size_bytes))
    os.utime(path, (1_700_000_000, 1_700_000_000))
    return path


def _files_of(cluster: Cluster, mission: str) -> list[str]:
    statement = "SELECT path FROM file JOIN mission ON mission.id = mission_id WHERE mission.name = %s"
    return [path for (path,) in backend.sql(cluster, statement, mission)]


def _interrupt_store(cluster: Cluster) -> None:
    """Make the store unavailable for half a minute: it is suspended first, then killed again and again.

    The supervisor restarts it after increasing delays, the last of which ends shortly after the last kill.
    """
    pid = cluster.runtime_info()["services"]["store"]
    os.kill(pid, signal.SIGSTOP)
    threading.Event().wait(_SILENT_S)
    ends_at = time.monotonic() + _DYING_S
    while time.monotonic() < ends_at:
        with contextlib.suppress(ProcessLookupError):
            cluster.kill("store")
        threading.Event().wait(0.1)


def test_transfers_wait_for_a_store_that_is_unavailable_for_half_a_minute(cluster: Cluster, tmp_path: Path) -> None:
    cluster.start()
    terminal = cluster.terminal
    terminal.run("project", "create", "p")
    there = _file(tmp_path / "there.bin", 60 * MIB)
    terminal.run("upload", "-p", "p", "-m", "old", "--create", there)
    coming = _file(tmp_path / "coming.bin", 60 * MIB)
    slowly = ["--limit-rate", "5MiB"]  # so that both transfers overlap on slow machines too
    back = tmp_path / "back"
    transfers = [
        terminal.start("upload", "-p", "p", "-m", "new", "--create", coming, *slowly),
        terminal.start("download", "-p", "p", "-m", "old", "--dest", back, *slowly),
    ]
    wait_until(lambda: terminal.parts_sent() >= 1 and _fetched(back) >= 1, "both transfers to be half-way")
    _interrupt_store(cluster)
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


def test_a_full_store_is_reported_and_uploads_continue_once_there_is_space(tmp_path: Path) -> None:
    need_small_disks()
    cluster = Cluster(tmp_path)
    cluster.start()
    cluster.end()
    with small_disk(cluster.data_dir / "store", _ROOM) as disk:
        cluster.inside = disk.inside
        try:
            _fill_a_store(cluster, disk)
        finally:
            cluster.end()


def _fill_a_store(cluster: Cluster, disk: SmallDisk) -> None:
    cluster.start()
    terminal = cluster.terminal
    terminal.run("project", "create", "p")
    stored = _file(cluster.home / "kept.bin", 20 * MIB)
    terminal.run("upload", "-p", "p", "-m", "m", "--create", stored)
    disk.fill()
    large = _file(cluster.home / "large.bin", 40 * MIB)
    process = terminal.start("upload", "-p", "p", "-m", "m", large)
    assert process.stderr is not None
    assert "the store is unreachable or full" in process.stderr.readline()
    assert _files_of(cluster, "m") == ["kept.bin"], "what did not arrive is not there"
    terminal.run("verify", "-p", "p", "-m", "m", stored)
    disk.make_room()
    ended = end(process)
    assert ended.code == 0, ended.err
    terminal.run("verify", "-p", "p", "-m", "m", stored, large)
    terminal.run("verify", "-p", "p", "-m", "m", "--remote")
