"""The executor of Slurm where answers are lost, late or misleading: by a queue whose answers the tests choose."""

from __future__ import annotations

import dataclasses
import errno
import json
import subprocess
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.reports import Report
from kleinkram.contract.runners import Capacity, RunFinish
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart, Ending, RunJob
from kleinkram.runner.executors.slurm import executor as slurm_executor
from kleinkram.runner.executors.slurm import job_endings, node_job, submissions
from kleinkram.runner.executors.slurm.commands import (
    ClusterNode,
    ClusterSettings,
    JobAccount,
    QueueEntry,
    SlurmCommands,
    SlurmRefused,
    SlurmUnavailable,
)
from kleinkram.runner.executors.slurm.executor import SlurmExecutor
from kleinkram.runner.executors.slurm.node_job import SharedLease
from kleinkram.runner.executors.slurm.options import SlurmOptions
from kleinkram.runner.executors.slurm.probe import NodeOffer, SlurmSite, find_site
from kleinkram.runner.executors.slurm.queue_monitor import QueueMonitor, QueueSnapshot
from kleinkram.runner.executors.slurm.shared_files import (
    NodeStart,
    read_submission,
    write_lease,
    write_start,
    write_submission,
)
from kleinkram.runner.executors.supervision import LEASE_EXPIRED
from kleinkram.runner.executors.transfer_steps import finish_file


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
        # Whether Slurm would refuse any job, also a small one.
        self.refuses_all = False
        self.checks = 0
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

    def check(self, options: Sequence[str]) -> None:
        """Refuse a small job, or not."""
        self.checks += 1
        if self.refuses_all:
            raise SlurmRefused("Required partition not available (inactive or drain)")


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
        monkeypatch.setattr(job_endings, "boot_time_s", self.clock)
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
        self.executor._queue = self.executor._endings._queue = self.queue
        return self.executor

    @property
    def name(self) -> str:
        """The name of the current submission."""
        submission = read_submission(self.job.directory)
        assert submission is not None
        return submission.name

    def begin(self, token: str = "a-token", restarts: int = 0) -> None:
        """Take the directory, as a start on the node does."""
        write_start(self.job.directory, NodeStart(token, "node1", restarts, []))

    def end(self, reason: str = "done", message: str = "", token: str = "a-token") -> None:
        """Write the ending of a start, as its supervisor does."""
        values = {"reason": reason, "message": message, "exit_code": 0}
        (self.job.directory / f"ending-{token}.json").write_text(json.dumps(values))


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
    one.begin()
    one.end()
    one.queue.show()
    ending = one.executor.poll(one.job)
    assert ending is not None
    assert (ending.reason, len(one.commands.names)) == (EndReason.done, 1)


def test_an_ending_that_is_seen_late_counts(one: OneJob) -> None:
    one.executor.submit(one.job)
    one.queue.show(one.name, "COMPLETED")
    assert one.executor.poll(one.job) is None
    one.begin()
    one.end("exit_code")
    one.queue.show(one.name, "COMPLETED")
    ending = one.executor.poll(one.job)
    assert ending is not None
    assert ending.reason is EndReason.exit_code


def end_of(one: OneJob, state: str | None = None) -> Ending:
    """Return how a job ends that Slurm shows in this state, or does not know, under each of its names."""
    while True:
        one.queue.show(one.name if state else None, state or "")
        if (ending := one.executor.poll(one.job)) is not None:
            return ending


def test_a_job_that_slurm_forgot_is_submitted_ten_times_at_most(one: OneJob) -> None:
    one.executor.submit(one.job)
    ending = end_of(one)
    assert (ending.reason, len(one.commands.names)) == (EndReason.lost, 10)
    assert ending.message == "Slurm forgot its job 10 times: 10 was last."
    assert len({*one.commands.names}) == 10


def test_a_job_whose_node_fails_is_submitted_three_times_at_most(one: OneJob) -> None:
    one.executor.submit(one.job)
    ending = end_of(one, "NODE_FAIL")
    assert (ending.reason, len({*one.commands.names})) == (EndReason.lost, 3)


