"""One run from its assignment to its end, in its own thread.

Each step is recorded before it is done, and may be repeated: after a kill the next runner continues where this one was.
"""

import contextlib
import errno
import logging
import math
import threading
import time
from collections.abc import Callable

from kleinkram import traces
from kleinkram.client._http import Backoff
from kleinkram.contract.errors import RunGone
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.reports import Progress
from kleinkram.contract.runners import Heartbeat, HeartbeatReply, LeaseStatus, RunAssignment, RunFinish
from kleinkram.contract.runs import EndReason, RunState, UsageSample
from kleinkram.json_logs import log_fields
from kleinkram.runner.executors.base import CannotStart, Ending, RunJob, wait_for_end
from kleinkram.runner.executors.supervision import CANCELLED, boot_time_s
from kleinkram.runner.inputs import job_of, prepare_run
from kleinkram.runner.logs import LogUpload, Redactor
from kleinkram.runner.node_transfers import TransferStatus, order_transfers, read_status
from kleinkram.runner.result_upload import JobOutput, ResultUpload
from kleinkram.runner.results import ProgressReader
from kleinkram.runner.state_directory import (
    Attempt,
    Lease,
    RunnerContext,
    StopRequest,
    StopRequested,
    StopSignal,
    remove_tree,
)

_log = logging.getLogger("kleinkram.runner")
# Errors of a full disk or an exceeded quota.
_DISK_FULL_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT})
_CHECK_EVERY_S = 0.5
_SAMPLE_EVERY_S = 5.0
_MAX_SAMPLES = 100
# A run that crashes its machine each time is not started for ever.
_MAX_STARTS = 3
_CANCEL_EVERY_S = 1.0
# How long to try again after errors: with results, by when an administrator has seen them; before, after those of a
# file system that may come back, and after others.
_KEEP_RESULTS_S = 7 * 86400.0
_STORAGE_RETRY_S = 86400.0
_ERROR_RETRY_S = 300.0
_LASTING_ERRORS = frozenset({errno.ENOENT, errno.ENOTDIR})
_FORGET_FAILURES_S = 600.0
_MAX_MESSAGE = 200


