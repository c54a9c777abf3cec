"""A Debian machine without a network, with systemd as its first process: `systemd-nspawn --boot`."""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import platformdirs
import psutil

from tests.integration.upload_client import wait_until
from tests.requirements import missing, need

ROOT = Path(__file__).parents[3]
_SYSTEM = "systemd,systemd-sysv,dbus,ca-certificates,iproute2"
# What the page installs. They are there before, because the machine has no network.
_PACKAGES = ("python3-venv", "postgresql", "nginx", "ca-certificates")
_PYTHON = "3.11"  # of this Debian
_BOOT_S, _STOP_S = 120, 90
_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


@dataclass
class Machine:
    """A machine whose disk is a folder."""

    disk: Path
    _process: "subprocess.Popen[bytes] | None" = field(default=None, init=False)

    def boot(self) -> None:
        """Start it; returns when all that starts at boot has started."""
        name = f"klein-test-{os.getpid()}"  # another session may have a machine
        options = ["--quiet", "--register=no", "--keep-unit", "--private-network", "--console=pipe"]
        command = ["systemd-nspawn", "--boot", *options, f"--machine={name}", "--directory", str(self.disk)]
        with self.disk.with_name("console").open("ab") as console:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=console, stderr=console)
        wait_until(lambda: self._is_started(), limit_s=_BOOT_S)

    def stop(self) -> None:
        """Shut it down."""
        if self._process is not None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def run(self, script: str, *, timeout_s: float = 240) -> str:
        """Run a Bash script as root, and return its output; its commands must succeed."""
        done = self._enter("bash", "-euo", "pipefail", "-c", script, timeout_s=timeout_s)
        assert done.returncode == 0, f"{script}\n{done.stdout[-6000:]}"
        return done.stdout

    def property_of(self, unit: str, name: str) -> str:
        """Return a property of a unit."""
        return self.run(f"systemctl show --property={name} --value {unit}").strip()

    def _is_started(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, self.disk.with_name("console").read_text()
        return self._enter("systemctl", "is-system-running", timeout_s=30).stdout.strip() in {"running", "degraded"}

    def _enter(self, *command: str, timeout_s: float) -> "subprocess.CompletedProcess[str]":
        assert self._process is not None
        (first, *_) = [*psutil.Process(self._process.pid).children(), None]
        if first is None:  # not started yet
            return subprocess.CompletedProcess(command, 1, "")
        environment = {"PATH": _PATH, "HOME": "/root", "LANG": "C.UTF-8"}
        return subprocess.run(
            ["nsenter", "--all", f"--target={first.pid}", *command],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            timeout=timeout_s,
        )


@contextmanager
def machine() -> Iterator[Machine]:
    """A running machine with Debian, and in /root the wheel of this clone and a folder of the wheels that it needs."""
    if os.geteuid() != 0:
        missing("only root can start a container with systemd")
    need("systemd-nspawn", "debootstrap")
    with tempfile.TemporaryDirectory(prefix="klein-machine-") as name:
        started = Machine(Path(name, "disk"))
        started.disk.mkdir()
        subprocess.run(["tar", "--numeric-owner", "-C", started.disk, "-xf", _debian()], check=True)
        _build_wheels(started.disk / "root")
        try:
            started.boot()
            yield started
        finally:
            started.stop()


def _debian() -> Path:
    """Return a tar of Debian with the packages. Making it takes minutes, so it is kept for later sessions."""
    tar = platformdirs.user_cache_path("kleinkram-tests") / "debian-bookworm-systemd.tar"
    if not tar.exists():
        tar.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="klein-debian-") as name:
            root, packed = Path(name, "root"), tar.with_suffix(f".{os.getpid()}")
            _quietly("debootstrap", "--variant=minbase", f"--include={_SYSTEM}", "bookworm", str(root))
            (root / "usr/sbin/policy-rc.d").write_text("#!/bin/sh\nexit 101\n")  # services start at boot, not here
            (root / "usr/sbin/policy-rc.d").chmod(0o755)
            _quietly("chroot", str(root), "apt-get", "install", "-y", *_PACKAGES)
            (root / "usr/sbin/policy-rc.d").unlink()
            _quietly("chroot", str(root), "apt-get", "clean")
            _quietly("tar", "--numeric-owner", "-C", str(root), "-cf", str(packed), ".")
            packed.rename(tar)
    return tar


def _build_wheels(folder: Path) -> None:
    """Build the wheel as the page says, and download what its installation needs."""
    python = [sys.executable, "-m", "pip"]
    _quietly(*python, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(ROOT))
    (wheel,) = folder.glob("*.whl")
    options = ["--only-binary", ":all:", "--python-version", _PYTHON, "--dest", str(folder / "wheels")]
    _quietly(*python, "download", *options, f"{wheel}[server,store,backup]")


def _quietly(*command: str) -> None:
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}
    done = subprocess.run(
        command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
