"""Requests of runners with many runs are combined."""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import pytest

from kleinkram.client.runs import Runners
from kleinkram.contract.errors import InternalError
from kleinkram.contract.runners import (
    Heartbeat,
    HeartbeatReplies,
    HeartbeatReply,
    Heartbeats,
    LeaseStatus,
    RunEnd,
    RunFinish,
)
from kleinkram.contract.runs import EndReason, RunState, Usage, UsageSample
from kleinkram.runner import run_requests
from kleinkram.runner.run_requests import HeartbeatRequests, RunRequests, split_heartbeats

RUNNER_ID = uuid.UUID(int=1)
RUNS = [uuid.UUID(int=number) for number in range(100, 130)]


class Server:
    """The ends that arrived, each in its request. Combined ones end with the error `fails`; some runs are `gone`."""

    def __init__(self) -> None:
        self.combined: list[list[uuid.UUID]] = []
        self.alone: list[uuid.UUID] = []
        self.fails: Exception | None = None
        self.gone: set[uuid.UUID] = set()
        self._lock = threading.Lock()

    def with_retry(self, timeout_s: float, wait: Callable[[float], object]) -> Server:
        return self

    def finish(self, run_id: uuid.UUID, finish: RunFinish) -> None:
        with self._lock:
            self.alone.append(run_id)

    def finish_all(self, runner_id: uuid.UUID, ends: Sequence[RunEnd]) -> Sequence[RunState | None]:
        assert runner_id == RUNNER_ID
        if self.fails is not None:
            raise self.fails
        self.combined.append([end.run_id for end in ends])
        return [None if end.run_id in self.gone else RunState.done for end in ends]


def report(server: Server, count: int = 50, message: str = "") -> None:
    requests = RunRequests(cast(Runners, server), RUNNER_ID, lambda: count)
    finish = RunFinish(attempt=1, reason=EndReason.done, message=message)

    def finish_one(run_id: uuid.UUID) -> Any:
        return requests.finish(run_id, finish, lambda _: None)

    with ThreadPoolExecutor(len(RUNS)) as pool:
        [*pool.map(finish_one, RUNS)]


def test_ends_of_one_moment_are_one_request() -> None:
    server = Server()
    report(server)
    assert sorted(run_id for batch in server.combined for run_id in batch) == RUNS
    assert len(server.combined) < len(RUNS) / 3
    assert server.alone == []


def test_a_runner_with_ten_runs_waits_for_no_others() -> None:
    server = Server()
    report(server, count=10)
    assert (server.combined, sorted(server.alone)) == ([], RUNS)


def test_what_has_no_answer_is_sent_alone() -> None:
    server = Server()
    server.gone = {RUNS[3]}
    report(server)
    assert server.alone == [RUNS[3]]
    for error in (InternalError(request_id="a-request"), OSError("broken")):
        server.fails, server.alone = error, []
        report(server)
        assert sorted(server.alone) == RUNS


def test_a_request_that_fails_unexpectedly_leaves_no_other_run_waiting() -> None:
    server = Server()
    server.fails = RuntimeError("a bug")
    with pytest.raises(RuntimeError):
        report(server)
    assert len(server.alone) >= len(RUNS) // 2


def test_requests_have_a_limited_size(monkeypatch: Any) -> None:
    monkeypatch.setattr(run_requests, "_MAX_REQUEST_BYTES", 4000)
    server = Server()
    report(server, message="x" * 1000)
    assert max(map(len, server.combined)) <= 3
    assert sorted(run_id for batch in server.combined for run_id in batch) == RUNS
    monkeypatch.setattr(run_requests, "_MAX_ITEM_BYTES", 1000)
    report(server, message="x" * 1000)
    assert sorted(server.alone) == RUNS


def test_heartbeats_after_an_outage_are_split() -> None:
    """Servers refuse requests over 4 MiB: the leases of all runs would end."""
    numbers = dict.fromkeys(("memory_bytes", "peak_memory_bytes", "read_bytes", "written_bytes"), 2**40)
    samples = [UsageSample(at_s=number / 3, usage=Usage(cpu_s=1 / 3, **numbers)) for number in range(100)]
    sent = [Heartbeat(run_id=uuid.uuid4(), attempt=1, state=RunState.running, samples=samples) for _ in range(1000)]
    parts = [*split_heartbeats(sent)]
    assert [heartbeat for part in parts for heartbeat in part] == sent
    assert max(len(Heartbeats(runs=part).model_dump_json()) for part in parts) < 2 * 2**20
    without = [heartbeat.model_copy(update={"samples": []}) for heartbeat in sent]
    assert [*split_heartbeats(without)] == [without]
    assert [*split_heartbeats([])] == []


