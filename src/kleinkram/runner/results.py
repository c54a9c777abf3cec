"""Reads the results of a job from `/out`: artifacts, report, events. All of it is untrusted; no link is followed."""

import contextlib
import json
import os
import stat
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from pydantic import ValidationError

from kleinkram.contract.metadata import check_values
from kleinkram.contract.names import check_file_path
from kleinkram.contract.problems import first_message
from kleinkram.contract.reports import (
    EVENTS_FILE,
    MAX_EVENT_BYTES,
    MAX_FINDINGS,
    MAX_METRICS,
    MAX_REPORT_BYTES,
    REPORT_FILE,
    Finding,
    Metric,
    Progress,
    Report,
    ReportEvent,
)
from kleinkram.runner.files import open_beneath

MAX_ARTIFACTS = 100_000
_MAX_PROBLEMS = 100
_PROGRESS_BYTES = 2**20
# The limit of all entries, links and directories included, so that a job cannot keep the runner busy.
_MAX_ENTRIES = 10 * MAX_ARTIFACTS


@dataclass(frozen=True)
class Artifact:
    """A file in `/out`; `path` is relative."""

    path: str
    size_bytes: int


@dataclass
class Results:
    """The results of a job. `problems` are sentences about what could not be read.

    `report_error`: why `report.json` is not a report; None where it is one, or does not exist.
    """

    artifacts: list[Artifact] = field(default_factory=list)
    report: Report = field(default_factory=Report)
    problems: list[str] = field(default_factory=list)
    report_error: str | None = None


