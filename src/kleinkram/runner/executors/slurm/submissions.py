"""Submissions of jobs: those that become ready within a moment and need the same are one job array."""

import contextlib
import math
import shlex
import sys
import threading
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from kleinkram.runner.executors.base import Ending, RunJob
from kleinkram.runner.executors.slurm import node_job
from kleinkram.runner.executors.slurm.commands import (
    JobAccount,
    QueueEntry,
    SlurmRefused,
    SlurmUnavailable,
    task_name,
)
from kleinkram.runner.executors.slurm.options import array_option, minimal_options
from kleinkram.runner.executors.slurm.probe import SlurmSite
from kleinkram.runner.executors.slurm.shared_files import NodeStart, Submission, write_submission
from kleinkram.runner.executors.supervision import boot_time_s

# A batch is submitted once no job was added for the first time, or after the second.
_QUIET_S = 0.3
_MAX_WAIT_S = 3.0
# How long no run is claimed after Slurm has refused any job.
_REFUSED_S = 60.0
# How often it is asked then, by one of the jobs for all.
_ASK_AGAIN_S = 10.0

SubmitAll = Callable[[Sequence[str], Sequence[RunJob]], Mapping[str, Exception]]
"""Submits jobs with these options, and returns what went wrong, by their keys."""


@dataclass
class SubmittedJob:
    """What this process knows of a job that was submitted by it, or by an earlier one."""

    submission: Submission
    submitted_s: float
    problem: str | None = None
    cancelled_s: float | None = None
    settled_at_s: float | None = None
    stuck_since_s: float | None = None
    read_at_s: float = 0.0
    start_read_at_s: float = 0.0
    releases: int = 0
    released_s: float = 0.0
    # Its state in the last answer, None where it was not in it; and the last that was known.
    queue_state: str | None = None
    entry: QueueEntry | None = None
    start: NodeStart | None = None
    # The start that got the lease last, and when.
    leased_start: NodeStart | None = None
    leased_s: float = 0.0
    ending: Ending | None = None
    ended_s: float | None = None
    account: JobAccount | None = None


class JobBatches:
    """Batches of jobs with equal options. Thread-safe: each job is submitted from a thread of its own."""

    def __init__(self, submit_all: SubmitAll, max_size: int) -> None:
        self._submit_all = submit_all
        self._max_size = max_size
        self._open: dict[tuple[str, ...], _Batch] = {}
        self._changed = threading.Condition()

    def submit(self, job: RunJob, options: Sequence[str]) -> None:
        """Submit a job together with others, and return once that is done; raise what went wrong with this one."""
        key = tuple(options)
        with self._changed:
            batch = self._open.get(key)
            is_first = batch is None
            if batch is None:
                batch = self._open[key] = _Batch()
            batch.jobs.append(job)
            batch.changed_s = time.monotonic()
            if len(batch.jobs) >= self._max_size:
                del self._open[key]
            self._changed.notify_all()
        if is_first:
            self._complete(batch, key)
        batch.is_submitted.wait()
        if (failure := batch.failures.get(job.key)) is not None:
            raise failure

    def _complete(self, batch: "_Batch", key: tuple[str, ...]) -> None:
        """Wait for further jobs, and submit all."""
        until_s = time.monotonic() + _MAX_WAIT_S
        with self._changed:
            while self._open.get(key) is batch:
                remaining_s = min(batch.changed_s + _QUIET_S, until_s) - time.monotonic()
                if remaining_s <= 0:
                    del self._open[key]
                else:
                    self._changed.wait(remaining_s)
        try:
            batch.failures = self._submit_all(key, batch.jobs)
        except BaseException as error:
            failure = error if isinstance(error, Exception) else RuntimeError("the submission was interrupted")
            batch.failures = dict.fromkeys((job.key for job in batch.jobs), failure)
            raise
        finally:
            batch.is_submitted.set()


class _Batch:
    """Jobs of one submission."""

    def __init__(self) -> None:
        self.jobs: list[RunJob] = []
        self.changed_s = 0.0
        self.failures: Mapping[str, Exception] = {}
        self.is_submitted = threading.Event()


class Submitter:
    """Submits jobs that are recorded, under names that begin with a prefix."""

    def __init__(self, site: SlurmSite, prefix: str) -> None:
        self._site = site
        self._prefix = prefix
        # When and why Slurm refused any job last.
        self._refused_s, self._refusal = -math.inf, ""

    def new_name(self, what: str) -> str:
        """Return a name that no job has."""
        return f"{self._prefix}{what}-{uuid.uuid4().hex[:8]}"

    def submit(
        self, name: str, options: Sequence[str], jobs: Sequence[RunJob], submitted: Sequence[SubmittedJob]
    ) -> None:
        """Submit jobs, several as a job array of this name, and record their ids if Slurm answers.

        Raises:
            SlurmRefused: none was submitted, and others would be.
        """
        own = [f"--job-name={name}", "--output=/dev/null", "--chdir=/", "--requeue"]
        array = [array_option(self._site.options, len(jobs))] if len(jobs) > 1 else []
        job_id, problem = self._try_to_submit([*own, *array, *options], self._script(jobs))
        for number, (job, known) in enumerate(zip(jobs, submitted, strict=True)):
            known.problem, known.submitted_s = problem, boot_time_s()
            if job_id:
                known.submission = known.submission._replace(job_id=task_name(job_id, number) if array else job_id)
                with contextlib.suppress(OSError):  # it is found by its name, too
                    write_submission(job.directory, known.submission)

    def _try_to_submit(self, options: Sequence[str], script: str) -> tuple[str, str | None]:
        """Return the id of a job, or an empty one and why it has to be submitted again. Raises SlurmRefused."""
        commands = self._site.commands
        if boot_time_s() - self._refused_s < _ASK_AGAIN_S:
            return "", self._refusal
        try:
            job_id = commands.submit(options, script)
        except SlurmUnavailable as error:
            return "", str(error)
        except SlurmRefused as error:
            try:
                # As in a partition that is drained, it may refuse any job of this runner: they wait.
                commands.check(minimal_options(self._site.options))
            except SlurmUnavailable:
                return "", str(error)
            except SlurmRefused:
                self._refused_s, self._refusal = boot_time_s(), str(error)
                return "", self._refusal
            raise
        self._refused_s = -math.inf
        return job_id, None

    @property
    def is_refused(self) -> bool:
        """Whether Slurm refused any job of this runner a moment ago."""
        return boot_time_s() - self._refused_s < _REFUSED_S

    def _script(self, jobs: Sequence[RunJob]) -> str:
        """Return the script of jobs, of which each chooses its own directory."""
        supervisor = shlex.join([self._site.options.python or sys.executable, "-I", "-m", node_job.__name__])
        return (
            f"set -- {shlex.join(str(job.directory) for job in jobs)}\n"
            'shift "${SLURM_ARRAY_TASK_ID:-0}"\n'
            'cd "$1" || exit\n'
            f'exec {supervisor} "$1" >>slurm.log 2>&1'
        )
