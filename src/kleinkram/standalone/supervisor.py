"""`klein up`: starts the parts in order, says where Kleinkram is, starts again what dies, ends all in order.

One thread only: children are bound to the life of the thread that starts them. Signals are blocked and waited for, so
nothing is interrupted half-way. Light imports only: it stays in memory for as long as Kleinkram runs.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import datetime, timezone

import kleinkram
from kleinkram.standalone import child, health, postgres, s3, schema, store
from kleinkram.standalone.address import taken_ports
from kleinkram.standalone.data_dir import (
    DataDir,
    create,
    exclusive,
    note_version,
    refuse_half_restored,
    refuse_newer,
    write_private,
)
from kleinkram.standalone.errors import PartFailed, StandaloneError
from kleinkram.standalone.greeting import greeting, invitation
from kleinkram.standalone.leftovers import end_leftovers
from kleinkram.standalone.parts import Part, RunningPart, bound_log, last_complaint, last_line, launch
from kleinkram.standalone.plan import Plan, UpOptions, make_plan

_START_TIMEOUT_S = 120.0
_STORE_PATIENCE_S = 1.5
_STORE_STARTS = 5
_LOGS_EVERY_S = 5.0
_FAILURES = 2
# A job that is cut short is done again: nobody should wait long for the worker to finish one.
_STOP_TIMEOUTS_S = {"worker": 5.0}
_STOPPING = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
_WATCHED = {*_STOPPING, signal.SIGCHLD, signal.SIGALRM}


class StopAsked(Exception):
    """Somebody pressed Ctrl-C or asked for the end."""


def run(options: UpOptions) -> None:
    """Run Kleinkram until it is asked to stop.

    Raises:
        StandaloneError: it could not be started; what had been started is ended again.
    """
    data_dir = DataDir(options.data_dir)
    watch_signals()
    create(data_dir)
    with exclusive(data_dir):
        refuse_half_restored(data_dir)
        refuse_newer(data_dir)
        end_leftovers(data_dir)
        supervisor = Supervisor(make_plan(options))
        _warn_of_listening(supervisor.plan)
        try:
            while True:
                _start(supervisor, options)
                _greet(supervisor, options)
                lost = supervisor.watch()
                supervisor.stop()
                _say_lost(lost)
                supervisor.plan = make_plan(options)
        except StopAsked:
            pass
        finally:
            supervisor.stop()


def _start(supervisor: "Supervisor", options: UpOptions) -> None:
    """Start all parts; once more, on other ports, where another program took one after it had been chosen."""
    try:
        supervisor.start()
    except PartFailed:
        supervisor.stop()
        plan = supervisor.plan
        taken = taken_ports(plan.listening, plan.ports)
        if not taken:
            raise
        _say_lost(taken)
        supervisor.plan = make_plan(options)
        supervisor.start()


def watch_signals() -> None:
    """Let signals that ask for the end wait until `pause` looks for them."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _WATCHED)