class ProgressReader:
    """Reads the progress of a running job from its events, which may be of any size."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._offset = 0
        self.progress: Progress | None = None

    def read(self) -> None:
        """Read the events since the last call; invalid ones are reported at the end of the run."""
        try:
            stream = open_beneath(self._out, EVENTS_FILE)
        except OSError:
            return
        if stream is None:
            return
        with stream:
            size = stream.seek(0, os.SEEK_END)
            # Only the end matters.
            self._offset = stream.seek(max(self._offset, size - _PROGRESS_BYTES))
            lines, line_end, _ = stream.read(_PROGRESS_BYTES).rpartition(b"\n")
            self._offset += len(lines) + len(line_end)
        for line in reversed(lines.splitlines()):
            if b'"progress"' not in line or len(line) > MAX_EVENT_BYTES:
                continue
            with contextlib.suppress(ValidationError):
                if (progress := ReportEvent.model_validate_json(line).progress) is not None:
                    self.progress = progress
                    return


def collect_results(out: Path) -> Results:
    """Read the results of an ended job; none where the directory does not exist."""
    if not out.is_dir():
        return Results()
    problems = _Problems()
    artifacts = list(islice(_artifacts(out, problems), MAX_ARTIFACTS + 1))
    if len(artifacts) > MAX_ARTIFACTS:
        problems.add_general(f"It left more than {MAX_ARTIFACTS} files; the others were not stored.")
        del artifacts[MAX_ARTIFACTS:]
    artifacts.sort(key=lambda artifact: artifact.path)
    report, report_error = Report(), None
    try:
        if (data := _read(out, REPORT_FILE, MAX_REPORT_BYTES)) is not None:
            report = Report.model_validate_json(data)
    except _Unreadable as error:
        report_error = str(error)
    except ValidationError as error:
        report_error = f"{REPORT_FILE} is not a report: {_first(error)}."
    report = _merged(_events(out, problems), report, problems)
    paths = {artifact.path for artifact in artifacts}
    for path in [*(preview.path for preview in report.previews), *(artifact.path for artifact in report.put_back)]:
        if path not in paths:
            problems.add(f"It reports the artifact {path}, which does not exist.")
    existing = {
        "previews": [preview for preview in report.previews if preview.path in paths],
        "put_back": [artifact for artifact in report.put_back if artifact.path in paths],
    }
    return Results(artifacts, report.model_copy(update=existing), problems.sentences(), report_error)


class _Unreadable(Exception):
    """A file cannot be read; the message is the reason."""


class _Problems:
    """The first problems; the others are only counted, since there may be any number of them."""

    def __init__(self) -> None:
        self._general: list[str] = []
        self._first: list[str] = []
        self._more = 0

    def add_general(self, problem: str) -> None:
        """Add a problem that exists at most once; these come first."""
        self._general.append(problem)

    def add(self, problem: str) -> None:
        """Add a problem of a single entry."""
        if len(self._first) < _MAX_PROBLEMS:
            self._first.append(problem)
        else:
            self._more += 1

    def sentences(self) -> list[str]:
        """Return the problems, and how many more there are."""
        more = [f"And {self._more} more."] if self._more else []
        return self._general + self._first + more


def _artifacts(out: Path, problems: _Problems) -> Iterator[Artifact]:
    for number, entry in enumerate(_entries(out, problems)):
        if number == _MAX_ENTRIES:
            problems.add_general(
                f"It left more than {_MAX_ENTRIES} files, folders and links: the others were not read."
            )
            return
        path = Path(entry.path).relative_to(out).as_posix()
        try:
            status = entry.stat(follow_symlinks=False)
        except OSError as error:
            problems.add(f"{path} cannot be read: {error.strerror}.")
            continue
        if stat.S_ISDIR(status.st_mode):
            continue
        if not stat.S_ISREG(status.st_mode):
            kind = "a link" if stat.S_ISLNK(status.st_mode) else "no regular file"
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
    excluded = {str(out / REPORT_FILE), str(out / EVENTS_FILE.partition("/")[0])}
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
            problems.add(f"The folder {Path(directory).relative_to(out)} cannot be read: {error.strerror}.")


def _read(out: Path, name: str, max_bytes: int) -> bytes | None:
    """Return the content of a file below `out`, or None where there is none.

    Raises:
        _Unreadable: it is no regular file, or too large.
    """
    try:
        stream = open_beneath(out, name)
    except OSError as error:
        raise _Unreadable(f"{name} cannot be read: {error.strerror or error}.") from error
    if stream is None:
        return None
    with stream:
        data = stream.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise _Unreadable(f"{name} has more than {max_bytes} bytes.")
    return data


def _events(out: Path, problems: _Problems) -> list[ReportEvent]:
    try:
        data = _read(out, EVENTS_FILE, (MAX_FINDINGS + MAX_METRICS) * MAX_EVENT_BYTES // 16) or b""
    except _Unreadable as error:
        problems.add(str(error))
        return []
    events = []
    for number, line in enumerate(data.splitlines(), 1):
        try:
            events.append(ReportEvent.model_validate_json(line))
        except ValidationError as error:  # noqa: PERF203  (each line is checked by itself)
            problems.add(f"Line {number} of {Path(EVENTS_FILE).name} is no event: {_first(error)}.")
    return events


def _merged(events: list[ReportEvent], report: Report, problems: _Problems) -> Report:
    """Merge the events with the report, which comes last; the last value of a metric counts."""
    findings: list[Finding] = [event.finding for event in events if event.finding] + report.findings
    all_metrics = [event.metric for event in events if event.metric] + report.metrics
    metrics: dict[tuple[str, str | None], Metric] = {(metric.name, metric.file): metric for metric in all_metrics}
    previews = {one.path: one for one in [event.preview for event in events] + [*report.previews] if one}
    put_back = {one.to: one for one in [event.put_back for event in events] + [*report.put_back] if one}
    metadata = {name: value for event in events if event.metadata for name, value in event.metadata.items()}
    metadata |= report.metadata
    try:
        check_values(metadata)
    except ValueError as error:
        problems.add(f"The proposed metadata {error}: left out.")
        metadata = {}
    for what, count, limit in (("findings", len(findings), MAX_FINDINGS), ("metrics", len(metrics), MAX_METRICS)):
        if count > limit:
            problems.add(f"It reported {count} {what}; only the first {limit} are stored.")
    return Report.model_construct(
        findings=findings[:MAX_FINDINGS],
        metrics=list(metrics.values())[:MAX_METRICS],
        previews=list(previews.values()),
        metadata=metadata,
        put_back=list(put_back.values()),
    )


def _first(error: ValidationError) -> str:
    where = ".".join(map(str, error.errors(include_url=False, include_input=False)[0]["loc"]))
    return json.dumps(where) + ": " + first_message(error) if where else first_message(error)
