"""The runner's side of wardens: starts one per run, hears how the run ended, and finds it again after a restart.

A *warden* is a process that starts one run, bounds it and writes down how it ended. It outlives the runner.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Mapping
from typing import IO

from kleinkram.contract.runs import LOG_BYTES, EndReason, Usage
from kleinkram.runner import doors, ward
from kleinkram.runner.work import GRACE_S, CannotStart, Ending, Work

_PROCESS = "warden.json"
# As root, each run is a uid of its own, of those that no system gives to anybody.
_FIRST_UID = 1_000_000_000
_UIDS = 1_000_000_000
_LOOK_EVERY_S = 0.02
_MAX_WARDENS = 5
_LOST = Ending(EndReason.lost, "Its processes were killed together with the one that watched them.")


def make_folders(work: Work, *, is_root: bool) -> int | None:
    """Make the folders of a run, and return the uid that it shall be: None where this process can give it none."""
    uid = _FIRST_UID + zlib.crc32(work.key.encode()) % _UIDS if is_root else None
    for name in ("in", "out", "tmp"):
        (work.folder / name).mkdir(exist_ok=True)
        if uid is not None and name != "in":
            os.chown(work.folder / name, uid, uid)
    return uid


def check_doors(work: Work) -> None:
    """Refuse doors that cannot be made.

    Raises:
        CannotStart: a host is an IPv6 address.
    """
    try:
        doors.addresses_of([door.host for door in work.doors])
    except ValueError as error:
        raise CannotStart(Ending(EndReason.not_possible, f"Its network cannot be given here: {error}.")) from error


class Wardens:
    """Wardens of one kind: `module` is run with a run's folder. `outlived`: what they watch goes on without them."""

    def __init__(self, module: str, *, outlived: bool) -> None:
        self._module = module
        self._outlived = outlived
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._spawned: dict[str, int] = {}
        self._lock = threading.Lock()

    def start(self, work: Work, task: Mapping[str, object]) -> None:
        """Have a run started, and return while it lasts. `task` is what the warden is told besides the bounds.

        Raises:
            CannotStart: it cannot be started.
            OSError: there is no room for what its warden is told.
        """
        bounds = {
            "memory_bytes": work.resources.memory_bytes,
            "disk_bytes": work.resources.disk_bytes,
            "time_s": work.resources.time_s,
            "log_bytes": LOG_BYTES,
            "grace_s": GRACE_S,
            "doors": [vars(door) for door in work.doors],
        }
        ward.write_whole(work.folder / ward.WORK, {**bounds, **task})
        # However full the disk is by then, how it ended is told.
        ward.reserve(work.folder / ward.ENDING)
        if not self._spawn(work):
            raise CannotStart(self.wait(work, timeout_s=GRACE_S) or _LOST)

    def wait(self, work: Work, timeout_s: float) -> Ending | None:
        """Return how a run ended, or None if it goes on for longer than `timeout_s`."""
        until = time.monotonic() + timeout_s
        while True:
            # In this order: a warden leaves its word before it goes.
            is_watched = self._is_watched(work)
            ending = _ending(work)
            if not is_watched and (ending is not None or not self._watch_again(work)):
                return ending or _LOST
            if time.monotonic() >= until:
                return None
            time.sleep(_LOOK_EVERY_S)

    def stop(self, work: Work) -> None:
        """Ask a run to end, and kill it `GRACE_S` later; return at once. Nothing happens to one that is over.

        Raises:
            OSError: this machine does not let it be asked now; it may be tried again.
        """
        if not self._is_watched(work) and _ending(work) is None:
            self._watch_again(work)
        self._signal(work, signal.SIGTERM)

    def usage(self, work: Work) -> Usage | None:
        """Return what a run uses, or did until it was over; None before it has begun."""
        try:
            return Usage(**json.loads((work.folder / ward.USAGE).read_text()))
        except FileNotFoundError:
            return None

    def remove(self, work: Work) -> None:
        """Kill a run's warden, and let no other take it over."""
        (work.folder / ward.WORK).unlink(missing_ok=True)
        self._signal(work, signal.SIGKILL)
        while self._is_watched(work):
            time.sleep(_LOOK_EVERY_S)
        with self._lock:
            known = self._children.pop(work.key, None)
            self._spawned.pop(work.key, None)
        if known is not None:
            known.wait()

    def _spawn(self, work: Work) -> bool:
        """Start a warden, wait for its word, and return whether the run lasts."""
        ward.reserve(work.folder / _PROCESS)
        told, telling = os.pipe()
        with os.fdopen(told, "rb") as words:
            with os.fdopen(telling, "wb") as ending:
                self._set_going(work, ending)
            return words.readline() == ward.STARTED

    def _set_going(self, work: Work, telling: IO[bytes]) -> None:
        hearing, saying = os.pipe()
        # Until it has said what to do when asked to end, a warden cannot be asked.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
        try:
            with (work.folder / "warden.log").open("ab") as trouble:
                started = subprocess.Popen(
                    [sys.executable, "-I", "-m", self._module, str(work.folder)],
                    stdin=hearing,
                    stdout=telling,
                    stderr=trouble,
                    env={"PATH": os.defpath},
                    start_new_session=True,
                )
        except BaseException:
            os.close(saying)
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            os.close(hearing)
        self._children[work.key] = started
        self._spawned[work.key] = self._spawned.get(work.key, 0) + 1
        # It does nothing before it hears that: of a runner that is killed here, no warden is left that nobody knows.
        with os.fdopen(saying, "wb", buffering=0) as word, contextlib.suppress(BrokenPipeError):
            ward.write_whole(work.folder / _PROCESS, {"pid": started.pid, "began": ward.began(started.pid)})
            word.write(ward.NOTED)

    def _watch_again(self, work: Work) -> bool:
        """Have a run watched whose warden died before it; return whether it is."""
        if not self._outlived or not (work.folder / ward.WORK).exists():
            return False
        with self._lock:
            if self._is_watched(work):
                return True
            if self._spawned.get(work.key, 0) >= _MAX_WARDENS:
                return False
            self._spawn(work)
            return True

    def _is_watched(self, work: Work) -> bool:
        child = self._children.get(work.key)
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
        is_same = said["began"] is not None and ward.began(said["pid"]) == said["began"]
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


def _ending(work: Work) -> Ending | None:
    try:
        said = json.loads((work.folder / ward.ENDING).read_text())
    except FileNotFoundError:
        return None
    return Ending(EndReason(said["reason"]), said["message"], said["exit_code"])
