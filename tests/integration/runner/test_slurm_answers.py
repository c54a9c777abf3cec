"""The executor of Slurm where answers are lost, late or misleading: by a queue whose answers the tests choose."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.runners import Capacity
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart, RunJob
from kleinkram.runner.executors.slurm import executor as slurm_executor
from kleinkram.runner.executors.slurm import node_job, submissions
from kleinkram.runner.executors.slurm.commands import (
    ClusterSettings,
    QueueEntry,
    SlurmCommands,
    SlurmRefused,
    SlurmUnavailable,
)
from kleinkram.runner.executors.slurm.executor import SlurmExecutor
from kleinkram.runner.executors.slurm.node_job import SharedLease
from kleinkram.runner.executors.slurm.options import SlurmOptions
from kleinkram.runner.executors.slurm.probe import NodeOffer, SlurmSite
from kleinkram.runner.executors.slurm.queue_monitor import QueueMonitor, QueueSnapshot
from kleinkram.runner.executors.slurm.shared_files import NodeStart, read_submission, write_lease, write_start


class Clock:
    """The boot clock of a machine."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


class Commands(SlurmCommands):
    """Slurm's commands: `sbatch` fails with `failure`, if there is one."""

    def __init__(self) -> None:
        super().__init__()
        self.failure: Exception | None = None
        self.names: list[str] = []
        self.arrays: list[str] = []
        self.accepts_arrays = True

    def submit(self, options: Sequence[str], command: str) -> str:
        """Count a job."""
        self.names.append(options[0].removeprefix("--job-name="))
        self.arrays += [option for option in options if option.startswith("--array=")]
        if self.failure is not None:
            raise self.failure
        if self.arrays and not self.accepts_arrays:
            self.arrays.clear()
            raise SlurmRefused("Invalid job array specification")
        return str(len(self.names))


class Queue(QueueMonitor):
    """The queue, as tests set it."""

    def __init__(self, commands: SlurmCommands, clock: Clock) -> None:
        super().__init__(commands, "klein-")
        self.clock = clock
        self.killed: list[str] = []
        self.released: list[str] = []
        self.kills_others = False

    def show(self, name: str | None = None, state: str = "PENDING", reason: str = "None") -> None:
        """Show one job, or none, as of two seconds later."""
        self.clock.now_s += 2
        entries = {name: QueueEntry("1", state, 1.0, 2.0, "node1", name, reason)} if name else {}
        self.snapshot = QueueSnapshot(self.clock.now_s, entries)

    def watch(self, name: str) -> None:
        """Do nothing."""

    def kill(self, name: str) -> None:
        """Record it."""
        self.killed.append(name)

    def release(self, name: str) -> None:
        """Record it."""
        self.released.append(name)

    def kill_others(self) -> None:
        """Record it."""
        self.kills_others = True


