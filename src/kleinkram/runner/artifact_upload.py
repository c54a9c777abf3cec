"""Collects and uploads the results of a run, and reports its end to the server."""

import datetime
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

from kleinkram.client._http import Backoff
from kleinkram.client.errors import ServerUnreachable, StoreTroubled, StoreUnreachable
from kleinkram.client.transfer.plan import LocalFile, identity_of
from kleinkram.client.transfer.pool import RateLimit
from kleinkram.client.transfer.report import TransferResult, Watcher
from kleinkram.client.transfer.upload import Uploader
from kleinkram.contract.errors import (
    BodyTooLarge,
    DatabaseUnavailable,
    InvalidRequest,
    KleinkramError,
    RunGone,
    StoreUnavailable,
)
from kleinkram.contract.reports import Progress, Report
from kleinkram.contract.runners import LOG_PATH, RunAssignment, RunFinish
from kleinkram.contract.runs import EndReason
from kleinkram.runner.context import RunnerContext, StopSignal
from kleinkram.runner.executors.base import Ending, RunJob
from kleinkram.runner.executors.limits import DISK_FULL
from kleinkram.runner.logs import Redactor, write_redacted_log
from kleinkram.runner.results import collect_results

_REDACTED_LOG = "log.redacted"
_JOURNALS = "journals"
_CONNECTIONS = 4
_MAX_CHARACTERS = 2000
_MAX_PROBLEMS = 200
_MAX_PROGRESS_CHARACTERS = 200
_ROUNDS = 5
_RETRY_EVERY_S = 2.0
# Results stay on the runner while the store or the server is unavailable. After a quarter of an hour without the server
# another runner may get the run first.
_UNAVAILABLE_S = 7 * 86400.0
_UNAVAILABLE_ERRORS = (ServerUnreachable, StoreUnreachable, StoreUnavailable, DatabaseUnavailable)
_SERVER_ERROR_S = 600.0

_log = logging.getLogger("kleinkram.runner")


@dataclass(frozen=True)
class RejectedFile:
    """A file that was not stored. `is_temporary`: the store or the server is unavailable."""

    path: str
    reason: str
    is_temporary: bool = False


