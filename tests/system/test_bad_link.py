"""Transfers over a slow link that breaks connections: uploaded parts are kept, and `klein` reports why it waits."""

import filecmp
import json
import os
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.conftest import Terminal, wait_until
from tests.system.chaos.link import SlowLink, slow_link
from tests.system.cluster import Cluster, environment

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

MB = 1_000_000
# 8 Mbit/s; in the long round 4 Mbit/s, and as many bytes.
_RATE_BYTES_PER_S, _LOW_RATE_BYTES_PER_S = 1_000_000, 500_000
_MAX_SENT = 1.25
_MAX_SILENCE_S = 20.0
# What the link carries at least between two changes of the address. A busy machine may need longer.
_CARRIED_BYTES = 11_250_000
# Longer than the 15 s of silence after which the client closes a connection.
_DARK_S = 20.0


@dataclass(frozen=True)
class Network:
    """An instance at one end of a slow link, and a robot at the other."""

    link: SlowLink
    cluster: Cluster
    robot: Terminal

    def file(self, name: str, size_bytes: int) -> Path:
        """Make a file on the robot."""
        path = self.robot.home / name
        path.write_bytes(os.urandom(size_bytes))
        os.utime(path, (1_700_000_000, 1_700_000_000))
        return path


@pytest.fixture(scope="module", params=[_RATE_BYTES_PER_S, pytest.param(_LOW_RATE_BYTES_PER_S, marks=pytest.mark.soak)])
def network(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Network]:
    home = tmp_path_factory.mktemp("bad-link")
    with slow_link(rate_bytes_per_s=request.param) as link:
        cluster = Cluster(home)
        cluster.inside = link.command(link.lab)
        cluster.options += ["--listen", "0.0.0.0", "--public-url", f"http://{link.lab_address}:{cluster.port}"]
        try:
            cluster.start()
            (home / "robot").mkdir()
            robot = Terminal(home / "robot", environment(home / "robot"), link.command(link.robot))
            token = (cluster.data_dir / "owner-token").read_text()
            robot.run("endpoint", "add", "lab", cluster.runtime_info()["url"], stdin=token)
            robot.run("project", "create", "p")
            yield Network(link, cluster, robot)
        finally:
            cluster.end()


@dataclass
class Transfer:
    """A running transfer, and its output after its end."""

    process: "subprocess.Popen[str]"
    out: str = ""
    err: str = ""

    def end(self) -> dict[str, Any]:
        """Wait for it, and return its report."""
        self.out, self.err = self.process.communicate(timeout=240)
        assert self.process.returncode == 0, self.err
        report: dict[str, Any] = json.loads(self.out)
        return report


@contextmanager
def _running(network: Network, *arguments: object) -> Iterator[Transfer]:
    transfer = Transfer(network.robot.start(*arguments, "--json"))
    try:
        yield transfer
    finally:
        if transfer.process.poll() is None:
            transfer.process.kill()
            transfer.process.communicate()


def test_an_upload_whose_address_changes_again_and_again_keeps_the_parts_sent(network: Network) -> None:
    file = network.file("day.bin", 40 * MB)
    sent_before = network.link.up.sent_bytes
    changes: list[float] = []
    parts_seen: list[int] = []
    with _running(network, "upload", "-p", "p", "-m", "moving", "--create", file) as transfer:
        wait_until(lambda: bool(network.robot.journals()), "the upload to begin")
        carried_before = network.link.up.sent_bytes
        while transfer.process.poll() is None:
            if network.link.up.sent_bytes - carried_before >= _CARRIED_BYTES:
                carried_before = network.link.up.sent_bytes
                changes.append(time.monotonic())
                network.link.change_address()
            if parts := network.robot.parts_sent():  # the journal is deleted at the end
                parts_seen.append(parts)
            threading.Event().wait(0.05)
        ended_at = time.monotonic()
        report = transfer.end()
    assert parts_seen == sorted(parts_seen), "parts in the journal are never lost"
    assert len(changes) >= 3
    assert network.link.up.sent_bytes - sent_before <= _MAX_SENT * file.stat().st_size
    for moment in changes:
        silence_s = network.link.longest_silence_s(moment, min(moment + 2 * _MAX_SILENCE_S, ended_at))
        assert silence_s <= _MAX_SILENCE_S
    assert "this machine no longer has the address" in transfer.err
    assert f"network changed {len(changes)} times" in transfer.err
    assert report["link"]["network_changes"] == len(changes)
    network.robot.run("verify", "-p", "p", "-m", "moving", file)


def test_a_silent_link_is_detected_reported_and_used_again(network: Network) -> None:
    file = network.file("dark.bin", 11 * MB)
    sent_before = network.link.up.sent_bytes
    with _running(network, "upload", "-p", "p", "-m", "dark", "--create", file) as transfer:
        assert transfer.process.stderr is not None
        wait_until(lambda: network.robot.parts_sent() >= 1, "a part to arrive")
        went_dark_at = time.monotonic()
        network.link.dark.set()
        lines: list[str] = []
        while not any("reconnecting" in line for line in lines):
            lines.append(transfer.process.stderr.readline())
        noticed_s = time.monotonic() - went_dark_at
        threading.Event().wait(max(0.0, _DARK_S - noticed_s))
        network.link.dark.clear()
        lit_at = time.monotonic()
        report = transfer.end()
        ended_at = time.monotonic()
    assert noticed_s <= 16
    assert lines[-1].startswith(f"no answer for 15 s from {network.link.lab_address}:")
    assert "connected again after" in transfer.err
    assert report["link"]["connections_lost"] >= 1
    assert report["link"]["longest_outage_s"] >= 15
    assert network.link.longest_silence_s(lit_at, ended_at) <= _MAX_SILENCE_S
    assert network.link.up.sent_bytes - sent_before <= _MAX_SENT * file.stat().st_size


def test_a_download_continues_at_the_byte_where_the_address_changed(network: Network, tmp_path: Path) -> None:
    file = network.file("back.bin", 8 * MB)
    lab = Terminal(
        network.cluster.home,
        environment(network.cluster.home, KLEINKRAM_DATA_DIR=str(network.cluster.data_dir)),
        network.link.command(network.link.lab),
    )
    lab.run("upload", "-p", "p", "-m", "back", "--create", file)
    sent_before = network.link.down.sent_bytes
    with _running(network, "download", "-p", "p", "-m", "back", "--dest", tmp_path) as transfer:
        wait_until(lambda: network.link.down.sent_bytes - sent_before > 4 * MB, "half of the file to come")
        changed_at = time.monotonic()
        network.link.change_address()
        report = transfer.end()
        ended_at = time.monotonic()
    assert filecmp.cmp(file, tmp_path / "back.bin", shallow=False)
    assert report["link"]["network_changes"] == 1
    assert network.link.longest_silence_down_s(changed_at, ended_at) <= _MAX_SILENCE_S
    assert network.link.down.sent_bytes - sent_before <= _MAX_SENT * file.stat().st_size


def test_a_router_that_drops_its_connections_is_detected_without_a_change_of_address(network: Network) -> None:
    file = network.file("router.bin", 8 * MB)
    with _running(network, "upload", "-p", "p", "-m", "router", "--create", file) as transfer:
        wait_until(lambda: network.robot.parts_sent() >= 1, "a part to arrive")
        forgotten_at = time.monotonic()
        network.link.forget_connections()
        transfer.end()
        ended_at = time.monotonic()
    assert "old connections get no answer and new ones do" in transfer.err
    assert network.link.longest_silence_s(forgotten_at, ended_at) <= 10
    network.robot.run("verify", "-p", "p", "-m", "router", file)
