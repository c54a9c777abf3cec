"""The warden of one run: starts it in its room, holds it to its bounds, and writes down how it ended.

`python -m kleinkram.runner.process.warden FOLDER`, where `FOLDER/work.json` says what to do. It begins once it is told
`noted` on stdin, says `started` on stdout once the command runs, keeps `usage.json` up to date, and leaves
`ending.json`, whole or not at all. SIGTERM ends the run. If it is killed, so is all that it started. Imports nothing
but Python's own library, since runs wait for it.
"""

import contextlib
import json
import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kleinkram.runner import doors, ward
from kleinkram.runner.process import kernel
from kleinkram.runner.process.room import SHARED_MEMORY, SHARED_MEMORY_BYTES, Room, bound, run_in

_LOOK_EVERY_S = 0.1
_MEASURE_DISK_EVERY_S = 1.0
_TELL_USAGE_EVERY_S = 1.0
_SEE_WHETHER_HELD_EVERY_S = 1.0
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_NOT_FOUND = "not found: "
_Taker = Callable[[bytes], None]


@dataclass(frozen=True)
class _Use:
    cpu_s: float = 0.0
    memory_bytes: int = 0
    shared_bytes: int = 0
    peak_memory_bytes: int = 0
    read_bytes: int = 0
    written_bytes: int = 0


class Warden:
    """Watches one run from start to end."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._work: dict[str, Any] = json.loads((folder / ward.WORK).read_text())
        self._deadline = time.monotonic() + self._work["time_s"]
        self._use = _Use()
        self._why: tuple[str, str] | None = None
        self._kill_at: float | None = None
        self._disk_at = self._told_at = self._held_at = 0.0
        self._ways = [doors.Way(**door) for door in self._work["doors"]]
        self._failure = b""
        self._log_left: int = self._work["log_bytes"]

    def run(self) -> None:
        """Run it to its end."""
        kernel.adopt_orphans()
        signal.signal(signal.SIGTERM, lambda *_: self._end(ward.CANCELLED))
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
        doorkeeper, inside = socket.socketpair()
        output, output_end = os.pipe()
        failed, failed_end = os.pipe()
        pid = os.fork()
        if pid == 0:
            os._exit(self._begin(output_end, failed_end, inside))
        os.close(output_end)
        os.close(failed_end)
        inside.close()
        threading.Thread(target=self._keep_doors, args=(doorkeeper,), daemon=True).start()
        code = self._watch(pid, output, failed)
        self._leave(code)

    def _begin(self, output: int, failed: int, doorkeeper: socket.socket) -> int:
        """In the child: become the command, and return its exit code."""
        try:
            os.setsid()
            nothing = os.open(os.devnull, os.O_RDONLY)
            os.dup2(nothing, 0)
            os.dup2(output, 1)
            os.dup2(output, 2)
            Path("/proc/self/oom_score_adj").write_text("1000")
            work = self._work
            room = Room(self._folder, work["has_network"], work["disk_bytes"], work["uid"], self._ways, doorkeeper)
            if work["is_isolated"]:
                return run_in(room, work["command"], work["environment"], failed)
            kernel.die_with_parent(signal.SIGKILL)
            bound(room)
            os.chdir(self._folder / "tmp")
            os.execvpe(work["command"][0], work["command"], work["environment"])  # noqa: S606
        except OSError as error:
            kind = _NOT_FOUND if isinstance(error, FileNotFoundError) else ""
            os.write(failed, f"{kind}{error}".encode())
        return 127

    def _keep_doors(self, doorkeeper: socket.socket) -> None:
        with doorkeeper:
            _, descriptors, _, _ = socket.recv_fds(doorkeeper, 16, len(self._ways))
        if descriptors:
            doors.carry([socket.socket(fileno=each) for each in descriptors], self._ways)

    def _watch(self, pid: int, output: int, failed: int) -> int:
        log = os.open(self._folder / ward.LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        open_ends: dict[int, _Taker] = {output: lambda data: self._keep(data, log), failed: self._note_failure}
        code: int | None = None
        while code is None:
            for each in select.select([*open_ends], [], [], _LOOK_EVERY_S)[0]:
                self._take(each, open_ends)
            if not open_ends:
                time.sleep(_LOOK_EVERY_S)
            self._look()
            ended, status = os.waitpid(pid, os.WNOHANG)
            code = os.waitstatus_to_exitcode(status) if ended else None
        _end_all()
        # What was written before the end.
        while ready := select.select([*open_ends], [], [], 0)[0]:
            for each in ready:
                self._take(each, open_ends)
        os.close(log)
        return code if code >= 0 else 128 - code

    def _take(self, end: int, open_ends: dict[int, _Taker]) -> None:
        data = os.read(end, 65536)
        open_ends[end](data)
        if not data:
            os.close(end)
            del open_ends[end]

    def _note_failure(self, data: bytes) -> None:
        """Take what keeps the command from starting; with nothing of that, the end of the pipe means that it runs."""
        self._failure += data
        if not data:
            if not self._failure:
                ward.say_started()
            os.close(1)

    def _keep(self, data: bytes, log: int) -> None:
        if self._log_left > 0:
            try:
                ward.write_log(log, data[: self._log_left])
                self._log_left -= len(data)
                if self._log_left <= 0:
                    ward.write_log(log, ward.LOG_IS_FULL)
            except OSError:
                self._log_left = 0
                self._end(ward.NO_ROOM, grace_s=0)

    def _look(self) -> None:
        now = time.monotonic()
        self._measure()
        if self._use.memory_bytes > self._work["memory_bytes"]:
            self._end(ward.too_much_memory(self._work["memory_bytes"]), grace_s=0)
        if now > self._deadline:
            self._end(ward.too_long(self._work["time_s"]))
        if now >= self._held_at:
            self._held_at = now + _SEE_WHETHER_HELD_EVERY_S
            if not ward.is_held(self._folder):
                self._end(ward.NOT_HELD, grace_s=0)
        if now >= self._disk_at:
            self._look_at_disk()
            # A look at very many files takes long: no more than a tenth of the time.
            self._disk_at = time.monotonic() + max(_MEASURE_DISK_EVERY_S, 10 * (time.monotonic() - now))
        if self._kill_at is not None and now >= self._kill_at:
            for each in _descendants(os.getpid()):
                _kill(each, signal.SIGKILL)

    def _look_at_disk(self) -> None:
        if ward.written_bytes(self._folder) > self._work["disk_bytes"]:
            self._end(ward.too_much_disk(self._work["disk_bytes"]), grace_s=0)

    def _end(self, why: tuple[str, str], *, grace_s: float | None = None) -> None:
        """Have the run ended; the first reason counts."""
        if self._why is not None:
            return
        self._why = why
        self._kill_at = time.monotonic() + (self._work["grace_s"] if grace_s is None else grace_s)
        if grace_s is None:
            for each in _descendants(os.getpid()):
                _kill(each, signal.SIGTERM)

    def _measure(self) -> None:
        running = _descendants(os.getpid())
        used = _sum([_use_of(pid) for pid in running])
        # What is in files of shared memory counts whether mapped or not; what is mapped of them is counted once.
        used = replace(used, memory_bytes=used.memory_bytes + max(used.shared_bytes, self._shared_memory(running)))
        peak = max(self._use.peak_memory_bytes, used.memory_bytes)
        # What a process used is its parent's when it ends, a moment later: figures never fall.
        self._use = replace(
            used,
            peak_memory_bytes=peak,
            cpu_s=max(used.cpu_s, self._use.cpu_s),
            read_bytes=max(used.read_bytes, self._use.read_bytes),
            written_bytes=max(used.written_bytes, self._use.written_bytes),
        )
        if time.monotonic() >= self._told_at:
            self._told_at = time.monotonic() + _TELL_USAGE_EVERY_S
            self._write_usage()

    def _write_usage(self) -> None:
        ward.write_usage(
            self._folder, {name: value for name, value in vars(self._use).items() if name != "shared_bytes"}
        )

    def _shared_memory(self, running: list[int]) -> int:
        """Return the bytes in the run's own /dev/shm; 0 where it has none, or nobody runs who would show it."""
        if not self._work["is_isolated"]:
            return 0
        for pid in running:
            with contextlib.suppress(OSError):
                there = os.statvfs(Path(f"/proc/{pid}/root") / SHARED_MEMORY)
                if there.f_blocks * there.f_frsize == SHARED_MEMORY_BYTES:
                    return (there.f_blocks - there.f_bfree) * there.f_frsize
        return 0

    def _leave(self, code: int) -> None:
        failure = self._failure.decode(errors="replace")
        self._look_at_disk()
        used = os.times()
        self._use = replace(self._use, cpu_s=max(self._use.cpu_s, used.children_user + used.children_system))
        self._write_usage()
        reason, message = self._why or _told_by(failure, code)
        exit_code = None if failure or self._why else code
        ward.write_whole(self._folder / ward.ENDING, {"reason": reason, "message": message, "exit_code": exit_code})