def heartbeats_of(runs: Sequence[uuid.UUID], **values: Any) -> list[Heartbeat]:
    return [Heartbeat(run_id=run_id, attempt=1, state=RunState.running, **values) for run_id in runs]


def exchange(
    requests: HeartbeatRequests, heartbeats: Sequence[Heartbeat], notable: Sequence[HeartbeatReply] = ()
) -> tuple[list[uuid.UUID], dict[uuid.UUID, LeaseStatus]]:
    """Send heartbeats; return the runs that were sent whole, and the statuses of all."""
    whole: list[uuid.UUID] = []
    statuses: dict[uuid.UUID, LeaseStatus] = {}
    for request in requests.build(heartbeats):
        sent = [one.run_id for one in request.runs]
        active = [HeartbeatReply(run_id=run_id, attempt=1, status=LeaseStatus.active) for run_id in sent]
        replies = HeartbeatReplies(runs=[*active, *notable], lease_s=60)
        whole += sent
        statuses |= {heartbeat.run_id: reply.status for heartbeat, reply in requests.match(request, replies)}
    return whole, statuses


def test_of_many_runs_only_news_are_sent() -> None:
    requests = HeartbeatRequests()
    heartbeats = heartbeats_of(RUNS)
    all_active = dict.fromkeys(RUNS, LeaseStatus.active)
    assert exchange(requests, heartbeats) == (RUNS, all_active)
    assert exchange(requests, heartbeats) == ([], all_active)
    heartbeats[4] = heartbeats[4].model_copy(update={"state": RunState.collecting})
    assert exchange(requests, heartbeats) == ([RUNS[4]], all_active)
    usage = Usage(cpu_s=1, memory_bytes=1, peak_memory_bytes=1, read_bytes=0, written_bytes=0)
    sampled = [*heartbeats]
    sampled[5] = sampled[5].model_copy(update={"samples": [UsageSample(at_s=1, usage=usage)]})
    assert exchange(requests, sampled) == ([RUNS[5]], all_active)
    assert exchange(requests, heartbeats) == ([], all_active)


def test_unchanged_runs_may_be_lost_or_cancelled() -> None:
    requests = HeartbeatRequests()
    heartbeats = heartbeats_of(RUNS)
    exchange(requests, heartbeats)
    notable = [
        HeartbeatReply(run_id=RUNS[1], attempt=1, status=LeaseStatus.lost),
        HeartbeatReply(run_id=RUNS[2], attempt=1, status=LeaseStatus.cancel),
        HeartbeatReply(run_id=RUNS[3], attempt=2, status=LeaseStatus.lost),
    ]
    whole, statuses = exchange(requests, heartbeats, notable)
    assert whole == []
    assert [statuses[run_id].value for run_id in RUNS[:4]] == ["active", "lost", "cancel", "active"]


def test_what_got_no_answer_is_sent_again() -> None:
    requests = HeartbeatRequests()
    heartbeats = heartbeats_of(RUNS)
    (request,) = requests.build(heartbeats)
    (again,) = requests.build(heartbeats)
    assert again == request
    answered = HeartbeatReplies(runs=[HeartbeatReply(run_id=RUNS[0], attempt=1, status=LeaseStatus.active)], lease_s=60)
    assert [heartbeat.run_id for heartbeat, _ in requests.match(request, answered)] == [RUNS[0]]
    (next_request,) = requests.build(heartbeats)
    assert [one.run_id for one in next_request.runs] == RUNS[1:]
    assert [one.run_id for one in next_request.unchanged] == RUNS[:1]


def test_heartbeats_are_repeated_for_a_restored_server(monkeypatch: pytest.MonkeyPatch) -> None:
    requests = HeartbeatRequests()
    heartbeats = heartbeats_of(RUNS)
    exchange(requests, heartbeats)
    monkeypatch.setattr(run_requests, "_REPEAT_S", 0.0)
    assert exchange(requests, heartbeats)[0] == RUNS


def test_a_runner_with_ten_runs_sends_all() -> None:
    requests = HeartbeatRequests()
    heartbeats = heartbeats_of(RUNS[:10])
    assert exchange(requests, heartbeats)[0] == RUNS[:10]
    assert exchange(requests, heartbeats)[0] == RUNS[:10]