class Supervisor:
    """The parts of one instance, by name, in the order of their start."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.parts: dict[str, RunningPart] = {}
        self.started_at = datetime.now(timezone.utc)
        self._api_may_begin = False

    def start(self) -> None:
        """Start all parts; returns when the API has answered that all is ready.

        Raises:
            StandaloneError: a part ended or did not become ready in time.
            StopAsked: meanwhile somebody asked for the end.
        """
        plan = self.plan
        self._api_may_begin = False
        # What takes long goes side by side: the store's start, PostgreSQL's, and the API's loading.
        self._launch("store", lambda: store.start(plan.store), stop_signal=store.STOP_SIGNAL)
        postgres.initialise(plan.postgres)
        database = self._launch("postgres", lambda: postgres.start(plan.postgres), stop_signal=postgres.STOP_SIGNAL)
        api = self._launch("api", self._start_api)
        self._wait(lambda: postgres.is_ready(plan.postgres, database.child), database)
        postgres.prepare_database(plan.postgres)
        self._migrate()
        self._wait_for_store()
        if door := plan.door():
            self._launch("door", lambda: child.spawn(door))
            self._wait(lambda: health.answers(local_store_url(plan)), self.parts["door"])
        self._api_may_begin = True
        child.tell(api.child)
        self._wait(lambda: health.is_ready(plan.local_url), api)
        # Last: nobody waits for it, and its imports would take their share of the time to the first answer.
        self._launch("worker", lambda: child.spawn(plan.server_process("worker")))
        if runner := plan.runner():
            # Asked to end like this, it ends its runs: nothing of Kleinkram is left on the machine.
            self._launch("runner", lambda: child.spawn(runner), stop_signal=signal.SIGINT)
        note_version(plan.data_dir)
        self._tell()

    def start_data(self) -> None:
        """Start database and store alone; returns when both can be used.

        Raises:
            StandaloneError: a part ended or did not become ready in time.
            StopAsked: meanwhile somebody asked for the end.
        """
        plan = self.plan
        self._launch("store", lambda: store.start(plan.store), stop_signal=store.STOP_SIGNAL)
        postgres.initialise(plan.postgres)
        database = self._launch("postgres", lambda: postgres.start(plan.postgres), stop_signal=postgres.STOP_SIGNAL)
        self._wait(lambda: postgres.is_ready(plan.postgres, database.child), database)
        postgres.prepare_database(plan.postgres)
        self._wait_for_store()

    def watch(self) -> list[str]:
        """Start again what ends, and keep the logs within bounds, until the end is asked for.

        Returns where other programs took ports that Kleinkram had chosen itself, while a part was down: which ports.

        Raises:
            StopAsked: somebody asked for the end.
        """
        logs_due = 0.0
        while True:
            for running in self.parts.values():
                self._look_after(running)
                if lost := self._lost_ports(running):
                    return lost
            if time.monotonic() >= logs_due:
                logs_due = time.monotonic() + _LOGS_EVERY_S
                for running in self.parts.values():
                    bound_log(running.part.log)
            pause(self._until_next_start())

    def stop(self) -> None:
        """End all parts: those that use others first."""
        for name in ("runner", "worker", "api", "door", "store", "postgres"):
            if running := self.parts.pop(name, None):
                running.stop()
        self.plan.data_dir.instance_file.unlink(missing_ok=True)

    def _launch(
        self, name: str, start: Callable[[], "subprocess.Popen[bytes]"], *, stop_signal: signal.Signals = signal.SIGTERM
    ) -> RunningPart:
        part = Part(name, start, self.plan.data_dir.log(name), stop_signal, _STOP_TIMEOUTS_S.get(name, 15.0))
        self.parts[name] = launch(part)
        return self.parts[name]

    def _start_api(self) -> "subprocess.Popen[bytes]":
        api = child.spawn(self.plan.server_process("api", *self.plan.api_arguments()))
        if self._api_may_begin:
            child.tell(api)
        return api

    def _wait(self, ready: Callable[[], bool], running: RunningPart) -> None:
        """Wait for a part, and see that it and those before it live."""
        deadline = time.monotonic() + _START_TIMEOUT_S
        while not ready():
            for other in self.parts.values():
                if other.ending():
                    raise _ended(other)
            if time.monotonic() > deadline:
                raise PartFailed(
                    f"The part '{running.part.name}' was not ready after {_START_TIMEOUT_S:.0f} s: "
                    f"see {running.part.log}; its last line: {last_line(running.part.log)}"
                )
            pause(0.02)

    def _wait_for_store(self) -> None:
        """Wait until bytes come back, starting anew a store that listens and takes none: it would for 5 to 20 s.

        In some starts weed's volume server greets the master before the master has elected itself, is refused, and
        asks again only seconds later; until then every PUT hangs. Nothing is in flight yet, so killing it is safe.
        """
        access = self.plan.store.access
        for number in range(_STORE_STARTS):
            running = self.parts["store"]
            self._wait(lambda: health.answers(access.endpoint), running)
            # Longer with each start: it may be the machine that is slow.
            if self._takes_bytes_within(_STORE_PATIENCE_S * 2**number, running):
                return
            _say(f"the store listens but takes no bytes: starting it anew; log: {running.part.log}")
            child.stop(running.child, sign=signal.SIGKILL, timeout_s=10)
            self.parts["store"] = launch(running.part)
        self._wait(lambda: s3.proves_ready(access, store.BUCKET, timeout_s=30), self.parts["store"])

    def _takes_bytes_within(self, patience_s: float, running: RunningPart) -> bool:
        proven = False
        deadline = time.monotonic() + patience_s

        def proven_or_late() -> bool:
            nonlocal proven
            proven = s3.proves_ready(self.plan.store.access, store.BUCKET, timeout_s=patience_s)
            return proven or time.monotonic() > deadline

        self._wait(proven_or_late, running)
        return proven

    def _migrate(self) -> None:
        if schema.is_noted(self.plan.data_dir, self.plan.postgres):
            return
        command = self.plan.server_process("migrate")
        running = launch(Part("migrate", lambda: child.spawn(command), command.log, signal.SIGTERM, stop_timeout_s=15))
        try:
            while running.ending() is None:
                pause(0.02)
        finally:
            running.stop()
        if running.child.returncode != 0:
            raise _ended(running)
        schema.note(self.plan.data_dir, self.plan.postgres)

    def _look_after(self, running: RunningPart) -> None:
        name = running.part.name
        if running.start_again_at is None and (ending := running.ending()):
            wait_s = running.schedule()
            why = last_complaint(running.part.log, since=running.log_from) if name == "postgres" else ""
            said = f"; it said: {why}" if why else ""
            _say(f"{name} has ended ({ending}){said}; starting it again in {wait_s:.1f} s; log: {running.part.log}")
            self._tell()
            return
        try:
            started = running.start_if_due()
        except (StandaloneError, OSError) as error:
            _say(f"{name} could not be started again, trying once more in {running.schedule():.1f} s: {error}")
            return
        if started:
            _say(f"{name} was started again")
            self._tell()

    def _lost_ports(self, running: RunningPart) -> list[str]:
        """Say which chosen ports another program took from a part that does not come back; name those asked for."""
        # A part that ended once is just started again: what is left of it may hold its port for a moment.
        if running.start_again_at is None or running.failures == running.looked_at or running.failures < _FAILURES:
            return []
        running.looked_at = running.failures
        plan, part = self.plan, running.part.name
        own = {name: plan.ports[name] for name in plan.ports_of(part)}
        asked = {name: flag for name, flag in plan.listening.asked_for().items() if name in own}
        held = taken_ports(plan.listening, {name: own[name] for name in asked})
        if not held:
            return taken_ports(plan.listening, own)
        _say(
            f"{part} cannot have {' and '.join(held)}, which {' and '.join(asked.values())} asked for: end that program"
            f" and {part} comes back by itself, or start klein up with another port"
        )
        return []

    def _until_next_start(self) -> float:
        due = [running.start_again_at for running in self.parts.values() if running.start_again_at is not None]
        return max(0.0, min([time.monotonic() + _LOGS_EVERY_S, *due]) - time.monotonic())

    def _tell(self) -> None:
        write_private(self.plan.data_dir.instance_file, json.dumps(self.told(), indent=2))

    def told(self) -> dict[str, object]:
        """What the CLI, `klein doctor` and other programs of this user may know."""
        plan = self.plan
        return {
            "url": plan.public_url,
            "data_dir": str(plan.data_dir.root),
            "token_file": str(plan.data_dir.token_file),
            "store_url": plan.store_public_url,
            "local_url": plan.local_url,
            "version": kleinkram.__version__,
            "started_at": self.started_at.isoformat(),
            "pid": os.getpid(),
            "ports": dict(plan.ports),
            "parts": {name: running.pid for name, running in self.parts.items()},
        }


def local_store_url(plan: Plan) -> str:
    """The store's address for clients, from this machine."""
    return f"{plan.listening.scheme}://{plan.listening.local_host}:{plan.ports['store']}"


