"""Runs jobs by Slurm: submits them from a login node, follows them in bulk, and supervises them on their nodes.

The directories of jobs are in a folder that the login node and all nodes see. A job is recorded under a name of its own
before it is submitted, and found by that name, so that no answer of Slurm that gets lost submits it twice, and no id
that Slurm uses twice confuses it. Jobs that are ready together are one job array. The ending that a job's supervisor
wrote counts; Slurm's state only where there is none.
"""

import contextlib
import dataclasses
import sys
from collections.abc import Collection, Mapping, Sequence

from kleinkram.contract.runners import MAX_LEASE_S, Capacity, ExecutorAbilities, RunFinish
from kleinkram.contract.runs import EndReason, RunPlacement
from kleinkram.environments.cache import EnvironmentCache, Show
from kleinkram.environments.uv import Wait
from kleinkram.runner.executors.base import UPLOADING, Ending, RunJob, StoredResults, read_finish
from kleinkram.runner.executors.gpus import Gpu
from kleinkram.runner.executors.local import Machine, cannot_start
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.executors.slurm.commands import SlurmRefused, task_name
from kleinkram.runner.executors.slurm.job_endings import JobEndings
from kleinkram.runner.executors.slurm.options import sbatch_options
from kleinkram.runner.executors.slurm.probe import SlurmSite
from kleinkram.runner.executors.slurm.queue_monitor import QueueMonitor
from kleinkram.runner.executors.slurm.shared_files import (
    SUBMISSION,
    Submission,
    read_start,
    read_submission,
    refresh,
    write_lease,
    write_request,
    write_submission,
)
from kleinkram.runner.executors.slurm.states import (
    Phase,
    phase_of,
    waiting_sentence,
)
from kleinkram.runner.executors.slurm.submissions import JobBatches, SubmittedJob, Submitter
from kleinkram.runner.executors.supervision import GRACE_S, boot_time_s
from kleinkram.runner.executors.transfer_steps import finish_file
from kleinkram.runner.images.store import ImageStore
from kleinkram.runner.input_cache import InputCache

_LEASE_S = min(900, MAX_LEASE_S)
_LEASE_EVERY_S = 20.0
_CHECK_UPLOAD_EVERY_S = 0.5
_KILL_AFTER_S = GRACE_S + 2
_REMOVE_S = 20.0
_LOST = Ending(EndReason.lost, "Its job was removed from Slurm.")


