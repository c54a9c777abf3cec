"""A runner: asks for runs as long as there is room, sees each to its end, and says all the while what they are at.

Threads: one asks for runs, one beats for all of them, one sees that none is held too long, and each run has its own.
None of them is needed for what runs: that goes on without this process, and the next one takes it up.
"""

import contextlib
import logging
import math
import threading
import time
import uuid
from dataclasses import dataclass, field
from pathlib import Path

import kleinkram
from kleinkram.client._http import Api
from kleinkram.client._retry import Backoff
from kleinkram.client.config import Endpoint, EndpointSource
from kleinkram.client.runners import Runners
from kleinkram.client.service import Service
from kleinkram.client.transfer.store import StoreClient
from kleinkram.contract.errors import Forbidden, KleinkramError, NotAuthenticated, NotFound, ScopeMissing
from kleinkram.contract.runners import (
    HEARTBEAT_S,
    LEASE_S,
    MAX_WAIT_S,
    Capacity,
    ClaimRequest,
    Heartbeats,
    RunAssignment,
    RunnerRegistration,
)
from kleinkram.runner import attempts
from kleinkram.runner.attempts import Attempt
from kleinkram.runner.cache import Cache
from kleinkram.runner.disk import remove_tree
from kleinkram.runner.ground import Ground
from kleinkram.runner.held import HeldRun
from kleinkram.runner.home import Home
from kleinkram.runner.machine import Share, cache_bytes_of, capacity_of, what_is_left
from kleinkram.runner.orders import MARGIN_S, Lease, Order
from kleinkram.runner.stock import DefaultImage
from kleinkram.runner.ward import now_s
from kleinkram.runner.work import Executor

_log = logging.getLogger("kleinkram.runner")
_BEAT_TIMEOUT_S = 10.0
_BEATS_APART_S = 0.1
_PRESS_EVERY_S = 0.2
_AGAIN_S = 3.0
_REFUSED_AGAIN_S = 15.0
# So long the runs that were found go on before the server has said whose they are.
_FIRST_WORD_S = 5.0
_LEAVE_S = 3.0
_LEAST_CORES = 0.01
_LEAST_BYTES = 2**20
_STORE_CONNECTIONS = 8
_NOT_WELCOME = (NotAuthenticated, Forbidden, ScopeMissing)


@dataclass(frozen=True)
class RunnerOptions:
    """What a runner is told when it starts. `url` and `token` are the server's, which `runs` reach by the same URL."""

    url: str
    token: str
    name: str
    labels: tuple[str, ...] = ()
    share: Share = field(default_factory=Share)
    default_image: str | None = None