class OneJob:
    """One job of an executor whose queue and clock a test controls."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = Clock()
        monkeypatch.setattr(slurm_executor, "boot_time_s", self.clock)
        monkeypatch.setattr(submissions, "boot_time_s", self.clock)
        self.commands = Commands()
        capacity = Capacity(cores=8, memory_bytes=10**10, disk_bytes=0, gpus=0)
        settings = ClusterSettings(max_array_size=3)
        options = SlurmOptions(2, max_tasks=2)
        self.site = SlurmSite(self.commands, options, capacity, NodeOffer(is_isolated=True), settings)
        self.executor = self.again()
        self.job = RunJob("a-job", folder, ["true"], None, Resources(), Network.none)

    def again(self) -> SlurmExecutor:
        """Return the executor of the next runner process."""
        self.executor = SlurmExecutor(self.site)
        self.queue = Queue(self.commands, self.clock)
        self.executor._queue = self.queue
        return self.executor

    @property
    def name(self) -> str:
        """The name of the current submission."""
        submission = read_submission(self.job.directory)
        assert submission is not None
        return submission.name

    def end(self, reason: str = "done") -> None:
        """Write an ending, as the supervisor on the node does."""
        values = {"reason": reason, "message": "", "exit_code": 0}
        (self.job.directory / "ending.json").write_text(json.dumps(values))


@pytest.fixture
def one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> OneJob:
    return OneJob(tmp_path, monkeypatch)


def test_a_lost_answer_to_a_submission_submits_nothing_twice(one: OneJob) -> None:
    one.commands.failure = SlurmUnavailable("Socket timed out on send/recv operation")
    one.executor.submit(one.job)
    one.commands.failure = None
    assert one.executor.reason_waiting(one.job) == "waits for Slurm: Socket timed out on send/recv operation"
    one.queue.show(one.name, "RUNNING")
    assert one.executor.poll(one.job) is None
    placement = one.executor.placement(one.job)
    assert placement is not None
    assert (placement.job_id, placement.queued_s, len(one.commands.names)) == ("1", 1.0, 1)


def test_a_submission_that_did_not_arrive_is_repeated_under_another_name(one: OneJob) -> None:
    one.commands.failure = SlurmUnavailable("Unable to contact slurm controller (connect failure)")
    one.executor.submit(one.job)
    first = one.name
    executor = one.again()  # a kill of the runner does not change that
    one.commands.failure = None
    while len(one.commands.names) == 1:
        one.queue.show()
        assert executor.poll(one.job) is None
    assert one.name != first
    assert one.clock.now_s > 1010


def test_a_refused_submission_is_not_possible(one: OneJob) -> None:
    one.commands.failure = SlurmRefused("Invalid account or account/partition combination specified")
    with pytest.raises(CannotStart, match="Slurm refused its job: Invalid account") as caught:
        one.executor.submit(one.job)
    assert caught.value.ending.reason is EndReason.not_possible


def test_a_job_that_is_about_to_be_requeued_is_not_lost(one: OneJob) -> None:
    one.executor.submit(one.job)
    for state in ("RUNNING", "CANCELLED", "CANCELLED", "PENDING", "RUNNING", "NODE_FAIL", "COMPLETING", "PENDING"):
        one.queue.show(one.name, state)
        assert one.executor.poll(one.job) is None
    one.queue.show()
    assert one.executor.poll(one.job) is None
    one.end()
    one.queue.show()
    ending = one.executor.poll(one.job)
    assert ending is not None
    assert (ending.reason, len(one.commands.names)) == (EndReason.done, 1)


def test_an_ending_that_is_seen_late_counts(one: OneJob) -> None:
    one.executor.submit(one.job)
    one.queue.show(one.name, "COMPLETED")
    assert one.executor.poll(one.job) is None
    one.end("exit_code")
    one.queue.show(one.name, "COMPLETED")
    ending = one.executor.poll(one.job)
    assert ending is not None
    assert ending.reason is EndReason.exit_code


def test_a_job_that_slurm_forgot_is_submitted_three_times_at_most(one: OneJob) -> None:
    one.executor.submit(one.job)
    ending = None
    while ending is None:
        one.queue.show()
        ending = one.executor.poll(one.job)
    assert (ending.reason, len(one.commands.names)) == (EndReason.lost, 3)
    assert len({*one.commands.names}) == 3


def test_a_controller_that_does_not_answer_ends_no_job(one: OneJob) -> None:
    one.executor.submit(one.job)
    one.queue.show()
    one.executor.poll(one.job)
    one.queue.error = "Unable to contact slurm controller"
    one.clock.now_s += 10_000
    assert one.executor.poll(one.job) is None
    one.queue.error = None
    one.queue.show(one.name, "RUNNING")
    assert one.executor.poll(one.job) is None


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        ("PartitionNodeLimit", "it asks for more nodes than its partition allows"),
        ("BadConstraints", "no node has what it asks for"),
    ],
)
def test_a_job_that_can_never_start_is_ended(one: OneJob, reason: str, words: str) -> None:
    one.executor.submit(one.job)
    ending = None
    while ending is None:
        one.queue.show(one.name, "PENDING", reason)
        ending = one.executor.poll(one.job)
    assert (ending.reason, words in ending.message) == (EndReason.not_possible, True)
    assert one.queue.killed == [one.name]


def test_a_job_that_no_node_can_start_is_released_three_times(one: OneJob) -> None:
    one.executor.submit(one.job)
    ending = None
    while ending is None:
        one.queue.show(one.name, "PENDING", "launch failed requeued held")
        ending = one.executor.poll(one.job)
    assert (ending.reason, len(one.queue.released)) == (EndReason.lost, 3)
    assert one.queue.killed == [one.name]


def test_a_queue_that_is_full_gets_no_further_job(one: OneJob) -> None:
    none = Capacity(cores=0, memory_bytes=0, disk_bytes=0, gpus=0)
    assert one.executor.free(none, 1) == one.executor.capacity
    assert one.executor.free(none, 2) is None


def test_a_lease_counts_from_when_the_node_sees_it_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clocks of login node and node have nothing in common."""
    clock = Clock()
    clock.now_s = 5_000_000.0
    monkeypatch.setattr(node_job, "boot_time_s", clock)
    write_lease(tmp_path, 900, create=True)
    lease = SharedLease(tmp_path)
    assert (lease.is_renewed, lease.is_over()) == (False, False)
    clock.now_s += 899
    write_lease(tmp_path, 900, create=False)
    lease.read()
    assert lease.is_renewed
    clock.now_s += 899
    lease.read()
    assert not lease.is_over()
    clock.now_s += 2
    lease.read()
    assert lease.is_over()


