"""`klein up`: starts the services in order, restarts those that end, and stops all in order. `klein down` ends it.

One thread only: children are bound to the life of the thread that starts them. Signals are blocked and waited for, so
that none interrupts a step. Few imports: the process stays in memory for as long as Kleinkram runs.
"""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from functools import partial

import kleinkram
from kleinkram.standalone import http_client, object_store, postgres
from kleinkram.standalone.address import taken_ports
from kleinkram.standalone.data_dir import (
    DataDir,
    RuntimeInfo,
    create,
    exclusive,
    is_locked,
    load_runtime_info,
    note_version,
    read_holder,
    refuse_half_restored,
    refuse_newer,
    write_private,
)
from kleinkram.standalone.errors import NotRunning, ServiceFailed, StandaloneError
from kleinkram.standalone.processes import (
    end_marked_processes,
    open_pidfd,
    release,
    spawn,
    start_ticks,
    stop,
    wait_for_end,
)
from kleinkram.standalone.services import (
    Plan,
    ServiceProcess,
    UpOptions,
    last_line,
    last_postgres_error,
    make_plan,
)
from kleinkram.systemd import Watchdog, notify_ready, notify_stopping

_START_TIMEOUT_S = 120.0
_STORE_TIMEOUT_S = 1.5
_STORE_STARTS = 5
_LOGS_EVERY_S = 5.0
_FAILURES = 2
# Interrupted jobs run again, so the worker need not finish one.
_STOP_TIMEOUTS_S = {"worker": 5.0}
_STOP_ORDER = ("runner", "worker", "api", "proxy", "store", "postgres")
_STOP_SIGNALS = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
_WATCHED = {*_STOP_SIGNALS, signal.SIGCHLD, signal.SIGALRM}


class EndRequested(Exception):
    """Ctrl-C, `klein down` or another signal requested the end."""


@dataclass(frozen=True)
class StoppedInstance:
    """An instance that has ended: the pids of its supervisor and, by name, of its services."""

    pid: int
    services: dict[str, int]


def run(options: UpOptions) -> None:
    """Run Kleinkram until the end is requested.

    Raises:
        StandaloneError: it could not be started; what had been started was ended.
    """
    data_dir = DataDir(options.data_dir)
    watch_signals()
    create(data_dir)
    with exclusive(data_dir):
        refuse_half_restored(data_dir)
        refuse_newer(data_dir)
        end_marked_processes(data_dir.root)
        supervisor = Supervisor(make_plan(options))
        listening = supervisor.plan.listening
        if not listening.is_loopback and listening.tls_cert is None:
            _log(
                f"listening on {listening.address} without TLS: everybody on the network can read passwords, tokens "
                "and recordings, and use them; give --tls-cert and --tls-key, unless you trust everybody on it"
            )
        try:
            while True:
                try:
                    supervisor.start()
                except ServiceFailed as error:
                    supervisor.stop()
                    taken = taken_ports(listening, supervisor.plan.ports)
                    # The other program may have released the port already.
                    if not taken and "address already in use" not in str(error).lower():
                        raise
                    _log_taken(taken or ["a port"])
                    supervisor.plan = make_plan(options)
                    supervisor.start()
                _print_address(supervisor, options)
                notify_ready(f"answers at {supervisor.plan.public_url}")
                taken = supervisor.watch()
                supervisor.stop()
                _log_taken(taken)
                supervisor.plan = make_plan(options)
        except EndRequested:
            pass
        finally:
            notify_stopping()
            supervisor.stop()