def _told_by(failure: str, code: int) -> tuple[str, str]:
    if failure.startswith(_NOT_FOUND):
        return "command_not_found", f"The command could not be started: {failure.removeprefix(_NOT_FOUND)}."
    if failure:
        return "not_possible", f"It could not be started here: {failure}."
    return ward.told_by_code(code)


def _kill(pid: int, sign: signal.Signals) -> None:
    try:
        os.kill(pid, sign)
    except ProcessLookupError:
        return


def _end_all() -> None:
    """Kill and reap whatever is left below this process, until nothing is."""
    while left := _descendants(os.getpid()):
        for each in left:
            _kill(each, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(-1, 0)


def _descendants(pid: int) -> list[int]:
    found: list[int] = []
    waiting = [pid]
    while waiting:
        each = waiting.pop()
        try:
            tasks = list(Path(f"/proc/{each}/task").iterdir())
            children = [int(child) for task in tasks for child in (task / "children").read_text().split()]
        except OSError:
            continue
        found += children
        waiting += children
    return found


def _use_of(pid: int) -> _Use:
    """What a process uses, and used those of its children that are over. Nothing where it is over itself."""
    try:
        # The name, which stands in parentheses, may hold anything.
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        status = Path(f"/proc/{pid}/status").read_text()
        traffic = Path(f"/proc/{pid}/io").read_text()
    except OSError:
        return _Use()
    said = dict(line.split(":", 1) for line in (status + traffic).splitlines() if ":" in line)
    own, shared = (int(said.get(name, "0 kB").split()[0]) * 1024 for name in ("RssAnon", "RssShmem"))
    ticks = sum(map(int, fields[11:15]))
    return _Use(ticks / _TICKS_PER_S, own, shared, 0, int(said["read_bytes"]), int(said["write_bytes"]))


def _sum(uses: list[_Use]) -> _Use:
    return _Use(
        sum(use.cpu_s for use in uses),
        sum(use.memory_bytes for use in uses),
        sum(use.shared_bytes for use in uses),
        0,
        sum(use.read_bytes for use in uses),
        sum(use.written_bytes for use in uses),
    )


if __name__ == "__main__" and ward.is_noted():
    Warden(Path(sys.argv[1])).run()