@pytest.fixture
def several(one: OneJob, tmp_path: Path) -> list[RunJob]:
    """Jobs that are ready at the same moment."""
    jobs = [dataclasses.replace(one.job, key=f"job-{number}", directory=tmp_path / str(number)) for number in range(3)]
    for job in jobs:
        job.directory.mkdir()
    return jobs


def submit_at_once(one: OneJob, jobs: Sequence[RunJob]) -> None:
    with ThreadPoolExecutor(len(jobs)) as pool:
        list(pool.map(one.executor.submit, jobs))


def ids_of(one: OneJob, jobs: Sequence[RunJob]) -> set[str | None]:
    placements = [one.executor.placement(job) for job in jobs]
    return {placement.job_id for placement in placements if placement is not None}


def test_jobs_that_are_ready_together_are_one_array(one: OneJob, several: list[RunJob]) -> None:
    submit_at_once(one, several)
    assert one.commands.arrays == ["--array=0-2%2"]
    assert ids_of(one, several) == {"1_0", "1_1", "1_2"}


def test_jobs_that_ask_for_different_things_are_not(one: OneJob, several: list[RunJob]) -> None:
    several[0] = dataclasses.replace(several[0], resources=Resources(cores=3))
    submit_at_once(one, several)
    assert one.commands.arrays == ["--array=0-1%2"]
    assert len(one.commands.names) == 2


def test_an_array_that_slurm_refuses_is_submitted_one_by_one(one: OneJob, several: list[RunJob]) -> None:
    one.commands.accepts_arrays = False
    submit_at_once(one, several)
    assert ids_of(one, several) == {"2", "3", "4"}


def test_each_task_of_an_array_that_did_not_arrive_is_submitted_again(one: OneJob, several: list[RunJob]) -> None:
    one.commands.failure = SlurmUnavailable("Unable to contact slurm controller (connect failure)")
    submit_at_once(one, several)
    one.commands.failure = None
    while len(one.commands.names) < 4:
        one.queue.show()
        assert [one.executor.poll(job) for job in several] == [None] * 3
    assert ids_of(one, several) == {"2", "3", "4"}


def test_jobs_of_nobody_are_killed_once_all_known_ones_were_found(one: OneJob, several: list[RunJob]) -> None:
    submit_at_once(one, several)
    executor = one.again()
    executor.remove_others([job.key for job in several])
    for job in several:
        assert not one.queue.kills_others
        executor.poll(job)
    assert one.queue.kills_others


def test_a_runner_that_finds_a_job_ended_reports_its_last_start(one: OneJob) -> None:
    one.executor.submit(one.job)
    write_start(one.job.directory, NodeStart("a-token", "node1", 1, []))
    one.end()
    executor = one.again()
    assert executor.poll(one.job) is not None
    placement = executor.placement(one.job)
    assert placement is not None
    assert (placement.node, placement.requeues) == ("node1", 1)