class SlurmExecutor(ProcessExecutor):
    """Runs jobs by Slurm. `runner` is the id of the runner: its jobs in Slurm are named after it."""

    def __init__(
        self,
        site: SlurmSite,
        *,
        runner: str = "local",
        machine: Machine | None = None,
        environments: EnvironmentCache | None = None,
        images: ImageStore | None = None,
    ) -> None:
        super().__init__(machine, environments, images)
        self._site = site
        self._options = site.options
        self._is_isolated = self._apptainer is None and site.node.is_isolated
        self._python = site.options.python or sys.executable
        self._prefix = f"klein-{runner.replace('-', '')[:12]}-"
        self._queue = QueueMonitor(site.commands, self._prefix)
        self._submitter = Submitter(site, self._prefix)
        self._endings = JobEndings(site, self._queue, self._submitter)
        self._batches = JobBatches(self._submit_new, site.settings.max_array_size)
        self._jobs: dict[str, SubmittedJob] = {}
        # Jobs of an earlier runner process that were not found yet; None where the others are not to be killed.
        self._not_found: set[str] | None = None

    @property
    def abilities(self) -> ExecutorAbilities:
        """Those of a process on a node."""
        changes = {"executor": "slurm", "gpus": self._site.capacity.gpus > 0}
        return super().abilities.model_copy(update=changes)

    @property
    def capacity(self) -> Capacity:
        """The largest that a node of the partition has; the disk is that of the shared folder."""
        machine = self._machine.capacity if self._machine is not None else self._site.capacity
        return self._site.capacity.model_copy(update={"disk_bytes": machine.disk_bytes})

    @property
    def lease_s(self) -> int:
        """Long: jobs go on while the login node restarts."""
        return _LEASE_S

    @property
    def nodes_enforce_leases(self) -> bool:
        """By their own clocks. A job that starts without news from the runner does nothing, either."""
        return True

    @property
    def node_cache(self) -> InputCache | None:
        """The cache in the shared folder, if the nodes move the files of their jobs."""
        return self._required_machine().cache if self._options.transfers_on_nodes else None

    def free(self, reserved: Capacity, job_count: int) -> Capacity | None:
        """Return what a job may have: Slurm has the queue, whose length is bounded. None while Slurm refuses all."""
        has_room = job_count < self._options.max_jobs and not self._submitter.is_refused
        return self.capacity if has_room else None

    def max_claimed(self, job_count: int) -> int:
        """Return how many jobs may still be submitted."""
        return max(1, self._options.max_jobs - job_count)

    def _assign_gpus(self, job: RunJob, in_use: Collection[str] = ()) -> tuple[Gpu, ...]:
        """Return none: Slurm gives GPUs to jobs, on their nodes."""
        return ()

    def set_lease(self, job: RunJob, until_s: float, *, create: bool = False) -> None:
        """Write how long the job may go on from now; not each time, since hundreds of jobs share a file system."""
        remaining_s = until_s - boot_time_s()
        submitted = self._jobs.get(job.key)
        if submitted is None or create:
            write_lease(job.directory, remaining_s, create=create)
        elif self._is_lease_due(submitted, remaining_s):
            write_lease(job.directory, remaining_s, create=False)
            submitted.leased_start, submitted.leased_s = submitted.start, boot_time_s()

    def submit(self, job: RunJob) -> None:
        """Submit a job, together with others that are submitted now from other threads and need the same.

        Where Slurm does not answer, `poll` submits it again, unless it is in the queue.
        """
        sbatch_options(self._options, job.resources, job.cluster)
        if job.command and job.command[0] == sys.executable:
            job = dataclasses.replace(job, command=[self._python, *job.command[1:]])
        write_request(job.directory, is_cancelled=False, create=True)
        super().submit(job)

    def poll(self, job: RunJob) -> Ending | None:
        """Return the ending that the supervisor wrote, or what Slurm says where it wrote none."""
        try:
            submitted = self._find(job)
        except OSError:  # the shared file system is not available
            return None
        if submitted is None:
            return _LOST
        # Of a job that an earlier runner process submitted.
        self._use_image(job)
        if submitted.ending is None:
            self._update(job, submitted)
            submitted.ending = self._endings.find(job, submitted)
            if submitted.ending is None:
                return None
            submitted.ended_s = boot_time_s()
            submitted.start_read_at_s = 0.0
        if self._options.transfers_on_nodes:  # its job in Slurm goes on
            return submitted.ending
        if self._site.settings.has_accounting and not self._endings.is_accounted(submitted):
            return None
        self._queue.forget(submitted.submission.name)
        return submitted.ending

    def upload_results(self, job: RunJob, plain: RunFinish, wait: Wait, show: Show) -> StoredResults | None:
        """Wait while the node of an ended job uploads its results; None if it did not, or is not to."""
        submitted = self._find(job) if self._options.transfers_on_nodes else None
        if submitted is None:
            return None
        submitted.start = submitted.start or read_start(job.directory)
        while self._is_uploading(job, submitted):
            show(UPLOADING, 1.0)
            wait(_CHECK_UPLOAD_EVERY_S)
        if submitted.start is None:
            return None
        finish = read_finish(job.directory, plain.attempt, submitted.start.token)
        if finish is None:
            return None
        if plain.reason is not EndReason.done:  # Slurm may know more than the node, such as that memory ran out
            finish = finish.model_copy(update={"reason": plain.reason, "message": plain.message})
        return StoredResults(finish, has_log=True)

    def _is_uploading(self, job: RunJob, submitted: SubmittedJob) -> bool:
        """Whether the node of an ended job still uploads its results, or Slurm does not say."""
        snapshot = self._queue.snapshot
        is_known = (
            snapshot.queried_s > max(submitted.submitted_s, submitted.ended_s or 0.0) and self._queue.error is None
        )
        entry = snapshot.entries.get(submitted.submission.name)
        is_running = not is_known or (entry is not None and phase_of(entry.state) is Phase.running)
        refresh(job.directory)
        if is_running and not self._has_uploaded(job, submitted):
            return True
        if self._site.settings.has_accounting and not self._endings.is_accounted(submitted):
            return True
        self._queue.forget(submitted.submission.name)
        return False

    @staticmethod
    def _has_uploaded(job: RunJob, submitted: SubmittedJob) -> bool:
        return submitted.start is not None and finish_file(job.directory, submitted.start.token).exists()

    def reason_waiting(self, job: RunJob) -> str | None:
        """Return why a job is not running yet."""
        try:
            submitted = self._find(job)
        except OSError as error:
            return f"waits for the shared file system: {error.strerror or error}"
        if submitted is None or submitted.ending is not None:
            return None
        self._update(job, submitted)
        if submitted.entry is None:
            problem = submitted.problem or self._queue.error
            return f"waits for Slurm: {problem}" if problem else "waits in the queue of Slurm"
        is_waiting = phase_of(submitted.entry.state) is Phase.waiting
        return waiting_sentence(submitted.entry.reason) if is_waiting else None

    def placement(self, job: RunJob) -> RunPlacement | None:
        """Return the job in Slurm, its node and devices, and what the accounting has."""
        try:
            submitted = self._find(job)
        except OSError:  # the shared file system is not available
            return None
        if submitted is None:
            return None
        self._update(job, submitted)
        entry, start, account = submitted.entry, submitted.start, submitted.account
        queued_s = None
        is_started = entry is not None and phase_of(entry.state) is not Phase.waiting
        if entry is not None and is_started and entry.submitted_s is not None and entry.started_s is not None:
            queued_s = max(0.0, entry.started_s - entry.submitted_s)
        return RunPlacement(
            job_id=submitted.submission.job_id or None,
            node=(start.node if start else None) or (entry.node if entry else None) or None,
            queued_s=queued_s,
            gpus=start.gpus if start else [],
            cpu_s=account.cpu_s if account else None,
            peak_memory_bytes=account.peak_memory_bytes if account else None,
            requeues=start.restarts if start else 0,
        )

    def cancel(self, job: RunJob) -> None:
        """Ask the supervisor on the node to end the job, or have Slurm remove it from its queue."""
        submitted = self._find(job)
        if submitted is None or submitted.ending is not None:
            return
        write_request(job.directory, is_cancelled=True)
        if submitted.cancelled_s is None:
            submitted.cancelled_s = boot_time_s()
        if boot_time_s() - submitted.cancelled_s > _KILL_AFTER_S:
            self._queue.kill(submitted.submission.name)
        self._queue.stop(submitted.submission.name)

    def remove(self, job: RunJob) -> None:
        """Kill the job in Slurm, and wait until it is gone, or Slurm does not answer.

        Should it start later, or go on, it ends itself, since its directory is not its own any more.
        """
        submitted = self._find(job)
        if submitted is None:
            return
        submitted.ending = submitted.ending or self._endings.own_ending(job, submitted)
        (job.directory / SUBMISSION).unlink(missing_ok=True)
        super().remove(job)
        name = submitted.submission.name
        if submitted.ending is None or (self._options.transfers_on_nodes and not self._has_uploaded(job, submitted)):
            self._queue.kill(name)
            self._queue.wait_until_gone(name, _REMOVE_S)
        self._queue.forget(name)
        self._jobs.pop(job.key, None)

    def close(self) -> None:
        """End the thread that asks for the queue."""
        self._queue.close()

    def remove_others(self, known_keys: Collection[str]) -> None:
        """Kill the jobs of this runner that are not known, once the known ones were found and Slurm answers."""
        self._not_found = {*known_keys} - self._jobs.keys()
        self._note_found("")

    def _start_supervisor(self, job: RunJob) -> None:
        self._batches.submit(job, sbatch_options(self._options, job.resources, job.cluster))

    def _submit_new(self, options: Sequence[str], jobs: Sequence[RunJob]) -> Mapping[str, Exception]:
        """Submit jobs for the first time, as a job array where there are several; return what went wrong, by key."""
        name = self._submitter.new_name("array" if len(jobs) > 1 else jobs[0].key)
        names = [task_name(name, number) for number, _ in enumerate(jobs)] if len(jobs) > 1 else [name]
        failures: dict[str, Exception] = {}
        submitted: list[SubmittedJob] = []
        for job, job_name in zip(jobs, names, strict=True):
            submitted.append(SubmittedJob(Submission(job_name), boot_time_s()))
            self._queue.watch(job_name)
            try:
                write_submission(job.directory, submitted[-1].submission)
                self._jobs[job.key] = submitted[-1]
            except OSError as error:  # its task will do nothing
                failures[job.key] = error
                self._queue.forget(job_name)
        try:
            self._submitter.submit(name, options, jobs, submitted)
        except SlurmRefused as error:
            for job, known in zip(jobs, submitted, strict=True):
                (job.directory / SUBMISSION).unlink(missing_ok=True)
                self._queue.forget(known.submission.name)
                self._jobs.pop(job.key, None)
            if len(jobs) == 1:
                return {jobs[0].key: cannot_start(f"Slurm refused its job: {error}.")}
            # Some of them may be accepted.
            for job in jobs:
                if job.key not in failures:
                    failures |= self._submit_new(options, [job])
        return failures

    def _find(self, job: RunJob) -> SubmittedJob | None:
        """Return a submitted job, also that of an earlier runner process; None where it was not, or was removed."""
        known = self._jobs.get(job.key)
        if known is None:
            submission = read_submission(job.directory)
            if submission is None:
                self._note_found(job.key)
                return None
            known = self._jobs.setdefault(job.key, SubmittedJob(submission, boot_time_s()))
            self._queue.watch(submission.name)
        self._note_found(job.key)
        return known

    def _note_found(self, key: str) -> None:
        """Kill the jobs that nobody knows, once all known ones were found."""
        not_found = self._not_found
        if not_found is not None:
            not_found.discard(key)
            if not not_found:
                self._not_found = None
                self._queue.kill_others()

    def _update(self, job: RunJob, submitted: SubmittedJob) -> None:
        """Take over what the queue, and the node, say."""
        entry = self._queue.snapshot.entries.get(submitted.submission.name)
        state = entry.state if entry is not None else None
        if state != submitted.queue_state:
            submitted.queue_state, submitted.read_at_s = state, 0.0
        if entry is not None:
            submitted.entry = entry
            if not submitted.submission.job_id:  # the answer to its submission was lost
                submitted.submission = submitted.submission._replace(job_id=entry.job_id)
                submitted.problem = None
                with contextlib.suppress(OSError):
                    write_submission(job.directory, submitted.submission)
        is_started = submitted.ending is not None or (entry is not None and phase_of(entry.state) is not Phase.waiting)
        if is_started and boot_time_s() >= submitted.start_read_at_s:
            submitted.start_read_at_s = boot_time_s() + (0.2 if submitted.start is None else 2.0)
            with contextlib.suppress(OSError):
                submitted.start = read_start(job.directory) or submitted.start

    @staticmethod
    def _is_lease_due(submitted: SubmittedJob, remaining_s: float) -> bool:
        """Whether a job needs its lease: one that has just started waits for it."""
        entry = submitted.entry
        is_waiting = entry is not None and phase_of(entry.state) is Phase.waiting
        is_known = is_waiting or (submitted.start is not None and submitted.start == submitted.leased_start)
        return not is_known or boot_time_s() - submitted.leased_s > min(_LEASE_EVERY_S, remaining_s / 20)
