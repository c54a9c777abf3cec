"""Requests about single runs, which a runner with many runs combines: those of one moment become one request.

Hundreds of short jobs start and end at a time on a cluster; then one request for all of them costs the server little
more than one for each.
"""

import logging
import math
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Generic, NamedTuple, TypeVar

from pydantic import BaseModel

from kleinkram.client.runs import Runners
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.runners import (
    MAX_RUNS,
    Heartbeat,
    HeartbeatReplies,
    HeartbeatReply,
    Heartbeats,
    LeaseStatus,
    RunAttempt,
    RunEnd,
    RunFinish,
)
from kleinkram.contract.runs import RunContext

_log = logging.getLogger("kleinkram.runner")
ItemT = TypeVar("ItemT", bound=BaseModel)
AnswerT = TypeVar("AnswerT")

# A runner with more runs combines requests.
MANY_RUNS = 10
# Contexts are requested by all runs of one claim at once.
_CONTEXT_PAUSE_S = 0.05
# A larger report is sent alone: servers limit the size of requests.
_MAX_ITEM_BYTES = 64 * 1024
_MAX_REQUEST_BYTES = 2**20
# In the heartbeats of one request: about as large.
_MAX_SAMPLES = 5000
_REPEAT_S = 60.0


def report_pause_s(runs: int) -> float:
    """Return how long news of one of so many runs wait for those of others, to be one request, in seconds."""
    return min(4.0, runs / 100)


def split_heartbeats(heartbeats: Sequence[Heartbeat]) -> Iterator[list[Heartbeat]]:
    """Return heartbeats in parts that a server accepts in one request: after an outage, runs have many samples."""
    batch: list[Heartbeat] = []
    samples = 0
    for heartbeat in heartbeats:
        samples += len(heartbeat.samples)
        if batch and samples > _MAX_SAMPLES:
            yield batch
            batch, samples = [], len(heartbeat.samples)
        batch.append(heartbeat)
    if batch:
        yield batch


class HeartbeatRequests:
    """Requests with the heartbeats of a runner's runs: with many runs, each says only what the server does not know."""

    def __init__(self) -> None:
        self._known: dict[uuid.UUID, _KnownHeartbeat] = {}

    def build(self, heartbeats: Sequence[Heartbeat]) -> Iterator[Heartbeats]:
        """Return the next requests about all runs; at least one."""
        news, unchanged = [], []
        self._known = {one.run_id: self._known[one.run_id] for one in heartbeats if one.run_id in self._known}
        for heartbeat in heartbeats:
            known = self._known.get(heartbeat.run_id)
            if len(heartbeats) > MANY_RUNS and known is not None and known.says(heartbeat):
                unchanged.append(RunAttempt(run_id=heartbeat.run_id, attempt=heartbeat.attempt))
            else:
                news.append(heartbeat)
        for batch in [*split_heartbeats(news)] or [[]]:
            yield Heartbeats(runs=batch, unchanged=unchanged)
            unchanged = []

    def match(self, request: Heartbeats, replies: HeartbeatReplies) -> list[tuple[Heartbeat, HeartbeatReply]]:
        """Return the heartbeats of a request with their replies, and remember what the server knows now."""
        answered = {(reply.run_id, reply.attempt): reply for reply in replies.runs}
        matched = []
        for one in request.unchanged:
            active = HeartbeatReply(run_id=one.run_id, attempt=one.attempt, status=LeaseStatus.active)
            matched.append((self._known[one.run_id].heartbeat, answered.get((one.run_id, one.attempt), active)))
        for heartbeat in request.runs:
            reply = answered.get((heartbeat.run_id, heartbeat.attempt))
            if reply is not None:
                without_samples = heartbeat.model_copy(update={"samples": []})
                self._known[heartbeat.run_id] = _KnownHeartbeat(without_samples, time.monotonic())
                matched.append((heartbeat, reply))
        return matched


