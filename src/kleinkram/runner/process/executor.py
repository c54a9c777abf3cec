"""The executor of processes: what a runner knows of wardens."""

import json
import os
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Collection
from pathlib import Path

from kleinkram.action.places import IN_VARIABLE, OUT_VARIABLE
from kleinkram.contract.actions import Network
from kleinkram.contract.runners import Abilities, Isolation
from kleinkram.contract.runs import LOG_BYTES, EndReason, Usage
from kleinkram.runner.process import room, warden
from kleinkram.runner.work import GRACE_S, CannotStart, Ending, ImagePinned, Work

_PROCESS = "warden.json"
# As root, each run is a uid of its own, of those that no system gives to anybody.
_FIRST_UID = 1_000_000_000
_UIDS = 1_000_000_000
_LOOK_EVERY_S = 0.02
_NO_IMAGES = Ending(EndReason.not_possible, "Without an engine of containers, no image can be run.")
_LOST = Ending(EndReason.lost, "Its processes were killed together with the one that watched them.")


class ProcessExecutor:
    """Runs commands as processes, in rooms where the kernel gives them."""

    def __init__(self) -> None:
        self._is_isolated = room.can_be_made()
        self._wardens: dict[str, subprocess.Popen[bytes]] = {}

    @property
    def abilities(self) -> Abilities:
        """What it can do here. Without a room, a run reads and reaches whatever its runner does."""
        networks = {Network.none, Network.open} if self._is_isolated else {Network.open}
        return Abilities(
            executor="process",
            isolation=Isolation.namespaces if self._is_isolated else Isolation.none,
            images=False,
            networks=frozenset(networks),
            gpus=False,
            bounds_memory=True,
            bounds_disk=True,
        )

    def prepare(self, image: str) -> ImagePinned:
        """Run no image.

        Raises:
            CannotStart: always.
        """
        raise CannotStart(_NO_IMAGES)

    def start(self, work: Work) -> None:
        """Start a run and return while it lasts.

        Raises:
            CannotStart: it asks for an image, or for what this machine does not give; its command is not there.
        """
        if work.image is not None:
            raise CannotStart(_NO_IMAGES)
        if work.network not in self.abilities.networks:
            message = f"Without an engine of containers, no run here has the network {work.network.value!r}."
            raise CannotStart(Ending(EndReason.not_possible, message))
        self._prepare(work)
        told, telling = os.pipe()
        with (work.folder / "warden.log").open("ab") as trouble:
            started = subprocess.Popen(
                [sys.executable, "-I", "-m", warden.__name__, str(work.folder)],
                stdin=subprocess.DEVNULL,
                stdout=telling,
                stderr=trouble,
                env={"PATH": os.defpath},
                start_new_session=True,
            )
        os.close(telling)
        self._wardens[work.key] = started
        (work.folder / _PROCESS).write_text(json.dumps({"pid": started.pid, "began": _began(started.pid)}))
        with os.fdopen(told, "rb") as words:
            is_started = words.readline() == b"started\n"
        if not is_started:
            ending = self.wait(work, timeout_s=GRACE_S) or _LOST
            raise CannotStart(ending)

    def wait(self, work: Work, timeout_s: float) -> Ending | None:
        """Return how a run ended, or None if it goes on for longer than `timeout_s`."""
        until = time.monotonic() + timeout_s
        while self._is_watched(work):
            if time.monotonic() >= until:
                return None
            time.sleep(_LOOK_EVERY_S)
        try:
            said = json.loads((work.folder / warden.ENDING).read_text())
        except FileNotFoundError:
            return _LOST
        return Ending(EndReason(said["reason"]), said["message"], said["exit_code"])

    def stop(self, work: Work) -> None:
        """Ask a run to end, and kill it `GRACE_S` later; return at once. Nothing happens to one that is over."""
        self._signal(work, signal.SIGTERM)

    def usage(self, work: Work) -> Usage | None:
        """Return what a run uses, or did until it was over; None before it has begun."""
        try:
            return Usage(**json.loads((work.folder / warden.USAGE).read_text()))
        except FileNotFoundError:
            return None

    def remove(self, work: Work) -> None:
        """Kill what is left of a run and forget it; its folder stays."""
        self._signal(work, signal.SIGKILL)
        while self._is_watched(work):
            time.sleep(_LOOK_EVERY_S)
        known = self._wardens.pop(work.key, None)
        if known is not None:
            known.wait()

    def sweep(self, known: Collection[str]) -> None:
        """Do nothing: a run of which nobody knows the folder ends by itself, with its time."""

    def _prepare(self, work: Work) -> None:
        uid = _FIRST_UID + zlib.crc32(work.key.encode()) % _UIDS if os.getuid() == 0 and self._is_isolated else None
        for name in ("in", "out", "tmp"):
            (work.folder / name).mkdir(exist_ok=True)
            if uid is not None and name != "in":
                os.chown(work.folder / name, uid, uid)
        environment = {"PATH": os.environ.get("PATH", os.defpath), "LANG": "C.UTF-8", "PYTHONUNBUFFERED": "1"}
        environment |= {"HOME": "/tmp", "TMPDIR": "/tmp"}  # noqa: S108  the run's own
        if not self._is_isolated:
            places = {name: str(work.folder / name) for name in ("in", "out", "tmp")}
            environment |= {IN_VARIABLE: places["in"], OUT_VARIABLE: places["out"]}
            environment |= {"TMPDIR": places["tmp"], "HOME": places["tmp"]}
        task = {
            "command": list(work.command),
            "environment": {**environment, **work.environment},
            "is_isolated": self._is_isolated,
            "has_network": work.network is Network.open,
            "uid": uid,
            "memory_bytes": work.resources.memory_bytes,
            "disk_bytes": work.resources.disk_bytes,
            "time_s": work.resources.time_s,
            "log_bytes": LOG_BYTES,
            "grace_s": GRACE_S,
        }
        path = work.folder / warden.WORK
        path.touch(mode=0o600)
        path.write_text(json.dumps(task))

    def _is_watched(self, work: Work) -> bool:
        child = self._wardens.get(work.key)
        if child is not None:
            return child.poll() is None
        return self._pid(work) is not None

    def _pid(self, work: Work) -> int | None:
        """Return the warden's process, also of an earlier runner's; None where it is over."""
        try:
            said = json.loads((work.folder / _PROCESS).read_text())
        except FileNotFoundError:
            return None
        # A number is given to others later: only with its time of birth is it the same process.
        is_same = said["began"] is not None and _began(said["pid"]) == said["began"]
        return int(said["pid"]) if is_same else None

    def _signal(self, work: Work, sign: signal.Signals) -> None:
        if not self._is_watched(work):
            return
        pid = self._pid(work)
        if pid is not None:
            try:
                os.kill(pid, sign)
            except ProcessLookupError:
                return


def _began(pid: int) -> str | None:
    """When a process began, in ticks since the machine did; None where it is over, though nobody reaped it yet."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] == "Z" else fields[19]
