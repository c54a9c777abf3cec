"""How jobs of Slurm end, and which are submitted again.

The ending that the supervisor of a job wrote on its node counts; Slurm's state only where there is none, and once it
has lasted for a while.
"""

import json
import logging
import signal

from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import Ending, RunJob
from kleinkram.runner.executors.slurm.commands import QueueEntry, SlurmRefused
from kleinkram.runner.executors.slurm.options import sbatch_options
from kleinkram.runner.executors.slurm.probe import SlurmSite
from kleinkram.runner.executors.slurm.queue_monitor import QueueMonitor
from kleinkram.runner.executors.slurm.shared_files import Submission, read_start, refresh, write_submission
from kleinkram.runner.executors.slurm.states import (
    Phase,
    ending_of,
    is_stuck_after_failure,
    never_starts,
    phase_of,
)
from kleinkram.runner.executors.slurm.submissions import SubmittedJob, Submitter
from kleinkram.runner.executors.supervision import CANCELLED, LEASE_EXPIRED, boot_time_s, ending_file

_log = logging.getLogger("kleinkram.runner")

# Of running jobs, and of waiting ones, which may have started since.
_READ_ENDING_EVERY_S = (0.5, 5.0)
# How long Slurm must show a job as ended, or not at all, before that is believed: one that is about to be started again
# looks ended for moments, and files of a node are seen late.
_SETTLED_S = 6.0
# How long a job may be missing from the queue after the answer to its submission was lost.
_LOST_ANSWER_S = 10.0
# A job that crashes its node each time is not submitted for ever.
_MAX_SUBMISSIONS = 3
# A controller that is killed before it saves its state forgets jobs, which says nothing about them.
_MAX_FORGOTTEN = 10
_MAX_RELEASES = 3
_RELEASE_EVERY_S = 5.0
_NOT_ACCOUNTED_S = 5.0
_KILLED = 128 + signal.SIGKILL


