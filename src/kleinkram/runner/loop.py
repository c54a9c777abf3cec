"""The runner loop: claims runs while capacity is free, runs them, and sends heartbeats.

Threads: one claims runs, one sends heartbeats for all of them, one enforces leases, and each run has its own. Jobs do
not depend on any of them: they continue without this process, and the next one re-attaches. The third also tells
systemd that this process is alive, unless one of the first two hangs.
"""

import contextlib
import logging
import math
import threading
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import kleinkram
from kleinkram.client._http import Api, Backoff
from kleinkram.client.config import Endpoint, EndpointSource
from kleinkram.client.errors import InvalidInput
from kleinkram.client.runs import Runners
from kleinkram.client.server import Service
from kleinkram.client.transfer.store import StoreClient
from kleinkram.contract.errors import Forbidden, KleinkramError, NotAuthenticated, NotFound, ScopeMissing
from kleinkram.contract.runners import (
    HEARTBEAT_S,
    MAX_CLAIMED,
    MAX_WAIT_S,
    Capacity,
    ClaimRequest,
    RunAssignment,
    RunnerRegistration,
)
from kleinkram.runner import state_directory as runner_state
from kleinkram.runner.active_run import ActiveRun
from kleinkram.runner.executors.base import CannotStart, Executor
from kleinkram.runner.executors.supervision import boot_time_s
from kleinkram.runner.run_requests import HeartbeatRequests, RunRequests, report_pause_s
from kleinkram.runner.state_directory import LEASE_MARGIN_S, Attempt, Lease, RunnerContext, StateDirectory, StopRequest
from kleinkram.runner.statistics import RunnerStatistics
from kleinkram.systemd import Watchdog, notify_ready, notify_status, notify_stopping

_log = logging.getLogger("kleinkram.runner")
_HEARTBEAT_TIMEOUT_S = 10.0
_HEARTBEAT_PAUSE_S = 0.1
_CAPACITY_PAUSE_S = 0.2
_ENFORCE_EVERY_S = 0.2
_RETRY_S = 3.0
_REFUSED_RETRY_S = 15.0
# How long the runs of an earlier process continue without a confirmation of their leases by the server.
_CONFIRMATION_S = 5.0
_DETACH_S = 3.0
# With more runs, each uploads its log less often.
_LOG_PARTS_PER_S = 10.0
_STORE_CONNECTIONS = 8
_DEFAULT_IMAGE_RETRY_S = 300.0
_ABILITIES_RETRY_S = 60.0
# A thread without progress for this long hangs: longer than any request with its retries.
_HANGS_S = 240.0
_REFUSALS = (NotAuthenticated, Forbidden, ScopeMissing)


@dataclass(frozen=True)
class RunnerOptions:
    """The identity of a runner. Jobs reach the server by the same `url`."""

    url: str
    token: str
    name: str
    labels: tuple[str, ...] = ()
    default_image: str | None = None
    token_file: Path | None = None


