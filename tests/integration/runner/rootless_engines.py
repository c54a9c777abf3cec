"""Engines of an ordinary user, for tests: in a mount namespace where that user exists, with a range of ids of its own.

All their processes have ids of this range, and are ended by that.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.integration.runner import engines
from tests.integration.runner.engines import Dockerd
from tests.requirements import path_of

PROGRAMS = ("podman", "crun", "catatonit", "docker", "dockerd", "rootlesskit", "newuidmap", "slirp4netns", "setpriv")
_IDS = 65536
# Debian's; it is in no folder of programs.
DOCKERD_ROOTLESS = Path("/usr/share/docker.io/contrib/dockerd-rootless.sh")
_NAMESPACE_SCRIPT = """
for name in passwd group subuid subgid; do mount --bind "$1/etc/$name" /etc/$name; done
if mountpoint -q /sys/fs/cgroup/unified; then umount /sys/fs/cgroup/unified; fi
mount -t tmpfs none /run && mkdir -p "/run/user/$2" && chown "$2:$2" "/run/user/$2"
mount -t tmpfs -o mode=1777 none /dev/shm
mount -t tmpfs none /dev/net && mknod -m 666 /dev/net/tun c 10 200
echo made && exec sleep infinity
"""


class RootlessEngine(Dockerd):
    """An engine of an ordinary user. `user` is that user's id."""

    @property
    def user(self) -> int:
        # Nobody has these, and no run of a runner that is root; each test process has others.
        return 100_000_000 + os.getpid() % 5_000 * 2 * _IDS

    @property
    def runtime_folder(self) -> str:
        return f"/run/user/{self.user}"

    def enter(self) -> subprocess.Popen[bytes]:
        """Make the namespace."""
        etc = self.folder / "etc"
        etc.mkdir()
        passwd, group = (Path("/etc", name).read_text() for name in ("passwd", "group"))
        (etc / "passwd").write_text(f"{passwd}kltest:x:{self.user}:{self.user}::{self.folder}:/bin/sh\n")
        (etc / "group").write_text(f"{group}kltest:x:{self.user}:\n")
        for name in ("subuid", "subgid"):
            (etc / name).write_text(f"kltest:{self.user + 1}:{_IDS}\n")
        os.chown(self.folder, self.user, self.user)
        unshare = path_of("unshare")
        assert unshare is not None
        words = [unshare, "--mount", "--propagation", "slave", "sh", "-ec", _NAMESPACE_SCRIPT]
        made = subprocess.Popen(
            [*words, "namespace", str(self.folder), str(self.user)], stdout=subprocess.PIPE, start_new_session=True
        )
        assert made.stdout is not None
        with made.stdout as output:
            assert output.readline() == b"made\n"
        return made

    def run_as_user(self, *words: str | Path) -> subprocess.Popen[bytes]:
        """Start a program as the user, in the namespace."""
        assert self.containerd is not None
        become = ("setpriv", "--reuid", str(self.user), "--regid", str(self.user), "--clear-groups")
        namespace = f"--mount=/proc/{self.containerd.pid}/ns/mnt"
        return self._run("nsenter", namespace, *become, *words, XDG_RUNTIME_DIR=self.runtime_folder, USER="kltest")

    def end(self) -> None:
        """End all processes of the user and of the range of its ids, and the namespace."""
        while pids := self._pids():
            for pid in pids:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            assert self.process is not None
            self.process.poll()
        assert self.containerd is not None
        self.containerd.kill()
        self.containerd.wait()
        assert self.process is not None
        self.process.wait()

    def _pids(self) -> list[int]:
        pids = []
        for entry in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                values = dict(line.split(":\t", 1) for line in (entry / "status").read_text().splitlines())
                own = int(values["Uid"].split()[0])
                if 0 <= own - self.user <= _IDS and not values["State"].startswith("Z"):
                    pids.append(int(entry.name))
        return pids


class RootlessPodman(RootlessEngine):
    """A Podman service of an ordinary user."""

    def start(self) -> None:
        """Start it, and wait until it answers."""
        self.containerd = self.enter()
        settings = self.folder / ".config" / "containers"
        settings.mkdir(parents=True)
        (settings / "containers.conf").write_text('[engine]\nevents_logger = "file"\n')
        self.process = self.run_as_user(
            "podman", "--storage-driver", "overlay", "system", "service", "--time", "0", f"unix://{self.socket}"
        )
        self.wait_until_it_answers(self.process, "nsenter")


class RootlessDockerd(RootlessEngine):
    """A Docker daemon of an ordinary user."""

    def start(self) -> None:
        """Start it, and wait until it answers."""
        self.containerd = self.enter()
        (self.folder / "none.json").write_text("{}")
        self.process = self.run_as_user(
            *("sh", DOCKERD_ROOTLESS, "--host", f"unix://{self.socket}", "--config-file", self.folder / "none.json"),
            *("--data-root", self.folder / "data"),
        )
        self.wait_until_it_answers(self.process, "nsenter")


@contextmanager
def rootless(kind: type[RootlessEngine]) -> Iterator[RootlessEngine]:
    """Start an engine of an ordinary user in its own folder, which is removed afterwards."""
    with tempfile.TemporaryDirectory(prefix="klein-rootless-") as folder:
        made = kind(Path(folder))
        try:
            made.start()
            made.load(engines.IMAGE, root=engines.python_root())
            yield made
        finally:
            made.end()


def call_as(user: int, function: Callable[[], Any]) -> Any:
    """Return what a function returns in a child process of an ordinary user, as JSON."""
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reader)
            os.setgroups([])
            os.setresgid(user, user, user)
            os.setresuid(user, user, user)
            with os.fdopen(writer, "w") as stream:
                stream.write(json.dumps(function()))
            os._exit(0)
        finally:
            os._exit(1)
    os.close(writer)
    with os.fdopen(reader) as stream:
        text = stream.read()
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0, "it failed as this user"
    return json.loads(text)