def test_forgotten_jobs_do_not_count_as_those_whose_node_failed(one: OneJob) -> None:
    one.executor.submit(one.job)
    while len(one.commands.names) < 6:
        one.queue.show()
        assert one.executor.poll(one.job) is None
    one.again()  # also not in the next process of the runner
    assert end_of(one, "NODE_FAIL").reason is EndReason.lost
    assert len(one.commands.names) == 5 + 3


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
    one.begin(restarts=1)
    one.end()
    executor = one.again()
    assert executor.poll(one.job) is not None
    placement = executor.placement(one.job)
    assert placement is not None
    assert (placement.node, placement.requeues) == ("node1", 1)


def test_an_ending_of_an_earlier_start_does_not_count(one: OneJob) -> None:
    """Its node lost the file system while it wrote it, and Slurm started the job elsewhere."""
    one.executor.submit(one.job)
    one.begin("first")
    one.begin("second", restarts=1)
    one.end(token="first")
    one.queue.show(one.name, "RUNNING")
    assert one.executor.poll(one.job) is None
    one.end("exit_code", token="second")
    one.end(token="first")
    one.queue.show(one.name, "COMPLETED")
    ending = one.executor.poll(one.job)
    assert ending is not None
    assert ending.reason is EndReason.exit_code


def test_a_job_of_which_only_its_node_saw_the_lease_expire_is_submitted_again(one: OneJob) -> None:
    one.executor.submit(one.job)
    ending = None
    for token in ("first", "second", "third"):
        assert ending is None
        one.begin(token)
        one.end(*LEASE_EXPIRED, token=token)
        one.queue.show(one.name, "COMPLETED")
        ending = one.executor.poll(one.job)
    assert ending == Ending.of(LEASE_EXPIRED, 0)
    assert len({*one.commands.names}) == 3


def test_jobs_wait_while_slurm_refuses_any_job_of_their_runner(one: OneJob, several: list[RunJob]) -> None:
    """As in a partition that is drained: the queue of the server is not emptied by refusals, nor by claims."""
    none = Capacity(cores=0, memory_bytes=0, disk_bytes=0, gpus=0)
    one.commands.failure = SlurmRefused("Required partition not available (inactive or drain)")
    one.commands.refuses_all = True
    for job in several:
        one.executor.submit(job)
        waits = "waits for Slurm: Required partition not available (inactive or drain)"
        assert one.executor.reason_waiting(job) == waits
    assert one.executor.free(none, 0) is None
    assert (len(one.commands.names), one.commands.checks) == (1, 1)
    one.commands.failure = None
    while len(one.commands.names) < 4:
        one.queue.show()
        assert [one.executor.poll(job) for job in several] == [None] * 3
    assert one.executor.free(none, 0) == one.executor.capacity


def test_a_shared_file_system_that_does_not_answer_ends_no_job(one: OneJob, monkeypatch: pytest.MonkeyPatch) -> None:
    one.executor.submit(one.job)
    executor, name = one.again(), one.name
    read_text = Path.read_text

    def fail(path: Path, *_: object) -> str:
        raise OSError(errno.ESTALE, "Stale file handle", str(path))

    monkeypatch.setattr(Path, "read_text", fail)
    assert executor.poll(one.job) is None
    assert executor.placement(one.job) is None
    assert executor.reason_waiting(one.job) == "waits for the shared file system: Stale file handle"
    monkeypatch.setattr(Path, "read_text", read_text)
    one.queue.show(name, "RUNNING")
    assert executor.poll(one.job) is None
    monkeypatch.setattr(Path, "read_text", fail)
    assert executor.usage(one.job) is None
    one.queue.show(name, "COMPLETED")
    for _ in range(10):
        one.queue.show(name, "COMPLETED")
        assert executor.poll(one.job) is None
    monkeypatch.setattr(Path, "read_text", read_text)
    one.begin()
    one.end()
    one.queue.show(name, "COMPLETED")
    ending = executor.poll(one.job)
    assert ending is not None
    assert (ending.reason, len(one.commands.names)) == (EndReason.done, 1)