class ActiveRun:
    """A run that this runner has. Thread-safe, except for `start`.

    `is_new`: this process received the assignment; otherwise the run is an earlier runner's, and nothing of it is
    started before the server has confirmed its lease.
    """

    def __init__(
        self,
        context: RunnerContext,
        attempt: Attempt,
        lease: Lease,
        *,
        is_new: bool,
        on_end: Callable[["ActiveRun"], None],
    ) -> None:
        self.stop = StopSignal()
        self.lease = lease
        self._context = context
        self._executor = context.executor
        self._attempt = attempt
        self._on_end = on_end
        self._state = attempt.state.stage
        self._is_confirmed = threading.Event()
        if is_new:
            self._is_confirmed.set()
        self._is_submitted = attempt.state.stage is RunState.running
        # How its job ended, from when that is known until it is recorded.
        self._ending: Ending | None = None
        self._retry: Backoff | None = None
        self._failed_s = -math.inf
        self._samples: list[UsageSample] = []
        self._usage = attempt.state.usage
        self._placement = attempt.state.placement
        self._progress = ProgressReader(attempt.directory / "out")
        assignment = attempt.state.assignment
        self._redactor = Redactor([token for token in (context.token, assignment.token) if token])
        self._log = LogUpload(context, attempt, self._redactor)
        self._preparation: Progress | None = None
        packages = attempt.state.packages
        self._environment = self._executor.find_environment(packages) if packages is not None else None
        self._cancelled_at_s = -math.inf
        self._is_cancel_failing = False
        self._are_inputs_counted = False
        self._transfers: TransferStatus | None = None
        self._upload: ResultUpload | None = None
        self._thread = threading.Thread(target=self._run, name=f"run {attempt.key[:8]}", daemon=True)

    @property
    def assignment(self) -> RunAssignment:
        """The assignment from the server."""
        return self._attempt.state.assignment

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the thread."""
        self._thread.join(timeout_s)

    def heartbeat(self) -> Heartbeat:
        """Return the next heartbeat."""
        return Heartbeat(
            run_id=self.assignment.run_id,
            attempt=self.assignment.attempt,
            state=self._state,
            progress=self._upload.progress if self._upload else self._preparation or self._progress.progress,
            image_digest=self._attempt.state.image_digest,
            placement=self._placement,
            usage=self._usage,
            samples=self._samples[:_MAX_SAMPLES],
        )

    def on_reply(self, heartbeat: Heartbeat, reply: HeartbeatReply, *, requested_s: float, lease_s: float) -> None:
        """Process the reply to a heartbeat that was sent at `requested_s`."""
        if reply.status is LeaseStatus.lost:
            self.stop.send(StopRequest.abandon)
            return
        self.lease.renew(requested_s, lease_s)
        # A job that has not been submitted, or has ended, has none; should the disk be broken, the job ends early.
        with contextlib.suppress(OSError):
            self._executor.set_lease(self._job(), self.lease.until_s)
        del self._samples[: len(heartbeat.samples)]
        self._is_confirmed.set()
        if reply.status is LeaseStatus.cancel:
            self.stop.send(StopRequest.cancel)

    def enforce(self) -> None:
        """Enforce the lease and pending stop requests; called regularly."""
        if self._state is not RunState.collecting and self.lease.is_over():
            if self.stop.request is not StopRequest.abandon:
                _log.warning("the run %s is stopped: its lease could not be renewed", self.assignment.run_id)
            self.stop.send(StopRequest.abandon)
        if not self.stop.is_pending():
            return
        if self._upload is not None:
            self._upload.interrupt()
            return
        is_due = boot_time_s() - self._cancelled_at_s > _CANCEL_EVERY_S
        if self.stop.request is not StopRequest.detach and self._is_submitted and is_due:
            self._cancelled_at_s = boot_time_s()
            try:
                self._executor.cancel(self._job())
                self._is_cancel_failing = False
            except OSError as error:
                if not self._is_cancel_failing:
                    _log.warning("the run %s cannot be stopped yet; trying again: %s", self.assignment.run_id, error)
                self._is_cancel_failing = True

    def kill(self) -> None:
        """Kill the job, once the thread has ended; the next runner starts the run again."""
        self._executor.remove(self._job())

    def _job(self) -> RunJob:
        return job_of(self._context, self._attempt)

    def _run(self) -> None:
        assignment = self.assignment
        attributes: traces.Attributes = {
            "kleinkram.run_id": str(assignment.run_id),
            "kleinkram.attempt": assignment.attempt,
            "kleinkram.action": assignment.action.name,
            "kleinkram.mission_id": str(assignment.mission_id),
        }
        parent = assignment.traceparent
        with (
            log_fields(run_id=str(assignment.run_id), attempt=assignment.attempt),
            traces.span("run", attributes, kind=traces.Kind.consumer, parent=parent) as span,
        ):
            self._run_to_end()
            if self._attempt.state.ending is not None:
                span.set({"kleinkram.reason": self._attempt.state.ending.reason.value})

    def _run_to_end(self) -> None:
        is_detached = False
        try:
            while not self._is_completed():
                pass
        except StopRequested as stopped:
            is_detached = stopped.request is StopRequest.detach
            if not is_detached:
                _log.info("the run %s is not this runner's any more", self.assignment.run_id)
                self._context.statistics.count_end(None)
        except RunGone:
            _log.info("the run %s is not this runner's any more", self.assignment.run_id)
            self._context.statistics.count_end(None)
        except Exception:
            # Not even the end could be reported. The server returns the run with the next claim, as a new attempt.
            self._context.statistics.count_end(None)
            _log.exception("the run %s is given up", self.assignment.run_id)
        finally:
            self._log.close()
            if is_detached:
                self._release_environment()
            else:
                try:
                    self._executor.remove(self._job())
                    self._release_environment()
                    remove_tree(self._attempt.directory)
                except Exception as error:
                    _log.warning("the folder of the run %s was not removed: %s", self.assignment.run_id, error)
                finally:
                    self._on_end(self)

    def _is_completed(self) -> bool:
        """Take the steps that are not recorded as done; return whether the end of the run is reported.

        After an error of the file system or of this program, they are to be taken again, as after a kill: the job goes
        on meanwhile, and its results stay.
        """
        try:
            self._take_steps()
        except (StopRequested, RunGone):
            raise
        except Exception as error:
            if isinstance(error, OSError) and error.errno in _DISK_FULL_ERRORS:
                _log.error("the run %s is ended, as the disk is full: %s", self.assignment.run_id, error)
                self._report_without_results(ResultUpload.without_disk_space)
                return True
            if self._wait_after(error):
                return False
            _log.exception("the run %s is ended, as its runner cannot complete it", self.assignment.run_id)
            ending = Ending(
                EndReason.lost, f"Its runner could not complete it, and tried for long: {_reason_of(error)}."
            )
            self._report_without_results(lambda upload: upload.plain(ending))
        return True

    def _take_steps(self) -> None:
        if self._attempt.state.stage is not RunState.collecting:
            self._ending = self._ending or self._run_job()
            self._attempt.change(
                stage=RunState.collecting, ending=self._ending, usage=self._usage, placement=self._placement
            )
            self._retry = None
        with traces.span("upload results"):
            self._upload_results()

    def _wait_after(self, error: Exception) -> bool:
        """Wait after an unexpected error; return whether to try again. Where a person cancels the run, do not."""
        now_s = boot_time_s()
        if self._retry is None or now_s - self._failed_s > _FORGET_FAILURES_S:
            self._retry = Backoff(self._patience_s(error), self.stop.wait)
            _log.warning("the run %s is tried again after an error", self.assignment.run_id, exc_info=error)
        self._failed_s = now_s
        self._upload = None
        message = f"an error of its runner, which tries again: {_reason_of(error)}"
        self._preparation = Progress(fraction=0, message=message[:_MAX_MESSAGE])
        self._context.on_change()
        try:
            return self._retry.pause()
        except StopRequested as stopped:
            if stopped.request is not StopRequest.cancel:
                raise
            return False

    def _patience_s(self, error: Exception) -> float:
        if self._attempt.state.stage is RunState.collecting:
            return _KEEP_RESULTS_S
        is_of_storage = isinstance(error, OSError) and error.errno not in _LASTING_ERRORS
        return _STORAGE_RETRY_S if is_of_storage else _ERROR_RETRY_S

    def _run_job(self) -> Ending:
        # True of a job that was submitted by an earlier runner or before an error, and of one that was about to be.
        self._is_submitted = self._attempt.state.stage is RunState.running
        try:
            if self._is_submitted and not self._executor.was_submitted(self._job(), self.stop.wait):
                self._attempt.change(starts=max(0, self._attempt.state.starts - 1))
                self._is_submitted = False
            if self._is_submitted:
                ending = self._executor.poll(self._job())
                is_lost = ending is not None and ending.reason is EndReason.lost
                if is_lost and self._attempt.state.starts < _MAX_STARTS:
                    self._is_submitted = False
                elif ending is not None:
                    return ending
            if not self._is_submitted:
                with traces.span("prepare"):
                    self._prepare_and_submit()
            with traces.span("execute"):
                return self._watch()
        except CannotStart as error:
            # Whatever was starting may have been killed for a stop request.
            self._check_stop()
            return error.ending
        except StopRequested as stopped:
            if stopped.request is not StopRequest.cancel:
                raise
            self.stop.acknowledge()
            return Ending.of(CANCELLED)

    def _prepare_and_submit(self) -> None:
        while not self._is_confirmed.is_set():
            self.stop.wait(0.05)
        self._set_state(RunState.preparing)
        self._attempt.change(stage=RunState.preparing)
        self._executor.remove(self._job())
        self._attempt.clear()
        self._release_environment()
        directory = self._attempt.directory / "in"
        prepared = prepare_run(self._context, self.assignment, self.stop, directory, self._show_preparation)
        self._order_transfers()
        self._environment = prepared.environment
        self._attempt.change(
            stage=RunState.running,
            starts=self._attempt.state.starts + 1,
            started_s=boot_time_s(),
            image=prepared.image.reference if prepared.image else None,
            image_digest=prepared.image.digest if prepared.image else None,
            store_url=prepared.store_url,
            packages=prepared.environment.packages if prepared.environment else None,
        )
        self.stop.check()
        if self.lease.is_over():
            raise StopRequested(StopRequest.abandon)
        job = self._job()
        self._executor.set_lease(job, self.lease.until_s, create=True)
        try:
            self._executor.submit(job)
        except OSError:  # it was not started, or is removed before the next try
            self._attempt.change(stage=RunState.preparing, starts=self._attempt.state.starts - 1)
            raise
        self._is_submitted = True
        self._attempt.change(started_s=boot_time_s())

    def _order_transfers(self) -> None:
        """Where compute nodes move the files of jobs, tell that of this one how."""
        cache, token_file = self._executor.node_cache, self._context.token_file
        if cache is not None and token_file is not None:
            copy_inputs = self._executor.abilities.isolation is Isolation.none
            order_transfers(self._attempt.directory, self._context.url, token_file, cache, copy_inputs=copy_inputs)

    def _show_preparation(self, message: str, fraction: float) -> None:
        is_new = self._preparation is None
        self._preparation = Progress(fraction=round(fraction, 2), message=message)
        if is_new:
            self._context.on_change()

    def _release_environment(self) -> None:
        if self._environment is not None:
            self._environment.close()
        self._environment = None

    def _watch(self) -> Ending:
        job = self._job()
        self._wait_for_start(job)
        self._preparation = None
        self._placement = self._executor.placement(job) or self._placement
        self._set_state(RunState.running)
        self._log.start(job)
        sampled_s = -math.inf
        while (ending := wait_for_end(self._executor, job, _CHECK_EVERY_S)) is None:
            self._check_stop()
            self._progress.read()
            if boot_time_s() - sampled_s >= _SAMPLE_EVERY_S:
                sampled_s = boot_time_s()
                self._show_waiting(self._reason_waiting(job))
                self._add_sample()
        self._check_stop()
        if ending.reason is EndReason.lost and self.lease.is_over():  # its supervisor noticed before `enforce` did
            raise StopRequested(StopRequest.abandon)
        self._add_sample()
        self._progress.read()
        if self.stop.request is StopRequest.cancel:
            self.stop.acknowledge()
            return Ending.of(CANCELLED, ending.exit_code)
        return ending

    def _reason_waiting(self, job: RunJob) -> str | None:
        """Return why a job has not started: its cluster has not started it, or its node downloads its inputs."""
        if (reason := self._executor.reason_waiting(job)) is not None:
            return reason
        with contextlib.suppress(OSError):  # the shared file system is not available
            self._transfers = read_status(self._attempt.directory)
        status = self._transfers
        if status is not None and status.is_over and not self._are_inputs_counted:
            self._are_inputs_counted = True
            self._context.statistics.count_inputs("store", status.store_bytes)
            self._context.statistics.count_inputs("cache", status.cache_bytes)
        return None if status is None or status.is_over else status.message

    def _wait_for_start(self, job: RunJob) -> None:
        """Show why a job waits, until it starts or ends."""
        while (reason := self._reason_waiting(job)) is not None and self._executor.poll(job) is None:
            self._check_stop()
            self._placement = self._executor.placement(job)
            self._show_waiting(reason)
            time.sleep(_CHECK_EVERY_S)

    def _show_waiting(self, reason: str | None) -> None:
        """Show why a job waits, for the first time or once more: a cluster may start it again."""
        shown = Progress(fraction=0, message=reason[:_MAX_MESSAGE]) if reason is not None else None
        if shown != self._preparation:
            self._preparation = shown
            self._context.on_change()

    def _check_stop(self) -> None:
        """Raise on a stop request; a cancelled job ends by itself."""
        if self.stop.request is not StopRequest.cancel:
            self.stop.check()

    def _add_sample(self) -> None:
        self._placement = self._executor.placement(self._job()) or self._placement
        usage = self._executor.usage(self._job())
        if usage is not None:
            self._usage = usage
            if len(self._samples) < _MAX_SAMPLES:
                at_s = max(0.0, boot_time_s() - self._attempt.state.started_s)
                self._samples.append(UsageSample(at_s=round(at_s, 3), usage=usage))

    def _upload_results(self) -> None:
        self._set_state(RunState.collecting)
        self._log.finish()
        ending = self._attempt.state.ending or Ending(EndReason.lost, "How it ended was not recorded.")
        self._upload = upload = self._result_upload()
        try:
            self._report(upload, self._stored_results(upload, ending) or upload.upload(ending))
        except StopRequested as stopped:
            if stopped.request is not StopRequest.cancel:
                raise
            self.stop.acknowledge()
            with contextlib.suppress(OSError):  # it is removed again in the end
                self._executor.remove(self._job())
            self._report(upload, upload.without_results(Ending.of(CANCELLED, ending.exit_code)))

    def _stored_results(self, upload: ResultUpload, ending: Ending) -> RunFinish | None:
        """Return what to report once the results are uploaded where the job ran; None if this runner is to do so."""
        job = self._job()

        def show(message: str, _fraction: float) -> None:
            upload.progress = Progress(fraction=1, message=message)

        stored = self._executor.upload_results(job, upload.plain(ending), self.stop.wait, show)
        self._placement = self._executor.placement(job) or self._placement
        if stored is None or stored.has_log:
            return stored and stored.finish
        return upload.with_log(stored.finish)

    def _result_upload(self) -> ResultUpload:
        job = self._job()
        return ResultUpload(
            self._context.runners,
            self._context.url,
            JobOutput(
                job.directory,
                lambda: self._executor.collect(job),
                lambda offset, size_bytes: self._executor.read_log(job, offset, size_bytes),
            ),
            self.assignment,
            stop=self.stop,
            redactor=self._redactor,
            progress=self._progress.progress,
        )

    def _report_without_results(self, finish_of: Callable[[ResultUpload], RunFinish]) -> None:
        """Report the end of a run that cannot be completed: given up, it would be started again, and meet the same."""
        is_cancelled = self.stop.request is StopRequest.cancel
        if is_cancelled:
            self.stop.acknowledge()
        self.stop.check()
        with contextlib.suppress(OSError):  # it is removed again in the end
            self._executor.remove(self._job())
        self._set_state(RunState.collecting)
        self._upload = upload = self._result_upload()
        self._report(upload, upload.plain(Ending.of(CANCELLED)) if is_cancelled else finish_of(upload))

    def _report(self, upload: ResultUpload, finish: RunFinish) -> None:
        # With what further heartbeats would have reported.
        digest = self._attempt.state.image_digest
        changes = {
            "placement": self._placement,
            "usage": self._usage,
            "samples": self._samples[:_MAX_SAMPLES],
            "image_digest": digest,
        }
        upload.report(finish.model_copy(update=changes), self._context.requests)
        self._context.statistics.count_end(finish.reason)

    def _set_state(self, state: RunState) -> None:
        self._state = state
        self._context.on_change()


def _reason_of(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or f"{type(error).__name__} (see its log)"
