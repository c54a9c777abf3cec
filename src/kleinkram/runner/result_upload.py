"""Uploads the results of a job, whatever they are, and reports the end of the run."""

import datetime
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kleinkram.client._http import Backoff
from kleinkram.client.errors import ServerUnreachable, StoreRetriesExhausted, StoreUnreachable
from kleinkram.client.runs import Runners
from kleinkram.client.transfer.plan import LocalFile, identity_of
from kleinkram.client.transfer.report import Watcher
from kleinkram.client.transfer.upload import Uploader
from kleinkram.contract import errors, reports
from kleinkram.contract.runners import LOG_PATH, SMALL_LOG_BYTES, RunAssignment, RunFinish
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import Ending
from kleinkram.runner.executors.supervision import DISK_FULL
from kleinkram.runner.logs import ReadLog, Redactor, write_redacted_log
from kleinkram.runner.results import collect_results, shortened
from kleinkram.runner.run_requests import RunRequests
from kleinkram.runner.state_directory import StopSignal

_REDACTED_LOG = "log.redacted"
_JOURNALS = "journals"
_CONNECTIONS = 4
_MAX_REPORTED_PROBLEMS = 200
_MAX_PROGRESS_CHARACTERS = 200
_ROUNDS = 5
_RETRY_EVERY_S = 2.0
# Results stay on the runner while the store or the server is unavailable. After a quarter of an hour without the server
# another runner may get the run first.
_UNAVAILABLE_S = 7 * 86400.0
_UNAVAILABLE_ERRORS = (ServerUnreachable, StoreUnreachable, errors.StoreUnavailable, errors.DatabaseUnavailable)
_SERVER_ERROR_S = 600.0

_log = logging.getLogger("kleinkram.runner")


@dataclass(frozen=True)
class RejectedFile:
    """A file that was not stored. `is_temporary`: the store or the server is unavailable."""

    path: str
    reason: str
    is_temporary: bool = False


@dataclass(frozen=True)
class JobOutput:
    """What a job left: `collect` returns the folder that was `/out`. `directory` is that of the job."""

    directory: Path
    collect: Callable[[], Path]
    read_log: ReadLog


