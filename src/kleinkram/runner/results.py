"""Reads the results of a job from `/out`.

The content of `/out` is untrusted: no link in it is followed.
"""

import contextlib
import errno
import json
import os
import stat
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import IO

from pydantic import ValidationError
from pydantic_core import from_json

from kleinkram.contract import reports
from kleinkram.contract.checks import MAX_CHECKS, WORST_FIRST, Check, CheckStatus
from kleinkram.contract.metadata import check_values
from kleinkram.contract.names import check_file_path
from kleinkram.contract.problems import first_message
from kleinkram.contract.runs import EndReason

MAX_ARTIFACTS = 100_000
_MAX_PROBLEMS = 100
_MAX_EVENTS_BYTES = (MAX_CHECKS + reports.MAX_FINDINGS + reports.MAX_METRICS) * reports.MAX_EVENT_BYTES // 16
_PROGRESS_BYTES = 2**20
_SEVERITIES = [*reports.Severity]
# The limit of all entries, links and directories included, so that a job cannot keep the runner busy.
_MAX_ENTRIES = 10 * MAX_ARTIFACTS
# What a job can make of its folder: files that are missing, without permissions, or no files.
_ERRORS_OF_JOBS = frozenset(
    {
        *(errno.ENOENT, errno.EACCES, errno.EPERM, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG),
        *(errno.ENXIO, errno.ENODEV, errno.EMLINK, errno.EINVAL),
    }
)
_MAX_CHARACTERS = 2000
_MAX_LOSS_CHARACTERS = 1800


@dataclass(frozen=True)
class Artifact:
    """A file in `/out`; `path` is relative."""

    path: str
    size_bytes: int


@dataclass
class Results:
    """The results of a job. `problems` are sentences about what could not be read.

    `report_error`: why `report.json` is not a report; None where it is one, or does not exist. `losses`: the number of
    problems by which part of the report is missing, and `first_loss` the first of them.
    """

    artifacts: list[Artifact] = field(default_factory=list)
    report: reports.Report = field(default_factory=reports.Report)
    problems: list[str] = field(default_factory=list)
    report_error: str | None = None
    losses: int = 0
    first_loss: str = ""

    def final_report(self, reason: EndReason) -> reports.Report:
        """Return the report of a run that ended so. Where part of it is missing, a check says so: it is never good."""
        if reason is not EndReason.done or not self.losses:
            return self.report
        more = f" And {self.losses - 1} more." if self.losses > 1 else ""
        incomplete = Check(
            name="report.incomplete",
            status=CheckStatus.not_made,
            message=f"Part of the report is missing. {shortened(self.first_loss, _MAX_LOSS_CHARACTERS)}{more}",
        )
        checks = [*self.report.checks, incomplete]
        if len(checks) > MAX_CHECKS:
            checks = [*_worst_first(self.report.checks)[: MAX_CHECKS - 1], incomplete]
        return self.report.model_copy(update={"checks": checks})


