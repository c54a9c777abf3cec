"""Another machine, as a network namespace: its own loopback and routes, and one link to this machine."""

import os
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.acceptance.conftest import Terminal
from tests.requirements import missing, need
from tests.system.cluster import Cluster, environment


@dataclass(frozen=True)
class OtherMachine:
    """A machine that reaches this one at `our_address`, and nothing else."""

    name: str
    our_address: str

    def terminal(self, home: Path, **more: str) -> Terminal:
        """A terminal on that machine, without configuration."""
        return Terminal(home, environment(home, **more), tuple(self.command()))

    def command(self, *arguments: str) -> list[str]:
        """Return the command line that runs a program on that machine."""
        return ["ip", "netns", "exec", self.name, *arguments]


@pytest.fixture(scope="session")
def other_machine() -> Iterator[OtherMachine]:
    """The other machine. Skips, or fails if all requirements are mandatory, if this machine cannot create it."""
    _require_ip()
    number = os.getpid() % 16_384
    ours, theirs = (f"10.231.{number // 64}.{number % 64 * 4 + host}" for host in (1, 2))
    machine = OtherMachine(f"klein-{os.getpid()}", ours)
    cable, far_end = f"kl{os.getpid()}a", f"kl{os.getpid()}b"
    try:
        _ip("netns", "add", machine.name)
        _ip("link", "add", cable, "type", "veth", "peer", "name", far_end, "netns", machine.name)
        _ip("address", "add", f"{ours}/30", "dev", cable)
        _ip("link", "set", cable, "up")
        for words in (f"address add {theirs}/30 dev {far_end}", f"link set {far_end} up", "link set lo up"):
            _ip("-netns", machine.name, *words.split())
        yield machine
    finally:
        subprocess.run(["ip", "netns", "delete", machine.name], check=False, capture_output=True)  # and its link


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """A Kleinkram that is not started yet; ended after the test."""
    cluster = Cluster(tmp_path)
    yield cluster
    cluster.end()


@pytest.fixture(scope="module")
def shared_cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A running Kleinkram for all tests of a module: to start one takes as much CPU time as a short test.

    Each test has a project of its own name. None kills, restarts or configures the server, nor asserts what it has
    altogether: all projects, people, runs.
    """
    cluster = Cluster(tmp_path_factory.mktemp("shared"))
    try:
        cluster.start()
        yield cluster
    finally:
        cluster.end()


def _require_ip() -> None:
    if os.geteuid() != 0:
        missing("a second machine is made of a network namespace, which only root may make")
    need("ip")
    trial = f"klein-trial-{os.getpid()}"
    allowed = subprocess.run(["ip", "netns", "add", trial], check=False, capture_output=True, text=True)
    if allowed.returncode != 0:
        missing(f"network namespaces are not allowed here: {allowed.stderr.strip()}")
    _ip("netns", "delete", trial)


def _ip(*arguments: str) -> None:
    done = subprocess.run(["ip", *arguments], check=False, capture_output=True, text=True)
    assert done.returncode == 0, f"ip {' '.join(arguments)}: {done.stderr}"
