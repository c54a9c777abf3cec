"""The units of `deploy/systemd`, read as systemd reads them, and a service manager for one process of a unit."""

import os
import re
import resource
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from kleinkram.runner.executors import linux_syscalls
from tests.integration.deploy.restrictions import Restrictions

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "deploy" / "systemd"
NAMES = sorted(path.name for path in FOLDER.glob("*.service"))
_TIMEOUT_S = 60
# Source: linux/capability.h.
_CAPABILITIES = {"CHOWN": 0, "DAC_OVERRIDE": 1, "FOWNER": 3, "KILL": 5, "SETGID": 6, "SETUID": 7, "NET_ADMIN": 12}
_CAPABILITIES |= {"SYS_CHROOT": 18, "SYS_PTRACE": 19, "SYS_ADMIN": 21, "SYS_RESOURCE": 24}
_NAMESPACES = {
    "cgroup": 0x02000000,
    "ipc": linux_syscalls.CLONE_NEWIPC,
    "mnt": linux_syscalls.CLONE_NEWNS,
    "net": linux_syscalls.CLONE_NEWNET,
    "pid": linux_syscalls.CLONE_NEWPID,
    "user": linux_syscalls.CLONE_NEWUSER,
    "uts": linux_syscalls.CLONE_NEWUTS,
}


@dataclass(frozen=True)
class Unit:
    """The settings of a unit's `[Service]` section, in order; `instance` is what follows its @."""

    name: str
    instance: str
    settings: tuple[tuple[str, str], ...]

    def values(self, name: str) -> list[str]:
        """Return the values of a setting."""
        return [value.replace("%i", self.instance) for key, value in self.settings if key == name]

    def value(self, name: str, default: str = "") -> str:
        """Return the last value of a setting."""
        return (self.values(name) or [default])[-1]

    def environment(self, credentials: Path) -> dict[str, str]:
        """Return the variables that the unit itself sets."""
        words = [word for line in self.values("Environment") for word in shlex.split(line)]
        pairs = dict(word.replace("%d", str(credentials)).split("=", 1) for word in words)
        return {**pairs, "CREDENTIALS_DIRECTORY": str(credentials)}

    def commands(self, environment: Mapping[str, str]) -> list[list[str]]:
        """Return its command lines, with the programs of this virtual environment."""
        return [[*_words(line, environment)] for line in self.values("ExecStart")]

    def restrictions(self, *, shown: list[Path], writable: list[Path], uid: int = 0) -> Restrictions:
        """Return what it restricts."""
        proc = ("subset=pid",) * (self.value("ProcSubset") == "pid")
        proc += ("hidepid=invisible",) * (self.value("ProtectProc") == "invisible")
        allowed = self.value("RestrictNamespaces", "yes")
        names = [] if allowed == "yes" else allowed.split()
        limits = {getattr(resource, f"RLIMIT_{name}"): self.value(f"Limit{name}") for name in ("NOFILE", "CORE")}
        capabilities = self.value("CapabilityBoundingSet").split()
        return Restrictions(
            shown=[str(path) for path in shown],
            writable=[str(path) for path in writable],
            has_private_tmp=self.value("PrivateTmp") == "yes",
            proc_options=",".join(proc),
            capabilities=[_CAPABILITIES[name.removeprefix("CAP_")] for name in capabilities],
            system_calls=sorted(_allowed_calls(self.values("SystemCallFilter"))),
            address_families=[int(getattr(socket, name, 16)) for name in self.value("RestrictAddressFamilies").split()],
            refused_namespaces=sum(flag for name, flag in _NAMESPACES.items() if name not in names),
            uid=uid,
            denies_write_execute=self.value("MemoryDenyWriteExecute") == "yes",
            limits={name: int(limit) for name, limit in limits.items() if limit},
        )


def load_unit(name: str) -> Unit:
    """Read a unit; `kleinkram-api@8000.service` reads the template."""
    template, at, instance = name.removesuffix(".service").partition("@")
    lines = (FOLDER / f"{template}{at}.service").read_text().splitlines()
    service = lines[lines.index("[Service]") + 1 :]
    end = next((number for number, line in enumerate(service) if line.startswith("[")), len(service))
    pairs = [line.split("=", 1) for line in service[:end] if line and not line.startswith("#")]
    return Unit(name, instance, tuple((key, value) for key, value in pairs))