class ProgressReader:
    """Reads the progress of a running job from its events, which may be of any size."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._offset = 0
        self._file: tuple[int, int] | None = None
        self.progress: reports.Progress | None = None

    def read(self) -> None:
        """Read the events since the last call; invalid ones are reported at the end of the run.

        The progress stays as it was where they cannot be read at the moment. That of an earlier start of the job, which
        had another file, is forgotten.
        """
        try:
            stream = _open_beneath(self._out, reports.EVENTS_FILE)
            if stream is None:
                return
            with stream:
                lines = self._new_lines(stream)
        except OSError:
            return
        for line in reversed(lines.splitlines()):
            if b'"progress"' not in line or len(line) > reports.MAX_EVENT_BYTES:
                continue
            with contextlib.suppress(ValidationError):
                if (progress := reports.ReportEvent.model_validate_json(line).progress) is not None:
                    self.progress = progress
                    return

    def _new_lines(self, stream: IO[bytes]) -> bytes:
        status = os.fstat(stream.fileno())
        file = (status.st_dev, status.st_ino)
        if self._file not in (None, file) or status.st_size < self._offset:
            self._offset, self.progress = 0, None
        self._file = file
        # Only the end matters.
        offset = stream.seek(max(self._offset, status.st_size - _PROGRESS_BYTES))
        lines, line_end, _ = stream.read(_PROGRESS_BYTES).rpartition(b"\n")
        self._offset = offset + len(lines) + len(line_end)
        return lines


def collect_results(out: Path) -> Results:
    """Read the results of an ended job; none where the directory does not exist.

    Raises:
        OSError: the file system cannot be read at the moment.
    """
    if not out.is_dir():
        return Results()
    problems = _Problems()
    artifacts = list(islice(_artifacts(out, problems), MAX_ARTIFACTS + 1))
    if len(artifacts) > MAX_ARTIFACTS:
        problems.general.append(f"It left more than {MAX_ARTIFACTS} files; the others were not stored.")
        del artifacts[MAX_ARTIFACTS:]
    artifacts.sort(key=lambda artifact: artifact.path)
    report, report_error = reports.Report(), None
    try:
        if (data := _read(out, reports.REPORT_FILE, reports.MAX_REPORT_BYTES)) is not None:
            report = reports.Report.model_validate_json(data)
    except _Unreadable as error:
        report_error = str(error)
    except ValidationError as error:
        report_error = f"{reports.REPORT_FILE} is not a report: {_first(error)}."
    report = _merged(_events(out, problems), report, problems)
    paths = {artifact.path for artifact in artifacts}
    for path in [*(preview.path for preview in report.previews), *(artifact.path for artifact in report.mission_files)]:
        if path not in paths:
            problems.add(f"It reports the artifact {path}, which does not exist.")
    existing = {
        "previews": [preview for preview in report.previews if preview.path in paths],
        "mission_files": [artifact for artifact in report.mission_files if artifact.path in paths],
    }
    report = report.model_copy(update=existing)
    return Results(artifacts, report, problems.sentences(), report_error, problems.losses, problems.first_loss)


def _check_storage(error: OSError) -> None:
    """Raise an error of the file system or of this machine, which may be over soon; a job can cause the others."""
    if error.errno is not None and error.errno not in _ERRORS_OF_JOBS:
        raise error


class _Unreadable(Exception):
    """A file cannot be read; the message is the reason."""


class _Problems:
    """The first problems; the others are only counted, since there may be any number of them."""

    def __init__(self) -> None:
        self.general: list[str] = []
        self._first: list[str] = []
        self._more = 0
        self.losses = 0
        self.first_loss = ""

    def add(self, problem: str) -> None:
        """Add a problem of a single entry; those in `general` come before."""
        if len(self._first) < _MAX_PROBLEMS:
            self._first.append(problem)
        else:
            self._more += 1

    def add_loss(self, problem: str) -> None:
        """Add a problem by which part of the report is missing."""
        self.first_loss = self.first_loss or problem
        self.losses += 1
        self.add(problem)

    def sentences(self) -> list[str]:
        """Return the problems, and how many more there are."""
        return [*self.general, *self._first, *([f"And {self._more} more."] if self._more else [])]


def _artifacts(out: Path, problems: _Problems) -> Iterator[Artifact]:
    for number, entry in enumerate(_entries(out, problems)):
        if number == _MAX_ENTRIES:
            problems.general.append(
                f"It left more than {_MAX_ENTRIES} files, folders and links: the others were not read."
            )
            return
        path = Path(entry.path).relative_to(out).as_posix()
        try:
            status = entry.stat(follow_symlinks=False)
        except OSError as error:
            _check_storage(error)
            problems.add(f"{path} cannot be read: {error.strerror}.")
            continue
        if stat.S_ISDIR(status.st_mode):
            continue
        if not stat.S_ISREG(status.st_mode):
            kind = "a link" if stat.S_ISLNK(status.st_mode) else "not a regular file"
            problems.add(f"{path} is {kind}: left out.")
            continue
        if not os.access(entry.path, os.R_OK):
            problems.add(f"{path} cannot be read: left out.")
            continue
        try:
            yield Artifact(check_file_path(path), status.st_size)
        except ValueError as error:
            problems.add(f"The name {path!r} {error}: left out.")


def _entries(out: Path, problems: _Problems) -> Iterator[os.DirEntry[str]]:
    """Yield all entries below a directory of any size, without the report and the events."""
    excluded = {str(out / reports.REPORT_FILE), str(out / reports.EVENTS_FILE.partition("/")[0])}
    pending = deque([str(out)])
    while pending:
        directory = pending.popleft()
        try:
            with os.scandir(directory) as entries:
                for entry in entries:
                    if entry.path in excluded:
                        continue
                    if entry.is_dir(follow_symlinks=False):
                        pending.append(entry.path)
                    yield entry
        except OSError as error:
            _check_storage(error)
            problems.add(f"The folder {Path(directory).relative_to(out)} cannot be read: {error.strerror}.")


def _read(out: Path, name: str, max_bytes: int) -> bytes | None:
    """Return the content of a file below `out`, or None where there is none.

    Raises:
        _Unreadable: it is not a regular file, or too large.
    """
    try:
        stream = _open_beneath(out, name)
    except OSError as error:
        _check_storage(error)
        raise _Unreadable(f"{name} cannot be read: {error.strerror or error}.") from error
    if stream is None:
        return None
    with stream:
        data = stream.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise _Unreadable(f"{name} has more than {max_bytes} bytes.")
    return data


def _events(out: Path, problems: _Problems) -> list[reports.ReportEvent]:
    try:
        data = _read(out, reports.EVENTS_FILE, _MAX_EVENTS_BYTES) or b""
    except _Unreadable as error:
        problems.add_loss(str(error))
        return []
    events = []
    for number, line in enumerate(data.splitlines(), 1):
        if not line.strip():
            continue
        try:
            events.append(reports.ReportEvent.model_validate_json(line))
        except ValidationError as error:
            add = problems.add if _is_progress(line, error) else problems.add_loss
            add(f"Line {number} of {Path(reports.EVENTS_FILE).name} is no event: {_first(error)}.")
    return events


def _is_progress(line: bytes, error: ValidationError) -> bool:
    """Return whether an invalid event is one of progress, which is no part of the report."""
    places = [problem["loc"] for problem in error.errors(include_url=False, include_context=False, include_input=False)]
    return all(place[:1] == ("progress",) for place in places) and from_json(line).keys() == {"progress"}


def _worst_first(checks: list[Check]) -> list[Check]:
    return sorted(checks, key=lambda check: WORST_FIRST.index(check.status))


def _merged(events: list[reports.ReportEvent], report: reports.Report, problems: _Problems) -> reports.Report:
    """Merge the events with the report, which comes last; the last value of a metric counts, and the last verdict."""
    checks: list[Check] = [event.check for event in events if event.check] + report.checks
    verdicts = [event.verdict for event in events if event.verdict] + [report.verdict] * (report.verdict is not None)
    findings: list[reports.Finding] = [event.finding for event in events if event.finding] + report.findings
    all_metrics = [event.metric for event in events if event.metric] + report.metrics
    metrics = list({metric.key: metric for metric in all_metrics}.values())
    previews = {one.path: one for one in [event.preview for event in events] + [*report.previews] if one}
    mission_files = {one.to: one for one in [event.mission_file for event in events] + [*report.mission_files] if one}
    metadata = {name: value for event in events if event.metadata for name, value in event.metadata.items()}
    metadata |= report.metadata
    try:
        check_values(metadata)
    except ValueError as error:
        problems.add_loss(f"The proposed metadata {error}: left out.")
        metadata = {}
    if len(checks) > MAX_CHECKS:
        problems.add_loss(f"It reported {len(checks)} checks; only the {MAX_CHECKS} worst are stored.")
        checks = _worst_first(checks)
    if len(findings) > reports.MAX_FINDINGS:
        problems.add_loss(f"It reported {len(findings)} findings; only the {reports.MAX_FINDINGS} worst are stored.")
        findings = sorted(findings, key=lambda finding: -_SEVERITIES.index(finding.severity))
    if len(metrics) > reports.MAX_METRICS:
        problems.add_loss(f"It reported {len(metrics)} metrics; only the first {reports.MAX_METRICS} are stored.")
    return reports.Report.model_construct(
        checks=checks[:MAX_CHECKS],
        verdict=verdicts[-1] if verdicts else None,
        findings=findings[: reports.MAX_FINDINGS],
        metrics=metrics[: reports.MAX_METRICS],
        previews=list(previews.values()),
        metadata=metadata,
        mission_files=list(mission_files.values()),
    )


def _first(error: ValidationError) -> str:
    where = ".".join(map(str, error.errors(include_url=False, include_input=False)[0]["loc"]))
    return json.dumps(where) + ": " + first_message(error) if where else first_message(error)


def _open_beneath(directory: Path, relative: str) -> IO[bytes] | None:
    """Open a regular file below a directory that untrusted code wrote to; None where it does not exist.

    Raises:
        OSError: it is not a regular file, or a link is on the way.
    """
    *parents, name = relative.split("/")
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC
    current = os.open(directory, flags | os.O_DIRECTORY)
    try:
        for parent in parents:
            child = os.open(parent, flags | os.O_DIRECTORY, dir_fd=current)
            os.close(current)
            current = child
        descriptor = os.open(name, flags | os.O_NONBLOCK, dir_fd=current)
    except FileNotFoundError:
        return None
    finally:
        os.close(current)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(f"{name} is not a regular file")
    return os.fdopen(descriptor, "rb")


def shortened(text: str, limit: int = _MAX_CHARACTERS) -> str:
    """Return a text that can be sent: file names may not be valid Unicode."""
    return text.encode(errors="backslashreplace").decode().replace("\0", "")[:limit]
