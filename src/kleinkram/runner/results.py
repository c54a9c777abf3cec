"""What a run left in `/out`, read as what it is: the word of a stranger. No link is followed, nothing is believed."""

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
from kleinkram.contract.reports import (
    EVENTS_FILE,
    MAX_EVENT_BYTES,
    MAX_FINDINGS,
    MAX_METRICS,
    MAX_REPORT_BYTES,
    REPORT_FILE,
    Finding,
    Metric,
    Report,
    ReportEvent,
)
from kleinkram.contract.wording import in_plain_words
from kleinkram.runner.disk import open_inside

MAX_ARTIFACTS = 100_000
_MOST_PROBLEMS = 100
# All that it left is looked at by name, links and folders included: so many, and a stranger cannot keep it at that.
_MOST_ENTRIES = 10 * MAX_ARTIFACTS


@dataclass(frozen=True)
class Artifact:
    """A file that a run left; `path` is relative to `/out`."""

    path: str
    size_bytes: int


@dataclass
class Results:
    """All that a run left and said. `problems` say, in sentences, what of it could not be taken.

    `broken` says why `report.json` is no report; null where it is one, or there is none.
    """

    artifacts: list[Artifact] = field(default_factory=list)
    report: Report = field(default_factory=Report)
    problems: list[str] = field(default_factory=list)
    broken: str | None = None


def collect(out: Path) -> Results:
    """Read what a run that is over left in its folder `out`; nothing, where there is no such folder."""
    if not out.is_dir():
        return Results()
    problems = _Problems()
    artifacts = list(islice(_artifacts(out, problems), MAX_ARTIFACTS + 1))
    if len(artifacts) > MAX_ARTIFACTS:
        problems.add_of_all(f"It left more than {MAX_ARTIFACTS} files; only so many are kept.")
        del artifacts[MAX_ARTIFACTS:]
    artifacts.sort(key=lambda artifact: artifact.path)
    report, broken = Report(), None
    try:
        report = _report(out)
    except _Unreadable as error:
        broken = str(error)
    report = _together(_events(out, problems), report, problems)
    report = _only_artifacts(report, {artifact.path for artifact in artifacts}, problems)
    return Results(artifacts, report, problems.told(), broken)


class _Unreadable(Exception):
    """A file is not what it should be; says why."""


class _Problems:
    """The first problems, as a stranger may make any number of them; the others are only counted.

    What is said of all that was left comes before what is said of each.
    """

    def __init__(self) -> None:
        self._of_all: list[str] = []
        self._first: list[str] = []
        self._more = 0

    def add_of_all(self, problem: str) -> None:
        """Note one that is there at most once."""
        self._of_all.append(problem)

    def add(self, problem: str) -> None:
        """Note one more."""
        if len(self._first) < _MOST_PROBLEMS:
            self._first.append(problem)
        else:
            self._more += 1

    def told(self) -> list[str]:
        """Return them, and how many more there are."""
        more = [f"And {self._more} more."] if self._more else []
        return self._of_all + self._first + more


def _artifacts(out: Path, problems: _Problems) -> Iterator[Artifact]:
    for number, entry in enumerate(_entries(out, problems)):
        if number == _MOST_ENTRIES:
            problems.add_of_all(f"It left more than {_MOST_ENTRIES} files, folders and links: no more were looked at.")
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
    """Yield all that is below a folder, but for report and events, as it comes: a folder may be of any size."""
    apart = {str(out / REPORT_FILE), str(out / EVENTS_FILE.partition("/")[0])}
    waiting = deque([str(out)])
    while waiting:
        folder = waiting.popleft()
        try:
            with os.scandir(folder) as entries:
                for entry in entries:
                    if entry.path in apart:
                        continue
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(entry.path)
                    yield entry
        except OSError as error:
            problems.add(f"The folder {Path(folder).relative_to(out)} cannot be read: {error.strerror}.")


def _read(out: Path, name: str, most_bytes: int) -> bytes | None:
    """Return what a file below `out` holds, or None where there is none; links are not followed.

    Raises:
        _Unreadable: it is something else, or too large.
    """
    try:
        stream = open_inside(out, name)
    except OSError as error:
        raise _Unreadable(f"{name} cannot be read: {error.strerror or error}.") from error
    if stream is None:
        return None
    with stream:
        data = stream.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise _Unreadable(f"{name} has more than {most_bytes} bytes.")
    return data


def _report(out: Path) -> Report:
    data = _read(out, REPORT_FILE, MAX_REPORT_BYTES)
    if data is None:
        return Report()
    try:
        return Report.model_validate_json(data)
    except ValidationError as error:
        raise _Unreadable(f"{REPORT_FILE} is not a report: {_first(error)}.") from error


def _events(out: Path, problems: _Problems) -> list[ReportEvent]:
    try:
        data = _read(out, EVENTS_FILE, (MAX_FINDINGS + MAX_METRICS) * MAX_EVENT_BYTES // 16) or b""
    except _Unreadable as error:
        problems.add(str(error))
        return []
    return [event for number, line in enumerate(data.splitlines(), 1) if (event := _event(line, number, problems))]


def _event(line: bytes, number: int, problems: _Problems) -> ReportEvent | None:
    try:
        return ReportEvent.model_validate_json(line)
    except ValidationError as error:
        problems.add(f"Line {number} of {Path(EVENTS_FILE).name} is no event: {_first(error)}.")
        return None


def _together(events: list[ReportEvent], report: Report, problems: _Problems) -> Report:
    """Put what was said while the run lasted before what the report says; the last word on a metric counts."""
    findings: list[Finding] = [event.finding for event in events if event.finding] + report.findings
    said = [event.metric for event in events if event.metric] + report.metrics
    metrics: dict[tuple[str, str | None], Metric] = {(metric.name, metric.file): metric for metric in said}
    previews = {each.path: each for each in [event.preview for event in events] + [*report.previews] if each}
    put_back = {each.to: each for each in [event.put_back for event in events] + [*report.put_back] if each}
    metadata = {name: value for event in events if event.metadata for name, value in event.metadata.items()}
    metadata |= report.metadata
    try:
        check_values(metadata)
    except ValueError as error:
        problems.add(f"The metadata that it proposes {error}: left out.")
        metadata = {}
    for what, count, most in (("findings", len(findings), MAX_FINDINGS), ("metrics", len(metrics), MAX_METRICS)):
        if count > most:
            problems.add(f"It said {count} {what}; the first {most} are kept.")
    return Report.model_construct(
        findings=findings[:MAX_FINDINGS],
        metrics=list(metrics.values())[:MAX_METRICS],
        previews=list(previews.values()),
        metadata=metadata,
        put_back=list(put_back.values()),
    )


def _only_artifacts(report: Report, paths: set[str], problems: _Problems) -> Report:
    """Leave out what is said of files that are not there."""
    spoken_of = [each.path for each in report.previews] + [each.path for each in report.put_back]
    for path in spoken_of:
        if path not in paths:
            problems.add(f"It speaks of the artifact {path}, which it did not leave.")
    previews = [each for each in report.previews if each.path in paths]
    put_back = [each for each in report.put_back if each.path in paths]
    return report.model_copy(update={"previews": previews, "put_back": put_back})


def _first(error: ValidationError) -> str:
    where = ".".join(map(str, error.errors(include_url=False, include_input=False)[0]["loc"]))
    return json.dumps(where) + ": " + in_plain_words(error) if where else in_plain_words(error)