def example_settings(name: str) -> dict[str, str]:
    """Return the variables of an example of an environment file."""
    lines = (FOLDER / f"{name}.env.example").read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))


def _words(line: str, environment: Mapping[str, str]) -> Iterator[str]:
    """Split a command line. Source: systemd.service(5), "Command lines"."""
    for word in shlex.split(line.replace("/opt/kleinkram/bin/", f"{Path(sys.executable).parent}/")):
        if word.startswith("$") and not word.startswith("${"):
            yield from environment.get(word[1:], "").split()
        else:
            yield re.sub(r"\$\{(\w+)\}", lambda match: environment.get(match[1], ""), word)


@cache
def _calls_of(group: str) -> frozenset[str]:
    done = subprocess.run(["systemd-analyze", "syscall-filter", group], check=True, capture_output=True, text=True)
    names = [line.strip() for line in done.stdout.splitlines()[1:] if line.strip() and not line.strip().startswith("#")]
    return frozenset().union(*(_calls_of(name) if name.startswith("@") else {name} for name in names))


def _allowed_calls(filters: list[str]) -> set[str]:
    allowed = set(_calls_of("@default"))
    for line in filters:
        calls = {call for word in line.lstrip("~").split() for call in (_calls_of(word) if word[0] == "@" else {word})}
        allowed = allowed - calls if line.startswith("~") else allowed | calls
    return allowed


@dataclass
class Service:
    """A process, and the messages that it has sent to its service manager."""

    process: "subprocess.Popen[bytes]"
    log: Path
    messages: list[str] = field(default_factory=list)
    listener: socket.socket = field(default_factory=lambda: socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))

    def wait_for(self, message: str, *, times: int = 1) -> None:
        """Wait until it has sent a message so many times from now on."""
        deadline, remaining = time.monotonic() + _TIMEOUT_S, times
        while remaining:
            assert self.process.poll() is None, self.log.read_text()[-4000:]
            assert time.monotonic() < deadline, (
                f"{message} not received: {self.messages}\n{self.log.read_text()[-4000:]}"
            )
            remaining -= message in self.receive(timeout_s=1)

    def receive(self, *, timeout_s: float) -> list[str]:
        """Return the lines of the next datagram; none if there is none in time."""
        self.listener.settimeout(timeout_s)
        try:
            lines = self.listener.recv(4096).decode().splitlines()
        except TimeoutError:
            return []
        self.messages += lines
        return lines

    def stop(self) -> int:
        """Stop it as systemd does, which reads its messages meanwhile; return its exit code."""
        self.process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + _TIMEOUT_S
        while self.process.poll() is None and time.monotonic() < deadline:
            self.receive(timeout_s=0.1)
        assert self.process.poll() is not None, f"it does not stop: {self.log.read_text()[-4000:]}"
        return self.process.returncode


@contextmanager
def running(
    unit: Unit,
    folder: Path,
    environment: Mapping[str, str],
    *,
    watchdog_s: float,
    restrict: Callable[[list[str]], list[str]],
) -> Iterator[Service]:
    """Run the unit's command with its environment, and a notification socket in `folder`."""
    address = folder / "notify"
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(str(address))
    sent = {"NOTIFY_SOCKET": str(address), "WATCHDOG_USEC": str(round(watchdog_s * 1e6))}
    (command,) = unit.commands(environment)
    log = folder / "log"
    with log.open("ab") as file:
        process = subprocess.Popen(restrict(command), env={**environment, **sent}, cwd=ROOT, stdout=file, stderr=file)
    try:
        yield Service(process, log, listener=listener)
    finally:
        process.kill()
        process.wait()
        listener.close()
        address.unlink()


def clean_environment() -> dict[str, str]:
    """Return this process's environment without variables of Kleinkram: what a unit starts with, and Python's."""
    names = ("PATH", "PYTHONPATH", "LANG", "HOME")
    return {name: os.environ[name] for name in names if name in os.environ}