class Runner:
    """One runner. `run` goes on until `stop`, or, with `once`, until one run is over."""

    def __init__(self, options: RunnerOptions, home: Home, executor: Executor) -> None:
        endpoint = Endpoint("runner", options.url, options.token, EndpointSource.argument)
        self._options = options
        self._home = home
        self._executor = executor
        self._api = Api(endpoint)
        self._runners = Runners(self._api)
        # A beat that gets no answer must not cost the lease.
        self._beating_api = Api(endpoint, read_timeout_s=_BEAT_TIMEOUT_S)
        self._beating = Runners(self._beating_api)
        self._store = StoreClient(_STORE_CONNECTIONS)
        self._stopping = threading.Event()
        self._over = threading.Event()
        self._is_cut_off = False
        self._is_noted = True
        self._news = threading.Event()
        self._has_room = threading.Event()
        self._held: dict[uuid.UUID, HeldRun] = {}
        self._lock = threading.Lock()
        used_bytes = home.used_bytes()
        self._capacity = capacity_of(options.share, home.folder, used_bytes=used_bytes)
        cache_bytes = cache_bytes_of(options.share, home.folder, used_bytes=used_bytes)
        self._cache = Cache(home.cache, cache_bytes)
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._beat, self._watch)]
        self._stock = DefaultImage(executor, options.default_image, self._hello)

    def run(self, *, once: bool = False) -> None:
        """Take up what an earlier runner left, then ask for runs until it is stopped.

        Raises:
            NotAuthenticated, Forbidden: the server knows the token not, or not as a runner's.
        """
        self._take_up()
        for thread in self._threads:
            thread.start()
        self._come_in()
        self._stock.start()
        _log.info("ready: %s", _said(self._capacity, self._executor))
        while not self._stopping.is_set():
            taken = self._ask()
            if taken is not None and once:
                while self._held:
                    taken.join(_PRESS_EVERY_S)
                return

    def stop(self) -> None:
        """Have `run` return soon. From any thread, and from a signal."""
        self._stopping.set()
        self._has_room.set()

    def leave(self, *, kill: bool) -> None:
        """End all threads, and with `kill` what runs of the runs; the next runner goes on with each."""
        held = self._all()
        for run in held:
            run.orders.give(Order.leave)
        until = time.monotonic() + _LEAVE_S
        for run in held:
            run.join(max(0.0, until - time.monotonic()))
        if kill:
            for run in held:
                run.kill()
        self._over.set()
        self._news.set()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(_PRESS_EVERY_S)
        for connections in (self._api, self._beating_api, self._store):
            connections.close()

    # -- coming in -----------------------------------------------------------------------------------------------------

    def _take_up(self) -> None:
        left = attempts.left_over(self._home.runs)
        found = [each for each in left if isinstance(each, Attempt)]
        self._executor.sweep([attempt.key for attempt in found])
        for folder in left:
            if isinstance(folder, Path):
                with contextlib.suppress(OSError):
                    remove_tree(folder)
        self._ground = self._make_ground()
        until_s = max(now_s() + _FIRST_WORD_S, self._home.heard_s() + LEASE_S - MARGIN_S)
        for attempt in found:
            _log.info("the run %s is taken up again", attempt.state.claim.run_id)
            self._hold(attempt, Lease(until_s), is_new=False)

    def _make_ground(self) -> Ground:
        options = self._options
        return Ground(
            executor=self._executor,
            runners=self._runners,
            store=self._store,
            cache=self._cache,
            url=options.url,
            token=options.token,
            service=Service(self._api),
            default_image=options.default_image,
            changed=self._news.set,
        )

    def _come_in(self) -> None:
        """Say hello until the server hears it."""
        while not self._stopping.is_set():
            try:
                self._hello()
                return
            except _NOT_WELCOME:
                if not self._held:
                    raise
            except KleinkramError as error:
                self._say_cut_off(error)
            self._stopping.wait(_AGAIN_S)

    def _hello(self) -> None:
        options = self._options
        self._runners.hello(
            RunnerRegistration(
                id=self._home.runner_id,
                name=options.name,
                labels=[*options.labels],
                capacity=self._capacity,
                abilities=self._executor.abilities,
                default_image=self._stock.digest,
                version=kleinkram.__version__,
            )
        )

    # -- asking --------------------------------------------------------------------------------------------------------

    def _ask(self) -> HeldRun | None:
        """Wait for a run and begin it; None where none came."""
        self._has_room.clear()
        free = self._free()
        if free.cores < _LEAST_CORES or min(free.memory_bytes, free.disk_bytes) < _LEAST_BYTES:
            self._has_room.wait(HEARTBEAT_S)
            return None
        held = [*self._held]
        # What is free may soon be more: then it is said anew.
        ask = ClaimRequest(free=free, wait_s=HEARTBEAT_S if held else MAX_WAIT_S, active_run_ids=held)
        asked_s = now_s()
        try:
            claim = self._runners.claim(self._home.runner_id, ask)
            self._is_cut_off = False
            return self._take(claim, asked_s) if claim else None
        except NotFound:
            self._come_in()
        except (KleinkramError, OSError) as error:
            self._say_cut_off(error)
            self._stopping.wait(_REFUSED_AGAIN_S if isinstance(error, _NOT_WELCOME) else _AGAIN_S)
        return None

    def _say_cut_off(self, error: Exception) -> None:
        """Say it once, however long it lasts."""
        if not self._is_cut_off:
            _log.warning("no run can be taken on: %s", error)
        self._is_cut_off = True

    def _take(self, claim: RunAssignment, asked_s: float) -> HeldRun:
        _log.info("got the run %s of %s", claim.run_id, claim.action.name)
        attempt = attempts.begin(self._home.runs, claim)
        # The server gave it after it was asked: counted from then, the lease is shorter than it is.
        return self._hold(attempt, Lease(asked_s + claim.lease_s - MARGIN_S), is_new=True)

    def _hold(self, attempt: Attempt, lease: Lease, *, is_new: bool) -> HeldRun:
        run = HeldRun(self._ground, attempt, lease, is_new=is_new, over=self._let_go)
        with self._lock:
            self._held[run.claim.run_id] = run
        run.start()
        self._news.set()
        return run

    def _let_go(self, run: HeldRun) -> None:
        with self._lock:
            if self._held.get(run.claim.run_id) is run:
                del self._held[run.claim.run_id]
        self._has_room.set()

    def _free(self) -> Capacity:
        return what_is_left(self._capacity, [run.claim.resources for run in self._all()])

    def _all(self) -> list[HeldRun]:
        with self._lock:
            return [*self._held.values()]

    # -- holding -------------------------------------------------------------------------------------------------------

    def _beat(self) -> None:
        backoff = None
        while not self._over.is_set():
            self._news.wait(HEARTBEAT_S)
            self._news.clear()
            try:
                self._beat_once()
                backoff = None
            except (KleinkramError, OSError) as error:
                if backoff is None:
                    _log.warning("the server does not hear of %d runs: %s", len(self._held), error)
                backoff = backoff or Backoff(math.inf, self._over.wait)
                backoff.pause()
            self._over.wait(_BEATS_APART_S)

    def _beat_once(self) -> None:
        held = {run.claim.run_id: run for run in self._all()}
        if not held:
            return
        beats = {run_id: run.beat() for run_id, run in held.items()}
        asked_s = now_s()
        answers = self._beating.beat(self._home.runner_id, Heartbeats(runs=[*beats.values()]))
        self._note_heard(asked_s)
        for answer in answers.runs:
            run = held.get(answer.run_id)
            if run is not None and run.claim.attempt == answer.attempt:
                run.answered(beats[answer.run_id], answer, asked_s=asked_s, lease_s=answers.lease_s)

    def _note_heard(self, asked_s: float) -> None:
        """Note it where that can be done: it is for the next runner, and the runs of this one do without."""
        try:
            self._home.note_heard(asked_s)
            self._is_noted = True
        except OSError as error:
            if self._is_noted:
                _log.warning("when the server was heard last cannot be noted in %s: %s", self._home.folder, error)
            self._is_noted = False

    def _watch(self) -> None:
        while not self._over.wait(_PRESS_EVERY_S):
            for run in self._all():
                run.press()


def _said(capacity: Capacity, executor: Executor) -> str:
    return (
        f"{capacity.cores:g} cores, {capacity.memory_bytes / 1e9:.1f} GB memory, {capacity.disk_bytes / 1e9:.0f} GB "
        f"disk, {capacity.gpus} GPUs, runs as {executor.abilities.executor}"
    )