def stop_instance(data_dir: DataDir, *, timeout_s: float = 60) -> StoppedInstance:
    """Stop the supervisor of this data directory and with it all services; returns when it has ended.

    Raises:
        NotRunning: none runs there.
        ServiceFailed: it does not end in time.
    """
    holder = read_holder(data_dir)
    if holder is None or not is_locked(data_dir):
        raise NotRunning(f"Kleinkram is not running in {data_dir.root}: there is nothing to stop.")
    info = load_runtime_info(data_dir)
    # A supervisor that was killed leaves its file, until the next has finished starting.
    services = info.services if info is not None and info.pid == holder.pid else {}
    stopped = StoppedInstance(holder.pid, {name: pid for name, pid in services.items() if pid is not None})
    with open_pidfd(holder.pid) as pidfd:
        if pidfd is None or start_ticks(holder.pid) != holder.start_ticks:
            return stopped
        signal.pidfd_send_signal(pidfd, signal.SIGTERM)
        if not wait_for_end(pidfd, timeout_s):
            raise ServiceFailed(
                f"Kleinkram on {data_dir.root} (pid {holder.pid}) has not ended within {timeout_s:.0f} s: "
                f"see {data_dir.root / 'logs'}; `kill -9 {holder.pid}` is safe, the next `klein up` recovers."
            )
    return stopped