class ResultUpload:
    """Uploads the results of one run, whose job has ended. May be repeated from the start."""

    def __init__(
        self,
        context: RunnerContext,
        job: RunJob,
        assignment: RunAssignment,
        *,
        stop: StopSignal,
        redactor: Redactor,
        progress: Progress | None,
    ) -> None:
        self._context = context
        self._job = job
        self._assignment = assignment
        self._stop = stop
        self._redactor = redactor
        self._uploader: Uploader | None = None
        # Shown meanwhile: the last progress, and what the results wait for.
        self.progress = progress and Progress(fraction=progress.fraction)

    def interrupt(self) -> None:
        """Have `upload` return soon; from another thread."""
        if self._uploader is not None:
            self._uploader.end()

    def upload(self, ending: Ending) -> RunFinish:
        """Upload the artifacts and the log, and return what to report.

        Raises:
            StopRequested: the run is to stop.
            RunGone: it is not this runner's.
        """
        out = self._context.executor.collect(self._job)
        results = collect_results(out)
        problems = [*results.problems]
        if results.report_error is not None:
            problems.append(results.report_error)
            if ending.reason is EndReason.done:
                ending = Ending(EndReason.broken_report, results.report_error, ending.exit_code)
        if ending.reason is EndReason.cancelled and results.artifacts:
            problems.append(f"It was cancelled: its {len(results.artifacts)} files were not stored.")
            results.artifacts.clear()
        files: list[LocalFile] = []
        rejected: list[RejectedFile] = []
        log = self._job.directory / _REDACTED_LOG
        if write_redacted_log(self._context.executor, self._job, self._redactor, log):
            files.append(LocalFile(log, LOG_PATH, identity_of(log.stat())))
        for artifact in results.artifacts:
            source = out / artifact.path
            try:
                files.append(LocalFile(source, artifact.path, identity_of(source.lstat())))
            except FileNotFoundError:  # in NFC the name may be another one, of which there is no file
                rejected.append(RejectedFile(artifact.path, "its name is not in the form NFC"))
        rejected += self._upload(files) if files else []
        for file in rejected:
            name = "Its log" if file.path == LOG_PATH else file.path
            problems.append(f"{name} was not stored: {file.reason}")
        if ending.reason is EndReason.done and any(file.path != LOG_PATH for file in rejected):
            ending = Ending(EndReason.results_not_stored, problems[-1], ending.exit_code)
        return self._finish_of(ending, results.report, problems)

    def without_results(self, ending: Ending) -> RunFinish:
        """Return what to report of a run that was cancelled while its results were uploaded."""
        problem = "It was cancelled while its results were uploaded: none were stored."
        return self._finish_of(ending, Report(), [problem])

    def without_disk_space(self) -> RunFinish:
        """Return what to report of a run that cannot be completed because the disk is full."""
        problem = "Its results were not stored, or not all of them: the disk of its runner is full."
        return self._finish_of(Ending.of(DISK_FULL), Report(), [problem])

    def report(self, finish: RunFinish) -> None:
        """Report the end to the server, for as long as that takes.

        Raises:
            StopRequested: the run is to stop.
            RunGone: it is not this runner's.
            KleinkramError: the server does not accept it.
        """
        backoff = Backoff(_SERVER_ERROR_S, self._stop.wait)
        run_id = self._assignment.run_id
        while True:
            try:
                self._context.runners.with_retry(math.inf, self._stop.wait).finish(run_id, finish)
                return
            except RunGone:  # noqa: PERF203  (each round is a request)
                raise
            except (InvalidRequest, BodyTooLarge) as error:
                problem = _shortened(f"The server did not accept its report: {error}")
                if finish.problems == [problem]:
                    raise
                finish = finish.model_copy(update={"report": Report(), "problems": [problem], "samples": []})
            except KleinkramError as error:
                _log.warning("reporting the end of the run %s is repeated: %s", run_id, error)
                if not backoff.pause():
                    raise

    def _upload(self, files: Sequence[LocalFile]) -> list[RejectedFile]:
        """Upload files, and repeat rejected ones: afterwards the directory of the run is removed."""
        rounds, unavailable = 0, Backoff(_UNAVAILABLE_S, self._stop.wait)
        while True:
            self._stop.check()
            try:
                rejected = self._upload_once(files)
                self._stop.check()
            except RunGone:
                raise
            except KleinkramError as error:
                is_temporary = isinstance(error, _UNAVAILABLE_ERRORS)
                rejected = [RejectedFile(file.path, str(error), is_temporary) for file in files]
            temporary = next((file.reason for file in rejected if file.is_temporary), None)
            if temporary is not None:
                # With the time, as the message stays once all is well again.
                now = datetime.datetime.now(datetime.timezone.utc)
                message = f"uploading results again; at {now:%Y-%m-%d %H:%M}Z: {temporary.partition('. ')[0]}"
                fraction = self.progress.fraction if self.progress else 1
                self.progress = Progress(fraction=fraction, message=_shortened(message, _MAX_PROGRESS_CHARACTERS))
            rounds += not (temporary is not None and unavailable.pause())
            if not rejected or rounds == _ROUNDS:
                return rejected
            run_id = self._assignment.run_id
            _log.warning("results of the run %s are uploaded again: %s", run_id, rejected[0].reason)
            paths = {file.path for file in rejected}
            files = [file for file in files if file.path in paths]
            self._stop.wait(_RETRY_EVERY_S)

    def _upload_once(self, files: Sequence[LocalFile]) -> list[RejectedFile]:
        """Upload files by the protocol of all uploads; stored content is not sent again."""
        run_id, results = self._assignment.run_id, list[TransferResult]()
        self._uploader = Uploader(
            self._context.runners.uploads(run_id, self._assignment.attempt),
            self._context.url,
            run_id,
            connections=min(_CONNECTIONS, len(files)),
            pace=RateLimit(None),
            watcher=Watcher(),
            ended=results.append,
            journals=self._job.directory / _JOURNALS,
        )
        self._uploader.run(files)
        return [
            RejectedFile(result.path, str(result.error), is_temporary=isinstance(result.error, StoreTroubled))
            for result in results
            if result.error is not None
        ]

    def _finish_of(self, ending: Ending, report: Report, problems: Sequence[str]) -> RunFinish:
        return RunFinish(
            attempt=self._assignment.attempt,
            reason=ending.reason,
            message=_shortened(ending.message),
            exit_code=ending.exit_code,
            report=report,
            problems=[_shortened(problem) for problem in problems[:_MAX_PROBLEMS]],
        )


def _shortened(text: str, limit: int = _MAX_CHARACTERS) -> str:
    """Return a text that can be sent: file names may not be valid Unicode."""
    return text.encode(errors="backslashreplace").decode().replace("\0", "")[:limit]
