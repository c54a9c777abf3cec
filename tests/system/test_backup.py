"""A machine is lost with all that was on it, and comes back from a backup that was made while somebody was sending."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from kleinkram.standalone.procs import marked_processes
from tests.acceptance.conftest import KLEIN, wait_until
from tests.system.cluster import House, environment

_LARGE_BYTES, _RATE = 40_000_000, "4M"


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_lost_machine_comes_back(house: House) -> None:
    chance = random.Random(1)
    house.options.append("--no-runner")
    house.start()
    me, backups = house.terminal, house.home / "backups"
    day = house.home / "day"
    day.mkdir()
    for number in range(20):
        (day / f"{number}.bin").write_bytes(chance.randbytes(50_000 * number))
    large = house.home / "large.bin"
    large.write_bytes(chance.randbytes(_LARGE_BYTES))
    me.run("project", "create", "p")
    me.run("upload", day, "-p", "p", "-m", "drive", "--create")
    robot = me.run("token", "create", "robot", "--json").json()["secret"]

    send = ("upload", large, "-p", "p", "-m", "drive")
    sending = me.start(*send, "--limit-rate", _RATE)
    wait_until(lambda: me.parts_sent() >= 1, "a part of the large file to be sent")
    sending.send_signal(signal.SIGSTOP)  # it is under way for as long as the backup takes
    told = me.run("backup", "create", backups, "--json").json()
    assert (told["objects"], told["problems"]) == (20, [])
    sending.kill()
    sending.communicate()

    _lose(house)
    assert me.run("backup", "verify", backups, "--read-all", "--json").json()["ok"]
    _restore_and_kill(house, backups)
    refused = _up(house)
    assert refused.returncode == 1
    assert "was not finished" in refused.stderr
    me.run("restore", backups, "--data-dir", house.data_dir)
    again = me.run("restore", backups, "--data-dir", house.data_dir, code=1)
    assert "is not empty" in again.err

    house.start()
    out = house.home / "out"
    me.run("download", "-p", "p", "-m", "drive", "--dest", out)
    found = {path.name: path.read_bytes() for path in out.rglob("*.bin")}
    assert found == {path.name: path.read_bytes() for path in day.iterdir()}
    url = house.told()["url"]
    assert me.run("whoami", "--json").json()  # the owner's token is a new one
    stranger = type(me)(house.home, environment(house.home, KLEINKRAM_URL=url, KLEINKRAM_TOKEN=robot))
    assert stranger.run("project", "list", "--json").json()["items"][0]["name"] == "p"
    me.run(*send)  # the parts that were sent are gone, and nothing is in its way
    me.run("verify", large, "-p", "p", "-m", "drive")
    scrubbed = me.run("admin", "scrub", "--json").json()["last"]
    assert (scrubbed["lost"], scrubbed["corrupt"], scrubbed["stopped"]) == (0, 0, None)
    assert me.run("backup", "create", backups, "--json").json()["copied"] == 1


def _lose(house: House) -> None:
    """All that runs is killed, and the disk is gone."""
    house.kill("supervisor")
    for pid in marked_processes(house.data_dir):
        with contextlib.suppress(ProcessLookupError):  # they end with the supervisor, by themselves
            os.kill(pid, signal.SIGKILL)
    wait_until(lambda: marked_processes(house.data_dir) == [], "all parts to be gone")
    shutil.rmtree(house.data_dir)


def _restore_and_kill(house: House, backups: Path) -> None:
    """A restore is killed as soon as its database has begun."""
    restoring = house.terminal.start("restore", backups, "--data-dir", house.data_dir)
    wait_until(lambda: (house.data_dir / "postgres" / "PG_VERSION").exists(), "a restore to begin")
    restoring.kill()
    restoring.communicate()


def _up(house: House) -> "subprocess.CompletedProcess[str]":
    command = [str(KLEIN), "up", "--data-dir", str(house.data_dir)]
    return subprocess.run(command, env=environment(house.home), capture_output=True, text=True, check=False, timeout=60)
