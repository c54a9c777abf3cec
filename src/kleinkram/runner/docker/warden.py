"""The warden of one container: has it made and started, keeps its log, holds it to its bounds, writes down its end.

`python -m kleinkram.runner.docker.warden FOLDER`, where `FOLDER/work.json` says what to do. It begins once it is told
`noted` on stdin, says `started` on stdout once the command runs, keeps `usage.json` up to date, and leaves
`ending.json`, whole or not at all. SIGTERM ends the run. If it is killed, another one takes over: it finds the
container as it is, goes on with the log where that stands, and counts the time from the container's own birth. It
outlives a restart of the engine. Imports nothing but Python's own library, since runs wait for it.
"""

import contextlib
import json
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any, TypeVar

from kleinkram.runner import doors, ward
from kleinkram.runner.docker import cgroups, first, gate
from kleinkram.runner.docker.engine import UNSEEN, Container, Engine, EngineAway, Refused
from kleinkram.runner.docker.log import Log, Piece

_T = TypeVar("_T")
_LOOK_EVERY_S = 0.1
_MEASURE_DISK_EVERY_S = 1.0
_TELL_USAGE_EVERY_S = 1.0
_SEE_WHETHER_HELD_EVERY_S = 1.0
_RETRY_EVERY_S = 0.2
# An engine that is restarted is back by then. What still runs is waited for longer: until its time is over.
_ENGINE_BACK_S = 60.0
_LOG_DRAINED_S = 120.0
_OUT_OF_MEMORY_TOLD_S = 0.5
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_KILLED = 128 + signal.SIGKILL
# An engine on a busy machine tells late that a container is over.
_TOLD_TO_BE_OVER_S = 5.0
# A container that ends closes its outputs first.
_SEEN_TO_BE_OVER_S = 1.0
# That the container was seen to run. The log tells nothing of that: it stays when the run is begun anew.
_BEGUN = "begun"
# That its image has no shell that could wait.
_UNGATED = "ungated"
# A command that looks like one that waits is taken for begun then: until it has, it is held to no bounds.
_BEGINS_S = 10.0
_LOST = ("lost", "Its container was ended from outside: by a restart of the engine or of the machine, or by hand.")