class ResultUpload:
    """Uploads the results of one run, whose job has ended. May be repeated from the start, also on another machine.

    `url` is that of the server; after `unavailable_s` without it, or without the store, results are not stored.
    """

    def __init__(
        self,
        runners: Runners,
        url: str,
        output: JobOutput,
        assignment: RunAssignment,
        *,
        stop: StopSignal,
        redactor: Redactor,
        progress: reports.Progress | None,
        unavailable_s: float = _UNAVAILABLE_S,
    ) -> None:
        self._unavailable_s = unavailable_s
        self._runners = runners
        self._url = url
        self._output = output
        self._assignment = assignment
        self._stop = stop
        self._redactor = redactor
        self._uploader: Uploader | None = None
        # The last progress, and what the upload waits for.
        self.progress = progress and reports.Progress(fraction=progress.fraction)

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
        out = self._output.collect()
        results = collect_results(out)
        problems = [*results.problems]
        if results.report_error is not None:
            problems.append(results.report_error)
            if ending.reason is EndReason.done:
                ending = Ending(EndReason.broken_report, results.report_error, ending.exit_code)
        if ending.reason is EndReason.cancelled and results.artifacts:
            problems.append(f"It was cancelled: its {len(results.artifacts)} files were not stored.")
            results.artifacts.clear()
        small_log, files = self._log()
        rejected: list[RejectedFile] = []
        for artifact in results.artifacts:
            source = out / artifact.path
            try:
                files.append(LocalFile(source, artifact.path, identity_of(source.lstat())))
            except FileNotFoundError:  # in NFC the name may be another one, of which there is no file
                rejected.append(RejectedFile(artifact.path, "its name is not in the form NFC"))
        rejected += self._upload(files) if files else []
        problems += map(_problem, rejected)
        if ending.reason is EndReason.done and any(file.path != LOG_PATH for file in rejected):
            ending = Ending(EndReason.results_not_stored, problems[-1], ending.exit_code)
        finish = self._finish_of(ending, results.final_report(ending.reason), problems)
        return finish.model_copy(update={"log": small_log})

    def with_log(self, finish: RunFinish) -> RunFinish:
        """Store the log alone, of a run whose results are stored, and return what to report. Raises as `upload`."""
        small_log, files = self._log()
        problems = [*finish.problems, *map(_problem, self._upload(files) if files else [])]
        return finish.model_copy(update={"problems": problems[:_MAX_REPORTED_PROBLEMS], "log": small_log})

    def plain(self, ending: Ending) -> RunFinish:
        """Return what to report of a run without any results."""
        return self._finish_of(ending, reports.Report(), [])

    def _log(self) -> tuple[bytes | None, list[LocalFile]]:
        """Return the log if it is small, and otherwise the file to upload."""
        log = self._output.directory / _REDACTED_LOG
        size_bytes = write_redacted_log(self._output.read_log, self._redactor, log)
        if size_bytes <= SMALL_LOG_BYTES:
            return log.read_bytes() or None, []
        return None, [LocalFile(log, LOG_PATH, identity_of(log.stat()))]

    def without_results(self, ending: Ending) -> RunFinish:
        """Return what to report of a run that was cancelled while its results were uploaded."""
        problem = "It was cancelled while its results were uploaded: none were stored."
        return self._finish_of(ending, reports.Report(), [problem])

    def without_disk_space(self) -> RunFinish:
        """Return what to report of a run that cannot be completed because the disk is full."""
        problem = "Its results were not stored, or not all of them: the disk of its runner is full."
        return self._finish_of(Ending.of(DISK_FULL), reports.Report(), [problem])

    def report(self, finish: RunFinish, requests: RunRequests) -> None:
        """Report the end to the server, for as long as that takes. A run whose report is refused fails.

        Raises:
            StopRequested: the run is to stop.
            RunGone: it is not this runner's.
            KleinkramError: the server does not accept it.
        """
        backoff = Backoff(_SERVER_ERROR_S, self._stop.wait)
        run_id = self._assignment.run_id
        while True:
            try:
                requests.finish(run_id, finish, self._stop.wait)
                return
            except errors.RunGone:  # noqa: PERF203  (each round is a request)
                raise
            except (errors.InvalidRequest, errors.BodyTooLarge) as error:
                problem = shortened(f"The server did not accept its report: {error}")
                if finish.problems == [problem]:
                    raise
                changes = {"report": reports.Report(), "problems": [problem], "samples": []}
                if finish.reason is EndReason.done:
                    changes |= {"reason": EndReason.broken_report, "message": problem}
                finish = finish.model_copy(update=changes)
            except errors.KleinkramError as error:
                _log.warning("reporting the end of the run %s is repeated: %s", run_id, error)
                if not backoff.pause():
                    raise

    def _upload(self, files: Sequence[LocalFile]) -> list[RejectedFile]:
        """Upload files, and repeat rejected ones: afterwards the directory of the run is removed."""
        rounds, unavailable = 0, Backoff(self._unavailable_s, self._stop.wait)
        while True:
            self._stop.check()
            try:
                rejected = self._upload_once(files)
                self._stop.check()
            except errors.RunGone:
                raise
            except errors.KleinkramError as error:
                is_temporary = isinstance(error, _UNAVAILABLE_ERRORS)
                rejected = [RejectedFile(file.path, str(error), is_temporary) for file in files]
            temporary = next((file.reason for file in rejected if file.is_temporary), None)
            if temporary is not None:
                # With the time, as the message stays once all is well again.
                now = datetime.datetime.now(datetime.timezone.utc)
                message = f"uploading results again; at {now:%Y-%m-%d %H:%M}Z: {temporary.partition('. ')[0]}"
                fraction = self.progress.fraction if self.progress else 1
                message = shortened(message, _MAX_PROGRESS_CHARACTERS)
                self.progress = reports.Progress(fraction=fraction, message=message)
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
        run_id = self._assignment.run_id
        self._uploader = Uploader(
            self._runners.uploads(self._assignment.attempt),
            self._url,
            run_id,
            connections=min(_CONNECTIONS, len(files)),
            bytes_per_s=None,
            watcher=Watcher(),
            journals=self._output.directory / _JOURNALS,
        )
        self._uploader.run(files)
        return [
            RejectedFile(result.path, str(result.error), is_temporary=isinstance(result.error, StoreRetriesExhausted))
            for result in self._uploader.results
            if result.error is not None
        ]

    def _finish_of(self, ending: Ending, report: reports.Report, problems: Sequence[str]) -> RunFinish:
        return RunFinish(
            attempt=self._assignment.attempt,
            reason=ending.reason,
            message=shortened(ending.message),
            exit_code=ending.exit_code,
            report=report,
            problems=[shortened(problem) for problem in problems[:_MAX_REPORTED_PROBLEMS]],
        )


def _problem(file: RejectedFile) -> str:
    name = "Its log" if file.path == LOG_PATH else file.path
    return f"{name} was not stored: {file.reason}"