def watch_signals() -> None:
    """Block the signals that request the end until `pause` receives them."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _WATCHED)


def pause(seconds: float) -> None:
    """Sleep, but wake when a child ends.

    By an alarm: `sigtimedwait` returns an invented signal where the process was stopped (Ctrl-Z) beyond the timeout.

    Raises:
        EndRequested: a signal requested the end.
    """
    signal.setitimer(signal.ITIMER_REAL, max(seconds, 0.001))
    received = signal.sigwaitinfo(_WATCHED).si_signo
    # Under `nohup` the terminal may close.
    if received in _STOP_SIGNALS and not (received == signal.SIGHUP and signal.getsignal(received) == signal.SIG_IGN):
        raise EndRequested


class Supervisor:
    """The services of one instance, by name, in the order of their start."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.services: dict[str, ServiceProcess] = {}
        self.started_at = datetime.now(timezone.utc)
        self._api_may_begin = False
        self._watchdog = Watchdog()

    def start(self) -> None:
        """Start all services; returns when the API reports that it is ready.

        Raises:
            StandaloneError: a service ended or was not ready in time.
            EndRequested: the end was requested.
        """
        plan = self.plan
        self._api_may_begin = False
        self._launch_data_services()
        # It loads its modules while PostgreSQL and the store start.
        api = self._launch("api", self._start_api)
        self._wait_for_postgres()
        if not postgres.is_migrated(plan.data_dir, plan.postgres):
            self._migrate()
        self._wait_for_store()
        if command := plan.proxy_command():
            proxy = self._launch("proxy", lambda: spawn(command))
            self._wait(lambda: http_client.responds(plan.local_store_url), proxy)
        self._api_may_begin = True
        release(api.child)
        self._wait(lambda: http_client.is_ready(plan.local_url), api)
        # Last: their imports would delay the API.
        self._launch("worker", lambda: spawn(plan.server_command("worker")))
        if runner := plan.runner_command():
            # SIGINT: it also ends its runs, so that nothing of Kleinkram stays on the machine.
            self._launch("runner", lambda: spawn(runner), stop_signal=signal.SIGINT)
        note_version(plan.data_dir)
        self._write_runtime_info()

    def start_data_services(self) -> None:
        """Start only database and store; returns when both are ready.

        Raises:
            StandaloneError: one ended or was not ready in time.
            EndRequested: the end was requested.
        """
        self._launch_data_services()
        self._wait_for_postgres()
        self._wait_for_store()

    def watch(self) -> list[str]:
        """Restart services that end, and limit the logs, until the end is requested.

        Returns which of the chosen ports other programs took while a service was down, if that happens.

        Raises:
            EndRequested: the end was requested.
        """
        logs_due = 0.0
        while True:
            for service in self.services.values():
                self._restart(service)
                if taken := self._taken_ports(service):
                    return taken
            if time.monotonic() >= logs_due:
                logs_due = time.monotonic() + _LOGS_EVERY_S
                for service in self.services.values():
                    service.limit_log()
            restarts = [service.restart_at for service in self.services.values() if service.restart_at is not None]
            self._pause(min([_LOGS_EVERY_S, *(restart_at - time.monotonic() for restart_at in restarts)]))

    def stop(self) -> None:
        """End all services: those that use others first."""
        for name in _STOP_ORDER:
            if service := self.services.pop(name, None):
                service.stop()
        object_store.remove_sockets(self.plan.store)
        self.plan.data_dir.runtime_file.unlink(missing_ok=True)

    def runtime_info(self) -> RuntimeInfo:
        """Return the content of `instance.json`."""
        plan = self.plan
        return RuntimeInfo(
            url=plan.public_url,
            data_dir=str(plan.data_dir.root),
            token_file=str(plan.data_dir.token_file),
            store_url=plan.store_public_url,
            local_url=plan.local_url,
            version=kleinkram.__version__,
            started_at=self.started_at.isoformat(),
            pid=os.getpid(),
            ports=dict(plan.ports),
            services={name: service.pid for name, service in self.services.items()},
        )

    def _launch(
        self, name: str, start: Callable[[], "subprocess.Popen[bytes]"], *, stop_signal: signal.Signals = signal.SIGTERM
    ) -> ServiceProcess:
        log = self.plan.data_dir.log(name)
        service = ServiceProcess(name, start, log, stop_signal, _STOP_TIMEOUTS_S.get(name, 15.0))
        service.launch()
        self.services[name] = service
        return service

    def _launch_data_services(self) -> None:
        plan = self.plan
        self._launch("store", lambda: object_store.start(plan.store), stop_signal=object_store.STOP_SIGNAL)
        postgres.initialise(plan.postgres)
        self._launch("postgres", lambda: postgres.start(plan.postgres), stop_signal=postgres.STOP_SIGNAL)

    def _wait_for_postgres(self) -> None:
        cluster, database = self.plan.postgres, self.services["postgres"]
        self._wait(lambda: postgres.is_ready(cluster, database.child), database)
        postgres.prepare_database(cluster)

    def _start_api(self) -> "subprocess.Popen[bytes]":
        api = spawn(self.plan.server_command("api"))
        if self._api_may_begin:
            release(api)
        return api

    def _wait(self, is_ready: Callable[[], bool], service: ServiceProcess) -> None:
        """Wait for a service while all others run."""
        if not self._becomes_true(is_ready, _START_TIMEOUT_S):
            raise ServiceFailed(
                f"The service '{service.name}' was not ready after {_START_TIMEOUT_S:.0f} s: "
                f"see {service.log}; its last line: {last_line(service.log)}"
            )

    def _pause(self, seconds: float) -> None:
        """Pause, and tell systemd that this process is alive."""
        self._watchdog.ping()
        pause(seconds)

    def _becomes_true(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition while all services run; return whether it came true in time."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            for service in self.services.values():
                if service.exit_reason():
                    raise _ended_early(service)
            if time.monotonic() > deadline:
                return False
            self._pause(0.02)
        return True

    def _wait_for_store(self) -> None:
        """Wait until the store returns what was written, and restart it if it listens but accepts no writes.

        In some starts weed's volume server registers before the master has elected itself, is refused, and tries again
        only after 5 to 20 s; until then every PUT hangs. Nothing is stored yet, so killing it is safe.
        """
        access, store = self.plan.store.access, self.services["store"]
        for attempt in range(_STORE_STARTS):
            self._wait(lambda: http_client.responds(access.endpoint), store)
            timeout_s = _STORE_TIMEOUT_S * 2**attempt  # increasing: the machine may be slow
            is_ready = partial(object_store.is_ready, access, object_store.BUCKET, timeout_s=timeout_s)
            if self._becomes_true(is_ready, timeout_s):
                return
            _log(f"the store listens but accepts no writes: restarting it; log: {store.log}")
            stop(store.child, sign=signal.SIGKILL, timeout_s=10)
            store.launch()
        self._wait(lambda: object_store.is_ready(access, object_store.BUCKET, timeout_s=30), store)

    def _migrate(self) -> None:
        command = self.plan.server_command("migrate")
        migration = ServiceProcess("migrate", lambda: spawn(command), command.log)
        migration.launch()
        try:
            while migration.exit_reason() is None:
                self._pause(0.02)
        finally:
            migration.stop()
        if migration.child.returncode != 0:
            raise _ended_early(migration)
        postgres.record_migrations(self.plan.data_dir, self.plan.postgres)

    def _restart(self, service: ServiceProcess) -> None:
        name = service.name
        if service.restart_at is None and (reason := service.exit_reason()):
            pause_s = service.schedule_restart()
            error = last_postgres_error(service.log, since=service.log_from) if name == "postgres" else ""
            reason += f"; its last error: {error}" if error else ""
            _log(f"{name} has ended ({reason}); restarting it in {pause_s:.1f} s; log: {service.log}")
            self._write_runtime_info()
            return
        try:
            is_started = service.restart_if_due()
        except (StandaloneError, OSError) as error:
            _log(f"{name} could not be restarted, trying again in {service.schedule_restart():.1f} s: {error}")
            return
        if is_started:
            _log(f"{name} was restarted")
            self._write_runtime_info()

    def _taken_ports(self, service: ServiceProcess) -> list[str]:
        """Return which chosen ports another program took from a service that cannot restart; report requested ones."""
        # After the first failure, remaining processes of the service may use its port for a moment.
        if service.restart_at is None or service.failures in (service.failures_checked, *range(_FAILURES)):
            return []
        service.failures_checked = service.failures
        plan = self.plan
        own = {name: plan.ports[name] for name in plan.ports_of(service.name)}
        requested = {name: flag for name, flag in plan.listening.requested_ports().items() if name in own}
        taken = taken_ports(plan.listening, {name: own[name] for name in requested})
        if not taken:
            return taken_ports(plan.listening, own)
        _log(
            f"{service.name} cannot use {' and '.join(taken)}, requested by {' and '.join(requested.values())}: end "
            f"that program, and {service.name} restarts by itself, or start klein up with another port"
        )
        return []

    def _write_runtime_info(self) -> None:
        write_private(self.plan.data_dir.runtime_file, json.dumps(asdict(self.runtime_info()), indent=2))


def _ended_early(service: ServiceProcess) -> ServiceFailed:
    return ServiceFailed(
        f"The service '{service.name}' ended ({service.exit_reason()}) while starting: "
        f"see {service.log}; its last line: {last_line(service.log)}"
    )


def _log(sentence: str) -> None:
    print(f"klein: {sentence}", file=sys.stderr, flush=True)  # noqa: T201  (the supervisor's log)


def _log_taken(ports: list[str]) -> None:
    _log(f"another program took {' and '.join(ports)}: starting again on other ports")


def _print_address(supervisor: Supervisor, options: UpOptions) -> None:
    """Print the line that programs wait for; on a terminal also the owner's link, which is a secret."""
    plan = supervisor.plan
    if options.as_json:
        print(json.dumps(asdict(supervisor.runtime_info())), flush=True)  # noqa: T201  (the command's output)
        return
    line = f"Kleinkram answers at {plan.public_url} (data in {options.data_dir})"
    if not options.is_default_data_dir:
        line += f"; for klein on this machine: export KLEINKRAM_DATA_DIR={shlex.quote(str(options.data_dir))}"
    print(line, flush=True)  # noqa: T201  (the command's output)
    if not sys.stdout.isatty():
        return
    token = plan.data_dir.token_file.read_text(encoding="ascii").strip()
    try:
        link = http_client.create_owner_link(plan.local_url, token, certificate=plan.listening.tls_cert)
    except http_client.RequestError:
        link = None
    if link is None:
        print("To sign a browser in as its owner: `klein session link`", flush=True)  # noqa: T201
        return
    line = f"To sign a browser in as its owner, once, within minutes: {link} (`klein session link` makes another)"
    print(line, flush=True)  # noqa: T201  (the command's output)