class Runner:
    """A runner. `run` returns after `stop`, or, with `once`, after one run."""

    def __init__(self, options: RunnerOptions, state: StateDirectory, executor: Executor) -> None:
        if executor.node_cache is not None and options.token_file is None:
            reason = "the compute nodes need the token of the runner, in a file that they can read (--token-file)"
            raise InvalidInput(what="The option --transfers node", reason=reason)
        endpoint = Endpoint("runner", options.url, options.token, EndpointSource.argument)
        self._options = options
        self._state = state
        self._executor = executor
        self._api = Api(endpoint)
        self._runners = Runners(self._api)
        self.statistics = RunnerStatistics()
        # A request that hangs must not cost the leases.
        self._heartbeat_api = Api(endpoint, read_timeout_s=_HEARTBEAT_TIMEOUT_S)
        self._store = StoreClient(_STORE_CONNECTIONS)
        self._is_stopping = threading.Event()
        self._is_closed = threading.Event()
        self._is_unreachable = False
        self._is_heartbeat_recorded = True
        self._has_changes = threading.Event()
        self._has_capacity = threading.Event()
        self._active: dict[uuid.UUID, ActiveRun] = {}
        # When each of the threads that talk to the server last went through its loop.
        self._progress_s = dict.fromkeys(("claims", "heartbeats"), time.monotonic())
        self._lock = threading.Lock()
        self._heartbeats = HeartbeatRequests()
        self._threads = [
            threading.Thread(target=work, daemon=True) for work in (self._send_heartbeats, self._enforce_leases)
        ]
        self._default_image_digest: str | None = None
        self._context = RunnerContext(
            executor=executor,
            runners=self._runners,
            requests=RunRequests(self._runners, state.runner_id, lambda: self.active_count),
            store=self._store,
            url=options.url,
            token=options.token,
            token_file=options.token_file,
            service=Service(self._api),
            default_image=options.default_image,
            on_change=self._has_changes.set,
            statistics=self.statistics,
            log_every_s=lambda: self.active_count / _LOG_PARTS_PER_S,
        )

    def run(self, *, once: bool = False) -> None:
        """Continue the runs of an earlier process, then claim runs until stopped.

        Raises:
            NotAuthenticated, Forbidden: the server does not accept the token as a runner's.
        """
        self._continue_runs()
        for thread in self._threads:
            thread.start()
        notify_ready("waiting for the server to accept this runner")
        self._register_until_accepted()
        notify_status("claiming runs")
        if self._options.default_image is not None and self._executor.abilities.images:
            search = threading.Thread(target=self._find_default_image, name="default image", daemon=True)
            search.start()
            self._threads.append(search)
        if not self._executor.are_abilities_known:
            search = threading.Thread(target=self._find_abilities, name="abilities", daemon=True)
            search.start()
            self._threads.append(search)
        capacity = self._executor.capacity
        _log.info(
            "ready: %g cores, %.1f GB memory, %.0f GB disk, %d GPUs, runs as %s",
            capacity.cores,
            capacity.memory_bytes / 1e9,
            capacity.disk_bytes / 1e9,
            capacity.gpus,
            self._executor.abilities.executor,
        )
        while not self._is_stopping.is_set():
            runs = self._claim(max_runs=1 if once else MAX_CLAIMED)
            if runs and once:
                while self._active:
                    runs[0].join(_ENFORCE_EVERY_S)
                return

    @property
    def capacity(self) -> Capacity:
        """What all runs together may use."""
        return self._executor.capacity

    @property
    def active_count(self) -> int:
        """The number of runs that this runner has."""
        return len(self._active)

    def reserved(self) -> Capacity:
        """Return what its runs may use."""
        return _reserved_by(self._active_runs())

    def stop(self) -> None:
        """Have `run` return soon. From any thread, and from a signal handler."""
        self._is_stopping.set()
        self._has_capacity.set()

    def close(self, *, kill: bool) -> None:
        """End all threads, and with `kill` the jobs; the next runner continues the runs."""
        notify_stopping()
        active = self._active_runs()
        for run in active:
            run.stop.send(StopRequest.detach)
        deadline = time.monotonic() + _DETACH_S
        for run in active:
            run.join(max(0.0, deadline - time.monotonic()))
        if kill:
            for run in active:
                run.kill()
        self._is_closed.set()
        self._has_changes.set()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(_ENFORCE_EVERY_S)
        self._executor.close()
        for connections in (self._api, self._heartbeat_api, self._store):
            connections.close()

    def _continue_runs(self) -> None:
        entries = self._state.find_attempts()
        attempts = [entry for entry in entries if isinstance(entry, Attempt)]
        self._executor.remove_others([attempt.key for attempt in attempts])
        for entry in entries:
            if isinstance(entry, Path):
                with contextlib.suppress(OSError):
                    runner_state.remove_tree(entry)
        # Where the jobs end in time by themselves, the login node, its clock, and a silent server cost none of them.
        confirmed_s = boot_time_s() if self._executor.nodes_enforce_leases else self._state.last_heartbeat_s()
        until_s = max(boot_time_s() + _CONFIRMATION_S, confirmed_s + self._executor.lease_s - LEASE_MARGIN_S)
        for attempt in attempts:
            _log.info("continuing the run %s", attempt.state.assignment.run_id)
            self._add(attempt, Lease(until_s), is_new=False)

    def _register_until_accepted(self) -> None:
        while not self._is_stopping.is_set():
            self._progress_s["claims"] = time.monotonic()
            try:
                self._register()
                return
            except _REFUSALS:
                if not self._active:
                    raise
            except KleinkramError as error:
                self._log_unreachable(error)
            self._is_stopping.wait(_RETRY_S)

    def _register(self) -> None:
        self._runners.register(
            RunnerRegistration(
                id=self._state.runner_id,
                name=self._options.name,
                labels=[*self._options.labels],
                capacity=self._executor.capacity,
                abilities=self._executor.abilities,
                lease_s=self._executor.lease_s,
                default_image=self._default_image_digest,
                version=kleinkram.__version__,
            )
        )

    def _find_default_image(self) -> None:
        """Look for the image that scripts run on until it is available, and report its digest."""
        is_logged = False
        while not self._is_closed.is_set():
            try:
                self._default_image_digest = self._executor.prepare_image(self._options.default_image or "").digest
                if not self._is_closed.is_set():
                    self._register()
                return
            except CannotStart as error:
                if not is_logged:
                    _log.warning("no script can be run yet: %s", error)
                is_logged = True
            except KleinkramError as error:
                _log.warning("the default image could not be reported to the server yet: %s", error)
            self._is_closed.wait(_DEFAULT_IMAGE_RETRY_S)

    def _find_abilities(self) -> None:
        """Look for abilities until all are known and reported."""
        is_reported = False
        while not (is_reported or self._is_closed.wait(_ABILITIES_RETRY_S)):
            self._executor.find_abilities()
            if self._is_closed.is_set():
                return
            try:
                self._register()
                is_reported = self._executor.are_abilities_known
            except KleinkramError as error:
                _log.warning("what this runner offers could not be reported to the server yet: %s", error)

    def _claim(self, *, max_runs: int) -> list[ActiveRun]:
        """Wait for runs and start them; none where there are none."""
        self._has_capacity.clear()
        self._progress_s["claims"] = time.monotonic()
        active = self._active_runs()
        free = self._executor.free(_reserved_by(active), len(active))
        if free is None:
            self._has_capacity.wait(HEARTBEAT_S)
            # The ends of several runs are reported, and free their resources, together.
            self._is_stopping.wait(min(_CAPACITY_PAUSE_S, report_pause_s(len(active))))
            return []
        # With active runs, capacity may be freed soon, which a new request reports.
        request = ClaimRequest(
            free=free,
            max_runs=min(max_runs, self._executor.max_claimed(len(active))),
            wait_s=HEARTBEAT_S if active else MAX_WAIT_S,
            active_run_ids=[run.assignment.run_id for run in active],
        )
        requested_s = boot_time_s()
        try:
            self._executor.evict_unused()
            assignments = self._runners.claim(self._state.runner_id, request)
            self._is_unreachable = False
            self.statistics.count_answer()
            return [self._start(assignment, requested_s) for assignment in assignments]
        except NotFound:
            self._register_until_accepted()
        except (KleinkramError, OSError) as error:
            self.statistics.count_error("claim")
            self._log_unreachable(error)
            self._is_stopping.wait(_REFUSED_RETRY_S if isinstance(error, _REFUSALS) else _RETRY_S)
        return []

    def _start(self, assignment: RunAssignment, requested_s: float) -> ActiveRun:
        _log.info("got the run %s of %s", assignment.run_id, assignment.action.name)
        attempt = self._state.create_attempt(assignment)
        # Counted from the request, the lease ends here before it does on the server.
        return self._add(attempt, Lease(requested_s + assignment.lease_s - LEASE_MARGIN_S), is_new=True)

    def _log_unreachable(self, error: Exception) -> None:
        """Log an error once, however long it lasts."""
        if not self._is_unreachable:
            _log.warning("no run can be claimed: %s", error)
        self._is_unreachable = True

    def _add(self, attempt: Attempt, lease: Lease, *, is_new: bool) -> ActiveRun:
        run = ActiveRun(self._context, attempt, lease, is_new=is_new, on_end=self._remove)
        with self._lock:
            self._active[run.assignment.run_id] = run
        run.start()
        self._has_changes.set()
        return run

    def _remove(self, run: ActiveRun) -> None:
        with self._lock:
            if self._active.get(run.assignment.run_id) is run:
                del self._active[run.assignment.run_id]
        self._has_capacity.set()

    def _active_runs(self) -> list[ActiveRun]:
        with self._lock:
            return [*self._active.values()]

    def _send_heartbeats(self) -> None:
        runners = Runners(self._heartbeat_api)
        backoff = None
        while not self._is_closed.is_set():
            pause_s = max(_HEARTBEAT_PAUSE_S, report_pause_s(self.active_count))
            self._has_changes.wait(max(0.0, HEARTBEAT_S - pause_s))
            self._has_changes.clear()
            self._progress_s["heartbeats"] = time.monotonic()
            try:
                self._send_heartbeat(runners)
                backoff = None
            except Exception as error:
                # Whatever it is: without this thread, all runs would lose their leases, and their results.
                self.statistics.count_error("heartbeat")
                if backoff is None:
                    is_expected = isinstance(error, KleinkramError | OSError)
                    words = "the server gets no heartbeats of %d runs: %s"
                    _log.warning(words, len(self._active), error, exc_info=None if is_expected else error)
                backoff = backoff or Backoff(math.inf, self._is_closed.wait)
                backoff.pause()
            self._is_closed.wait(pause_s)

    def _send_heartbeat(self, runners: Runners) -> None:
        active = {run.assignment.run_id: run for run in self._active_runs()}
        if not active:
            return
        began_s = boot_time_s()
        for request in self._heartbeats.build([run.heartbeat() for run in active.values()]):
            requested_s = boot_time_s()
            replies = runners.send_heartbeats(self._state.runner_id, request)
            self.statistics.count_answer()
            for heartbeat, reply in self._heartbeats.match(request, replies):
                active[reply.run_id].on_reply(heartbeat, reply, requested_s=requested_s, lease_s=replies.lease_s)
        try:
            self._state.record_heartbeat(began_s)  # for the next runner
            self._is_heartbeat_recorded = True
        except OSError as error:
            if self._is_heartbeat_recorded:
                _log.warning("the last heartbeat cannot be recorded in %s: %s", self._state.path, error)
            self._is_heartbeat_recorded = False

    def _enforce_leases(self) -> None:
        watchdog = Watchdog()
        while not self._is_closed.wait(_ENFORCE_EVERY_S):
            if time.monotonic() - min(self._progress_s.values()) < _HANGS_S:
                watchdog.ping()
            for run in self._active_runs():
                try:
                    run.enforce()
                except Exception:  # noqa: PERF203  the others have leases, too
                    _log.exception("the lease of the run %s is not enforced", run.assignment.run_id)


def _reserved_by(runs: Sequence[ActiveRun]) -> Capacity:
    resources = [run.assignment.resources for run in runs]
    return Capacity(
        cores=sum(one.cores for one in resources),
        memory_bytes=sum(one.memory_bytes for one in resources),
        disk_bytes=sum(one.disk_bytes for one in resources),
        gpus=sum(one.gpus for one in resources),
    )
