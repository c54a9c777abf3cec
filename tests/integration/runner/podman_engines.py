"""A Podman service for tests, in a mount namespace that hides the machine's own.

What Podman keeps below `/run` and `/dev/shm`, and all that it mounts, is gone with the namespace. Debian's programs,
Debian's settings: but for where things are, and a network without rules in this machine's firewall.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.integration.runner.engines import Dockerd
from tests.requirements import path_of

PROGRAMS = ("podman", "crun", "catatonit", "docker", "docker-registry", "ip")
# Where control groups are of both versions at once, crun wants those of the second out of its sight.
_NAMESPACE_SCRIPT = """
if mountpoint -q /sys/fs/cgroup/unified; then umount /sys/fs/cgroup/unified; fi
mount -t tmpfs none /run && mount -t tmpfs none /dev/shm && echo made && exec sleep infinity
"""
_SETTINGS = """
[engine]
cgroup_manager = "cgroupfs"
events_logger = "file"
[network]
network_backend = "cni"
network_config_dir = "{folder}/networks"
"""


class Podman(Dockerd):
    """A Podman service for tests. Its containers are children of init: they continue without the service."""

    def start(self) -> None:
        """Start its service, again after `kill`, and wait until it answers."""
        if self.containerd is None:
            self._write_configuration()
            self.containerd = self._start_namespace()
        service = ("system", "service", "--time", "0", f"unix://{self.socket}")
        self.process = self._run(
            *("nsenter", f"--mount=/proc/{self.containerd.pid}/ns/mnt"),
            *("podman", "--root", self.folder / "data", "--storage-driver", "overlay", *service),
            CONTAINERS_CONF=str(self.folder / "containers.conf"),
            CONTAINERS_REGISTRIES_CONF=str(self.folder / "registries.conf"),
        )
        self.wait_until_it_answers(self.process, "nsenter")

    def _write_configuration(self) -> None:
        (self.folder / "containers.conf").write_text(_SETTINGS.format(folder=self.folder))
        (self.folder / "registries.conf").write_text('[[registry]]\nlocation = "127.0.0.1"\ninsecure = true\n')
        (self.folder / "networks").mkdir(exist_ok=True)
        subnet = f"{self.gateway.rpartition('.')[0]}.0/24"
        addresses = {"type": "host-local", "ranges": [[{"subnet": subnet}]], "dataDir": str(self.folder / "addresses")}
        plugin = {"type": "bridge", "bridge": self.bridge, "ipam": addresses}
        network = {"cniVersion": "0.4.0", "name": "podman", "plugins": [plugin]}
        (self.folder / "networks" / "podman.conflist").write_text(json.dumps(network))

    def _start_namespace(self) -> subprocess.Popen[bytes]:
        unshare = path_of("unshare")
        assert unshare is not None
        words = [unshare, "--mount", "--propagation", "slave", "sh", "-ec", _NAMESPACE_SCRIPT]
        made = subprocess.Popen(words, stdout=subprocess.PIPE, start_new_session=True)
        assert made.stdout is not None
        with made.stdout as values:
            assert values.readline() == b"made\n"
        return made

    def load(self, name: str, *changes: str, root: bytes) -> str:
        """Make an image of the files of a tar, and return its id."""
        # What it says first is progress.
        return super().load(name, *changes, root=root).split()[-1]

    def write_cdi(self, specification: str) -> None:
        """Describe devices to it: only its mount namespace has this file."""
        assert self.containerd is not None
        script = "mkdir -p /run/cdi && cat > /run/cdi/tests.json"
        subprocess.run(
            ["nsenter", f"--mount=/proc/{self.containerd.pid}/ns/mnt", "sh", "-c", script],
            input=specification.encode(),
            check=True,
        )

    def go_down(self) -> None:
        """End all at once, as the machine does that goes down: what is not on a disk is gone."""
        result = [self.engine.find_container(name) for name, _ in self.engine.list_labelled("kleinkram.run")]
        self.kill()
        assert self.containerd is not None
        mine = _mounts_of(self.containerd.pid)
        here = [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]
        # Monitors first: they would write down how their containers ended.
        for pid in [
            *(entry for entry in here if _mounts_of(entry) == mine),
            *(entry.pid for entry in result if entry is not None and entry.pid),
        ]:
            os.kill(pid, signal.SIGKILL)
        self.containerd.wait()
        self.containerd = None


def _mounts_of(pid: int) -> int | None:
    try:
        return Path(f"/proc/{pid}/ns/mnt").stat().st_ino
    except OSError:
        return None


@contextmanager
def podman(bridge: str, gateway: str) -> Iterator[Podman]:
    """Start a Podman service in its own folder, which is removed afterwards."""
    with tempfile.TemporaryDirectory(prefix="klein-podman-") as folder:
        made = Podman(Path(folder), bridge, gateway)
        made.start()
        try:
            yield made
        finally:
            made.end()