def test_a_submission_that_cannot_be_recorded_is_made_later(one: OneJob, monkeypatch: pytest.MonkeyPatch) -> None:
    one.executor.submit(one.job)
    first = one.name

    def fail(directory: Path, _: object) -> None:
        raise OSError(errno.EIO, "Input/output error", str(directory))

    monkeypatch.setattr(job_endings, "write_submission", fail)
    for _ in range(10):
        one.queue.show()
        assert one.executor.poll(one.job) is None
    assert (one.name, len(one.commands.names)) == (first, 1)
    monkeypatch.setattr(job_endings, "write_submission", write_submission)
    one.queue.show()
    one.executor.poll(one.job)
    assert len(one.commands.names) == 2


def test_how_slurm_says_that_a_job_ended_counts_where_its_node_uploaded_the_results(one: OneJob) -> None:
    one.site = dataclasses.replace(one.site, options=dataclasses.replace(one.site.options, transfers_on_nodes=True))
    executor = one.again()
    executor.submit(one.job)
    one.begin()
    plain = RunFinish(attempt=1, reason=EndReason.memory, message="Slurm ended it.", exit_code=137, report=Report())
    of_node = plain.model_copy(update={"reason": EndReason.signal, "message": "SIGKILL", "problems": ["a problem"]})
    finish_file(one.job.directory, "a-token").write_text(of_node.model_dump_json())
    one.queue.show()
    stored = executor.upload_results(one.job, plain, lambda _: None, lambda *_: None)
    assert stored is not None
    assert (stored.finish.reason, stored.finish.message) == (EndReason.memory, "Slurm ended it.")
    assert stored.finish.problems == ["a problem"]


class Accounting(SlurmCommands):
    """Records the queries of the accounting, which has some jobs."""

    def __init__(self) -> None:
        super().__init__()
        self.known: dict[str, JobAccount] = {}
        self.queries: list[Sequence[str]] = []

    def own_jobs(self, prefix: str) -> list[QueueEntry]:
        """Return none."""
        return []

    def accounts(self, job_ids: Sequence[str]) -> dict[str, JobAccount]:
        """Return those that are known."""
        self.queries.append(job_ids)
        return {job_id: self.known[job_id] for job_id in job_ids if job_id in self.known}


def test_one_sacct_is_for_all_ended_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    commands = Accounting()
    queue = QueueMonitor(commands, "klein-")
    monkeypatch.setattr(queue, "_wake", lambda: None)
    names = [f"klein-{number}" for number in range(3)]

    def accounts() -> list[JobAccount | None]:
        return [queue.account(name, str(number)) for number, name in enumerate(names)]

    assert accounts() == [None] * 3
    commands.known = {
        "0": JobAccount("klein-0", "COMPLETED", 2.5, 1000),
        "1": JobAccount("another job with this id", "COMPLETED", 1.0, 1),
        "2": JobAccount("klein-2", "RUNNING", 0.0, 0),
    }
    queue._ask()
    assert accounts() == [commands.known["0"], None, None]
    queue._ask()
    assert commands.queries == [["0", "1", "2"], ["1", "2"]]
    for name in names:
        queue.forget(name)
    queue._ask()
    assert len(commands.queries) == 2


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (FileNotFoundError(errno.ENOENT, "No such file"), "the command sbatch is not installed here"),
        (BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"), "sbatch cannot be started: Resource"),
    ],
)
def test_a_command_that_cannot_be_started_is_not_a_refusal(
    monkeypatch: pytest.MonkeyPatch, error: OSError, words: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(subprocess, "run", fail)
    with pytest.raises(SlurmUnavailable, match=words):
        SlurmCommands().submit([], "true")


class SilentQueue(Commands):
    """Commands of a cluster that refuses to show its queue, and then does not answer."""

    def nodes(self) -> list[ClusterNode]:
        """Return one."""
        return [ClusterNode("a", 8, 2**33, 0, "main", True, None)]

    def settings(self) -> ClusterSettings:
        """Return the defaults."""
        return ClusterSettings()

    def own_jobs(self, prefix: str) -> list[QueueEntry]:
        """Refuse."""
        raise SlurmRefused("Invalid user id")

    def kill(self, job_ids: Sequence[str]) -> None:
        """Fail."""
        raise SlurmUnavailable("Unable to contact slurm controller")


def test_a_first_start_says_why_the_queue_is_not_shown(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="it does not say how a job goes: Invalid user id"):
        find_site(SilentQueue(), SlurmOptions(1), tmp_path, runner="tests")