class Warden:
    """Watches one container from start to end."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._work: dict[str, Any] = json.loads((folder / ward.WORK).read_text())
        self._engine = Engine(Path(self._work["socket"]))
        self._name: str = self._work["name"]
        self._ways = [doors.Way(**door) for door in self._work["doors"]]
        self._pid, self._began = 0, 0
        self._is_asked = False
        self._was_alone = self._was_away = self._ended_for_memory = False
        self._why: tuple[str, str] | None = None
        self._kill_at: float | None = None
        self._disk_at = self._told_at = self._held_at = 0.0
        self._groups: dict[str, str] = {}
        self._use: dict[str, float] = {}
        self._attached = contextlib.ExitStack()
        self._over = threading.Event()
        self._away_since: float | None = None

    def run(self) -> None:
        """Run it to its end."""
        signal.signal(signal.SIGTERM, lambda *_: self._note_asked())
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
        try:
            self._watch(self._begin())
            why, exit_code = self._end_of(self._find_over())
        except (Refused, OSError) as error:
            why, exit_code = _why_not(error), None
        except EngineAway as error:
            why, exit_code = _LOST if self._was_alone else ("not_possible", f"{error}."), None
        self._leave(why, exit_code)

    def _note_asked(self) -> None:
        self._is_asked = True

    def _begin(self) -> Iterator[list[Piece]]:
        """Have the container run, whatever an earlier warden has done of that, and return what it writes."""
        self._was_alone = (self._folder / _BEGUN).exists()
        found = self._find()
        written: Iterator[list[Piece]] = iter(())
        if found is None and self._was_alone:
            self._over.set()
            return written
        if found is None:
            self._engine.create(self._name, self._work["gated"] if self._is_gated() else self._work["container"])
        if found is None or found.status == "created":
            self._open_where_no_gate_can_be()
            written = self._attached.enter_context(self._engine.attached(self._name))
            self._engine.start(self._name)
            found = self._find()
        else:
            self._was_alone = True
            if found.status == "exited":
                self._over.set()
        if found is not None and found.pid:
            self._meet(found)
        return written

    def _is_gated(self) -> bool:
        return "gated" in self._work and not (self._folder / _UNGATED).exists()

    def _open_where_no_gate_can_be(self) -> None:
        """Make the container anew, without a gate, if its image has no shell that could wait."""
        if self._is_gated() and not self._engine.has_file(self._name, gate.SHELL):
            self._engine.remove(self._name)
            (self._folder / _UNGATED).touch()
            self._engine.create(self._name, self._work["container"])

    def _watch(self, written: Iterator[list[Piece]]) -> None:
        (self._folder / _BEGUN).touch()
        self._log = Log(self._folder, self._work["log_bytes"])
        log = threading.Thread(target=self._keep_log, args=(written,), daemon=True)
        log.start()
        threading.Thread(target=self._await_end, daemon=True).start()
        threading.Thread(target=self._await_death, daemon=True).start()
        if self._runs_command():
            ward.say_started()
        os.close(1)
        self._measure()
        while not self._over.wait(_LOOK_EVERY_S):
            self._look()
        log.join(_LOG_DRAINED_S)
        self._look_at_log()
        self._look_at_disk()
        if self._use:
            ward.write_usage(self._folder, self._use)

    def _meet(self, found: Container) -> None:
        """Look at the container's first process from outside, and make the doors that its command waits for."""
        self._began = ward.began(found.pid) or 0
        groups: dict[str, str] = {}
        with contextlib.suppress(OSError):
            groups = cgroups.groups_of(found.pid)
        if any(found.id in path for path in groups.values()):
            self._groups = groups
        elif self._is(found.pid):
            # An engine's number may be that of another process here, were the engine not of this machine.
            raise OSError("the engine's processes are not this machine's")
        self._pid = found.pid
        if not self._ways:
            return
        try:
            doors.carry(doors.listen_in(found.pid, self._ways), self._ways)
            if self._is_gated():
                gate.open_for(self._folder)
        except OSError:
            if self._lives():
                raise

    def _runs_command(self) -> bool:
        """Wait until the container's first process has become the command, and return whether it did."""
        until = time.monotonic() + _BEGINS_S
        while not self._over.is_set() and time.monotonic() < until:
            children = Path(f"/proc/{self._pid}/task/{self._pid}/children")
            try:
                mine = [Path(f"/proc/{each}/cmdline").read_bytes() for each in children.read_text().split()]
                first = Path(f"/proc/{self._pid}/cmdline").read_bytes()
            except OSError:
                # Over, which the engine says a moment later; or not to be seen from here.
                self._over.wait(_LOOK_EVERY_S if self._lives() else _TOLD_TO_BE_OVER_S)
                break
            # What is over, and was not reaped yet, has an empty one.
            if first and any(each and each != first and not gate.is_waiting(each) for each in mine):
                return True
            self._over.wait(0.002)
        return not self._over.is_set() or self._no_command(self._find_over()) is None

    def _no_command(self, found: Container | None) -> str | None:
        """Return what keeps the command from running, if its container ended by that."""
        if found is None or found.exit_code not in first.CODES:
            return None
        command = [gate.SHELL] if self._is_gated() else self._work["container"]["Cmd"]
        code = found.exit_code
        try:
            return self._insist(lambda: first.no_command(self._engine.log(self._name, follow=False), command, code))
        except Refused:
            return None

    def _look(self) -> None:
        now = time.monotonic()
        self._measure()
        self._log.add_held(after_s=_LOOK_EVERY_S)
        self._look_at_log()
        if self._is_asked:
            self._end(ward.CANCELLED)
        if self._lasts_s() > self._work["time_s"]:
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
            self._kill(signal.SIGKILL)
        if self._away_since is not None and now > self._away_since + _ENGINE_BACK_S and not self._lives():
            self._over.set()

    def _lasts_s(self) -> float:
        """How long the container runs, by a clock that nobody sets."""
        return ward.now_s() - self._began / _TICKS_PER_S if self._began else 0.0

    def _lives(self) -> bool:
        return self._is(self._pid)

    def _is(self, pid: int) -> bool:
        """Whether a process that is not over is the container's first one."""
        return self._began > 0 and ward.began(pid) == self._began

    def _look_at_log(self) -> None:
        if not self._log.has_room:
            self._end(ward.NO_ROOM, grace_s=0)

    def _look_at_disk(self) -> None:
        if ward.written_bytes(self._folder) > self._work["disk_bytes"]:
            self._end(ward.too_much_disk(self._work["disk_bytes"]), grace_s=0)

    def _measure(self) -> None:
        used = cgroups.usage_of(self._groups)
        if used is None:
            return
        peak = max(used.memory_bytes, self._use.get("peak_memory_bytes", 0))
        self._use = {**used._asdict(), "peak_memory_bytes": peak}
        if time.monotonic() >= self._told_at:
            self._told_at = time.monotonic() + _TELL_USAGE_EVERY_S
            ward.write_usage(self._folder, self._use)

    def _end(self, why: tuple[str, str], *, grace_s: float | None = None) -> None:
        """Have the run ended; the first reason counts."""
        if self._why is not None:
            return
        self._why = why
        self._kill_at = time.monotonic() + (self._work["grace_s"] if grace_s is None else grace_s)
        if grace_s is None:
            self._kill(signal.SIGTERM)

    def _kill(self, sign: signal.Signals) -> None:
        try:
            self._engine.kill(self._name, sign.name)
        except Refused:
            # It is over.
            return
        except EngineAway:
            if self._lives():
                os.kill(self._pid, sign)

    def _await_end(self) -> None:
        """Notice the end, though the engine be gone for a while."""
        while True:
            try:
                self._engine.wait(self._name)
                break
            except Refused:
                break
            except EngineAway:
                self._was_away = True
                self._away_since = self._away_since or time.monotonic()
                time.sleep(_RETRY_EVERY_S)
                continue
        self._over.set()

    def _await_death(self) -> None:
        """See, once the first process is over, what the kernel tells of it: a moment later that is gone."""
        with contextlib.suppress(OSError):
            death = os.pidfd_open(self._pid)
            select.select([death], [], [])
            os.close(death)
        self._ended_for_memory = cgroups.ended_for_memory(self._groups)

    def _find(self) -> Container | None:
        """Return the container, once the engine answers."""
        return self._insist(lambda: self._engine.find(self._name))

    def _insist(self, ask: Callable[[], _T]) -> _T:
        until = time.monotonic() + _ENGINE_BACK_S
        while time.monotonic() < until:
            with contextlib.suppress(EngineAway):
                return ask()
            self._was_away = True
            time.sleep(_RETRY_EVERY_S)
        return ask()

    def _find_over(self) -> Container | None:
        """Return the container, over by the engine's word: to have waited for its end may have failed."""
        until = time.monotonic() + _TOLD_TO_BE_OVER_S
        try:
            while (found := self._find()) is not None and found.status == "running" and time.monotonic() < until:
                time.sleep(_LOOK_EVERY_S)
        except EngineAway:
            return None
        return found

    def _keep_log(self, written: Iterator[list[Piece]]) -> None:
        with self._log as log:
            _add_all(log, written)
            # With nobody who takes it, what is written would hold up the container, and its end.
            self._attached.close()
            if self._over.wait(_SEEN_TO_BE_OVER_S) and not (self._was_alone or self._was_away):
                return
            # The engine went away, or this warden came late.
            was_over = False
            while not (log.is_full or was_over):
                # What an engine tells a follower may end before the last words: what it keeps is read once more.
                was_over = self._over.is_set()
                with contextlib.suppress(EngineAway, Refused):
                    _add_all(log, self._unread(log))
                self._over.wait(_RETRY_EVERY_S)

    def _unread(self, log: Log) -> Iterator[list[Piece]]:
        """Yield what the container wrote and the log has not, as it comes."""
        first = next((piece for pieces in self._engine.log(self._name, follow=False) for piece in pieces), None)
        if first is None or log.begins_with(first):
            yield from log.without_kept(self._engine.log(self._name, follow=True))
            return
        since_ns = log.last_written_ns
        log.note_gap()
        yield from self._engine.log(self._name, follow=True, since_ns=since_ns)

    def _end_of(self, found: Container | None) -> tuple[tuple[str, str], int | None]:
        """Return how it ended, and the exit code where that is the command's word."""
        if self._why is not None:
            return self._why, None
        # Of what is said to run still, the exit code means nothing.
        if found is None or found.status == "running":
            return _LOST, None
        if (failure := self._no_command(found)) is not None:
            return ("command_not_found", _could_not_start(failure)), None
        if found.exit_code != 0 and self._was_out_of_memory(found):
            return ward.too_much_memory(self._work["memory_bytes"]), None
        if self._was_cut_off(found):
            return _LOST, None
        return ward.told_by_code(found.exit_code), found.exit_code

    def _was_cut_off(self, found: Container) -> bool:
        """Whether the engine ended it, for its own restart or because somebody said so: whatever its exit code then."""
        if self._was_alone and found.exit_code in (_KILLED, UNSEEN):
            return True
        is_told = self._insist(lambda: self._engine.was_told_to_kill(self._name))
        return is_told or (self._was_away and self._insist(self._engine.facts).ends_with_containers)

    def _was_out_of_memory(self, found: Container | None) -> bool:
        """Whether the kernel ended it for its memory; engines hear of that a moment after the end, or not at all."""
        if self._ended_for_memory:
            return True
        until = time.monotonic() + _OUT_OF_MEMORY_TOLD_S
        while found is not None and not found.was_out_of_memory:
            if found.exit_code != _KILLED or self._was_alone or time.monotonic() > until:
                return False
            time.sleep(_LOOK_EVERY_S)
            found = self._find_over()
        return found is not None

    def _leave(self, why: tuple[str, str], exit_code: int | None) -> None:
        reason, message = why
        ending = {"reason": reason, "message": message, "exit_code": exit_code}
        ward.write_whole(self._folder / ward.ENDING, ending)


def _add_all(log: Log, written: Iterator[list[Piece]]) -> None:
    for pieces in written:
        log.add(pieces)
        if log.is_full:
            return


def _could_not_start(what: str) -> str:
    return f"The command could not be started: {what}."


def _why_not(error: Refused | OSError) -> tuple[str, str]:
    """Return reason and sentence for a container that could not be made or started."""
    if isinstance(error, Refused) and error.status == HTTPStatus.NOT_FOUND:
        return "image_unavailable", f"Its image is gone: {error}."
    if "executable file not found" in str(error):
        return "command_not_found", _could_not_start(str(error))
    return "not_possible", f"It could not be started here: {error}."


if __name__ == "__main__" and ward.is_noted():
    Warden(Path(sys.argv[1])).run()