class JobEndings:
    """Decides how jobs ended. It changes what is known of them, each from the thread of its run alone."""

    def __init__(self, site: SlurmSite, queue: QueueMonitor, submitter: Submitter) -> None:
        self._site = site
        self._queue = queue
        self._submitter = submitter

    def find(self, job: RunJob, submitted: SubmittedJob) -> Ending | None:
        """Return how a job ended; None while it goes on, or is submitted again."""
        ending = self.own_ending(job, submitted) or self._judge(job, submitted)
        start = submitted.start
        is_lost = ending is not None and ending.message == LEASE_EXPIRED[1]
        if not is_lost or start is None or submitted.submission.number >= _MAX_SUBMISSIONS:
            return ending
        # Only its node saw the lease expire, as when the file system hung there.
        try:
            ending_file(job.directory, start.token).unlink(missing_ok=True)
        except OSError:
            return None
        return self._submit_again(job, submitted)

    def own_ending(self, job: RunJob, submitted: SubmittedJob) -> Ending | None:
        """Return the ending that the supervisor wrote, if it did."""
        now_s = boot_time_s()
        if now_s < submitted.read_at_s:
            return None
        entry = self._queue.snapshot.entries.get(submitted.submission.name)
        is_waiting = entry is not None and phase_of(entry.state) is Phase.waiting
        submitted.read_at_s = now_s + _READ_ENDING_EVERY_S[is_waiting]
        if submitted.settled_at_s is not None:
            refresh(job.directory)
        try:
            start = read_start(job.directory)
            if start is None:
                return None
            values = json.loads(ending_file(job.directory, start.token).read_text())
        except FileNotFoundError:
            return None
        except (OSError, ValueError):  # the shared file system is not available
            submitted.settled_at_s = None
            return None
        submitted.start = start
        refresh(job.directory / "out")
        ending = Ending(EndReason(values["reason"]), values["message"], values["exit_code"])
        if ending.exit_code == _KILLED and self._is_out_of_memory(submitted):
            return ending_of("OUT_OF_MEMORY", "", "", "")
        return ending

    def is_accounted(self, submitted: SubmittedJob) -> bool:
        """Whether the accounting has an ended job, or has had the time to."""
        if submitted.account is None and submitted.submission.job_id:
            self._queue.wait_until_gone(submitted.submission.name, _NOT_ACCOUNTED_S)
            self._ask_account(submitted)
        waited_s = boot_time_s() - (submitted.ended_s or 0.0)
        return submitted.account is not None or waited_s > _NOT_ACCOUNTED_S

    def _is_out_of_memory(self, submitted: SubmittedJob) -> bool:
        """Whether Slurm's control group killed a process of a job."""
        name = submitted.submission.name
        self._queue.wait_until_gone(name, _SETTLED_S)
        entry = self._queue.snapshot.entries.get(name)
        return entry is not None and entry.state == "OUT_OF_MEMORY"

    def _judge(self, job: RunJob, submitted: SubmittedJob) -> Ending | None:
        """Return how a job ended that wrote no ending, once that is certain; keep its submission going."""
        snapshot = self._queue.snapshot
        if snapshot.queried_s <= submitted.submitted_s or self._queue.error is not None:
            submitted.settled_at_s = None
            return None
        entry = snapshot.entries.get(submitted.submission.name)
        if entry is None and not submitted.submission.job_id:
            if submitted.cancelled_s is not None:
                return Ending.of(CANCELLED)
            is_absent = snapshot.queried_s > submitted.submitted_s + _LOST_ANSWER_S
            return self._submit_again(job, submitted) if is_absent else None
        if entry is not None and phase_of(entry.state) is not Phase.ended:
            submitted.settled_at_s = None
            return self._check_waiting(submitted, entry) if phase_of(entry.state) is Phase.waiting else None
        if submitted.cancelled_s is not None:
            return Ending.of(CANCELLED)
        if submitted.settled_at_s is None:
            submitted.settled_at_s = boot_time_s() + _SETTLED_S
            self._ask_account(submitted)
        if snapshot.queried_s < submitted.settled_at_s:
            return None
        submitted.read_at_s = 0.0
        if (ending := self.own_ending(job, submitted)) is not None or submitted.settled_at_s is None:
            return ending
        return self._end_or_submit_again(job, submitted, entry)

    def _end_or_submit_again(self, job: RunJob, submitted: SubmittedJob, entry: QueueEntry | None) -> Ending | None:
        ending, submission = self._ending_by_state(submitted, entry), submitted.submission
        if ending is None:
            if submission.forgotten + 1 < _MAX_FORGOTTEN:
                return self._submit_again(job, submitted, is_forgotten=True)
            return Ending(EndReason.lost, f"Slurm forgot its job {_MAX_FORGOTTEN} times: {submission.job_id} was last.")
        if ending.reason is EndReason.lost and submission.number < _MAX_SUBMISSIONS:
            return self._submit_again(job, submitted)
        return ending

    def _ending_by_state(self, submitted: SubmittedJob, entry: QueueEntry | None) -> Ending | None:
        """Return the ending that Slurm shows; None if it forgot the job."""
        job_id = submitted.submission.job_id
        node = submitted.start.node if submitted.start is not None else ""
        if entry is not None:
            return ending_of(entry.state, entry.reason, job_id, entry.node or node)
        self._ask_account(submitted)
        if submitted.account is not None:
            return ending_of(submitted.account.state, "None", job_id, node)
        return None

    def _submit_again(self, job: RunJob, submitted: SubmittedJob, *, is_forgotten: bool = False) -> Ending | None:
        """Submit a job again under a new name. The first, should it still start or go on, notices that and ends."""
        previous = submitted.submission
        name = self._submitter.new_name(job.key)
        submission = Submission(name, number=previous.number, forgotten=previous.forgotten)
        if is_forgotten:
            submission = submission._replace(forgotten=previous.forgotten + 1)
        elif previous.job_id:  # one that Slurm did not get does not count
            submission = submission._replace(number=previous.number + 1)
        try:
            write_submission(job.directory, submission)
        except OSError:  # the shared file system is not available
            return None
        why = "Slurm forgot it" if is_forgotten else "it was lost" if previous.job_id else "Slurm did not get it"
        _log.warning("the job %s (%s) is submitted again: %s", previous.job_id or previous.name, job.key, why)
        self._queue.forget(previous.name)
        submitted.submission = submission
        submitted.settled_at_s, submitted.entry, submitted.start, submitted.account = None, None, None, None
        self._queue.watch(name)
        try:
            options = sbatch_options(self._site.options, job.resources, job.cluster)
            self._submitter.submit(name, options, [job], [submitted])
        except SlurmRefused as error:
            return Ending(EndReason.not_possible, f"Slurm refused its job: {error}.")
        return None

    def _check_waiting(self, submitted: SubmittedJob, entry: QueueEntry) -> Ending | None:
        """End a job that can never start, and have one start that Slurm holds because a node failed to start it."""
        now_s = boot_time_s()
        if is_stuck_after_failure(entry.reason):
            if submitted.releases >= _MAX_RELEASES:
                self._queue.kill(entry.name)
                return Ending(
                    EndReason.lost, f"Slurm failed to start its job {entry.job_id} {_MAX_RELEASES + 1} times."
                )
            if now_s >= submitted.released_s + _RELEASE_EVERY_S:
                submitted.releases, submitted.released_s = submitted.releases + 1, now_s
                self._queue.release(entry.name)
            return None
        ending = never_starts(entry.reason)
        if ending is None:
            submitted.stuck_since_s = None
            return None
        if submitted.stuck_since_s is None:
            submitted.stuck_since_s = now_s
        if now_s - submitted.stuck_since_s < _SETTLED_S:
            return None
        self._queue.kill(entry.name)
        return ending

    def _ask_account(self, submitted: SubmittedJob) -> None:
        """Take over what the accounting has about a job, or have it asked."""
        job_id = submitted.submission.job_id
        if self._site.settings.has_accounting and job_id and submitted.account is None:
            submitted.account = self._queue.account(submitted.submission.name, job_id)
