"""A machine is lost, and restored from a backup that was made during an upload."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from kleinkram.standalone.processes import marked_processes
from tests.acceptance.conftest import wait_until
from tests.klein import KLEIN
from tests.system.cluster import Cluster, environment

_LARGE_BYTES, _RATE = 40_000_000, "4M"


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_lost_machine_is_restored(cluster: Cluster) -> None:
    chance = random.Random(1)
    cluster.options.append("--no-runner")
    cluster.start()
    me, backups = cluster.terminal, cluster.home / "backups"
    day = cluster.home / "day"
    day.mkdir()
    for number in range(20):
        (day / f"{number}.bin").write_bytes(chance.randbytes(50_000 * number))
    large = cluster.home / "large.bin"
    large.write_bytes(chance.randbytes(_LARGE_BYTES))
    me.run("project", "create", "p")
    me.run("upload", day, "-p", "p", "-m", "drive", "--create")
    robot = me.run("token", "create", "robot", "--json").json()["secret"]

    send = ("upload", large, "-p", "p", "-m", "drive")
    sending = me.start(*send, "--limit-rate", _RATE)
    wait_until(lambda: me.parts_sent() >= 1, "a part of the large file to be sent")
    sending.send_signal(signal.SIGSTOP)  # the upload takes longer than the backup
    runtime_info = me.run("backup", "create", backups, "--json").json()
    assert (runtime_info["objects"], runtime_info["problems"]) == (20, [])
    sending.kill()
    sending.communicate()

    _lose(cluster)
    assert me.run("backup", "verify", backups, "--read-all", "--json").json()["ok"]
    _restore_and_kill(cluster, backups)
    refused = _up(cluster)
    assert refused.returncode == 1
    assert "was not finished" in refused.stderr
    me.run("restore", backups, "--data-dir", cluster.data_dir)
    again = me.run("restore", backups, "--data-dir", cluster.data_dir, code=1)
    assert "is not empty" in again.err

    cluster.start()
    out = cluster.home / "out"
    me.run("download", "-p", "p", "-m", "drive", "--dest", out)
    restored = {path.name: path.read_bytes() for path in out.rglob("*.bin")}
    assert restored == {path.name: path.read_bytes() for path in day.iterdir()}
    url = cluster.runtime_info()["url"]
    assert me.run("whoami", "--json").json()  # the owner has a new token
    stranger = type(me)(cluster.home, environment(cluster.home, KLEINKRAM_URL=url, KLEINKRAM_TOKEN=robot))
    assert stranger.run("project", "list", "--json").json()["items"][0]["name"] == "p"
    me.run(*send)  # the uploaded parts are lost, and nothing conflicts
    me.run("verify", large, "-p", "p", "-m", "drive")
    scrubbed = me.run("admin", "scrub", "--json").json()["last"]
    assert (scrubbed["lost"], scrubbed["corrupt"], scrubbed["aborted_reason"]) == (0, 0, None)
    assert me.run("backup", "create", backups, "--json").json()["copied"] == 1


def _lose(cluster: Cluster) -> None:
    """Kill everything and remove the data directory."""
    cluster.kill("supervisor")
    for pid in marked_processes(cluster.data_dir):
        with contextlib.suppress(ProcessLookupError):  # the other processes end when the supervisor does
            os.kill(pid, signal.SIGKILL)
    wait_until(lambda: marked_processes(cluster.data_dir) == [], "all parts to be gone")
    shutil.rmtree(cluster.data_dir)


def _restore_and_kill(cluster: Cluster, backups: Path) -> None:
    """Kill a restore once it has created the database."""
    restoring = cluster.terminal.start("restore", backups, "--data-dir", cluster.data_dir)
    wait_until(lambda: (cluster.data_dir / "postgres" / "PG_VERSION").exists(), "a restore to begin")
    restoring.kill()
    restoring.communicate()


def _up(cluster: Cluster) -> "subprocess.CompletedProcess[str]":
    command = [str(KLEIN), "up", "--data-dir", str(cluster.data_dir)]
    return subprocess.run(
        command, env=environment(cluster.home), capture_output=True, text=True, check=False, timeout=60
    )