def _ended(running: RunningPart) -> PartFailed:
    part = running.part
    return PartFailed(
        f"The part '{part.name}' ended ({running.ending()}) while it was to start: "
        f"see {part.log}; its last line: {last_line(part.log)}"
    )


def pause(seconds: float) -> None:
    """Sleep, but wake when a child ends.

    By an alarm: `sigtimedwait` invents a signal where the process was stopped (Ctrl-Z) until after its time.

    Raises:
        StopAsked: a signal asked for the end.
    """
    signal.setitimer(signal.ITIMER_REAL, max(seconds, 0.001))
    received = signal.sigwaitinfo(_WATCHED).si_signo
    # Under `nohup` a terminal may go.
    if received in _STOPPING and not (received == signal.SIGHUP and signal.getsignal(received) == signal.SIG_IGN):
        raise StopAsked


def _say(sentence: str) -> None:
    print(f"klein: {sentence}", file=sys.stderr, flush=True)  # noqa: T201  (the supervisor's own voice)


def _say_lost(taken: list[str]) -> None:
    _say(f"another program took {' and '.join(taken)} meanwhile: starting again on other ports")


def _warn_of_listening(plan: Plan) -> None:
    if not plan.listening.is_loopback and plan.listening.tls_cert is None:
        _say(
            f"listening on {plan.listening.address} without TLS: whoever shares the network can read "
            "passwords, tokens and recordings on their way, and then act as whose they are; "
            "give --tls-cert and --tls-key, unless you trust everybody on it"
        )


def _greet(supervisor: Supervisor, options: UpOptions) -> None:
    plan = supervisor.plan
    if options.as_json:
        lines = [json.dumps(supervisor.told())]
    elif sys.stdout.isatty():
        lines = [greeting(plan, options), invitation(plan, plan.local_url)]
    else:
        lines = [greeting(plan, options)]
    for line in lines:
        print(line, flush=True)  # noqa: T201  (the command's output)