class _KnownHeartbeat(NamedTuple):
    """A heartbeat that the server answered, without its samples; and when it was sent."""

    heartbeat: Heartbeat
    sent_s: float

    def says(self, heartbeat: Heartbeat) -> bool:
        """Whether another one says no more. From time to time it is repeated, for servers restored from a backup."""
        return self.heartbeat == heartbeat and time.monotonic() - self.sent_s < _REPEAT_S


class RunRequests:
    """Requests of one runner about its runs. Thread-safe. `count` returns the number of its runs."""

    def __init__(
        self, runners: Runners, runner_id: uuid.UUID | None = None, count: Callable[[], int] = lambda: 1
    ) -> None:
        self._runners = runners
        self._count = count
        once = runners.with_retry(0, time.sleep)

        def get_contexts(attempts: Sequence[RunAttempt]) -> Sequence[RunContext | None]:
            return [] if runner_id is None else once.get_contexts(runner_id, attempts)

        def finish(ends: Sequence[RunEnd]) -> Sequence[object]:
            return [] if runner_id is None else once.finish_all(runner_id, ends)

        self._contexts = _CombinedRequests(get_contexts, lambda: _CONTEXT_PAUSE_S)
        self._ends = _CombinedRequests(finish, lambda: report_pause_s(count()))

    def get_context(self, run_id: uuid.UUID, attempt: int) -> RunContext:
        """Return the content of `/in/mission.json`.

        Raises:
            RunGone: the run is not this runner's.
        """
        context = None
        if self._count() > MANY_RUNS:
            context = self._contexts.send(RunAttempt(run_id=run_id, attempt=attempt))
        # The answer of a request about it alone says what is wrong.
        return context or self._runners.get_context(run_id, attempt)

    def finish(self, run_id: uuid.UUID, finish: RunFinish, wait: Callable[[float], object]) -> None:
        """Report the end of a run, for as long as that takes; `wait` waits between tries (seconds).

        Raises:
            RunGone: the run is not this runner's.
            KleinkramError: the server does not accept it.
        """
        if not (self._count() > MANY_RUNS and self._ends.send(RunEnd(run_id=run_id, finish=finish))):
            self._runners.with_retry(math.inf, wait).finish(run_id, finish)


class _CombinedRequests(Generic[ItemT, AnswerT]):
    """Sends the items of several threads in one request: of that whose turn it is, while the others wait."""

    def __init__(
        self, send: Callable[[Sequence[ItemT]], Sequence[AnswerT | None]], pause_s: Callable[[], float]
    ) -> None:
        self._send = send
        self._pause_s = pause_s
        self._waiting: deque[_WaitingItem[ItemT, AnswerT]] = deque()
        self._turn = threading.Lock()

    def send(self, item: ItemT) -> AnswerT | None:
        """Send an item, and return its answer; None where it is too large, or there is no answer."""
        waiting = _WaitingItem[ItemT, AnswerT](item)
        if waiting.size_bytes > _MAX_ITEM_BYTES:
            return None
        self._waiting.append(waiting)
        with self._turn:
            while not waiting.is_sent:
                time.sleep(self._pause_s())
                self._send_next()
        return waiting.answer

    def _send_next(self) -> None:
        batch: list[_WaitingItem[ItemT, AnswerT]] = []
        left_bytes = _MAX_REQUEST_BYTES
        while self._waiting and len(batch) < MAX_RUNS and self._waiting[0].size_bytes <= left_bytes:
            batch.append(self._waiting.popleft())
            left_bytes -= batch[-1].size_bytes
        try:
            answers = self._send([one.item for one in batch])
            for one, answer in zip(batch, answers, strict=False):
                one.answer = answer
        except (KleinkramError, OSError) as error:
            _log.warning("a combined request about %d runs failed; each is sent alone: %s", len(batch), error)
        finally:
            # Whatever happens: each of them must be sent alone then.
            for one in batch:
                one.is_sent = True


class _WaitingItem(Generic[ItemT, AnswerT]):
    """An item of a request, and its answer once `is_sent`."""

    def __init__(self, item: ItemT) -> None:
        self.item = item
        self.size_bytes = len(item.model_dump_json())
        self.is_sent = False
        self.answer: AnswerT | None = None
