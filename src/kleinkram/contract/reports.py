"""The report of a run: checks, findings, metrics, previews, and metadata that it proposes for the mission.

`/out/report.json` contains a `Report`; during a run, each line of `/out/.kleinkram/events.jsonl` is a `ReportEvent`.
"""

import enum
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, FiniteFloat, model_validator
from typing_extensions import Self

from kleinkram.contract.base import Request
from kleinkram.contract.checks import MAX_CHECKS, Check, CheckStatus, Verdict, verdict_of
from kleinkram.contract.metadata import BoundedMetadata
from kleinkram.contract.names import FilePath, check_text

MAX_FINDINGS = 10_000
MAX_METRICS = 10_000
MAX_PREVIEWS = 100
MAX_METRIC_LABELS = 20
MAX_METRIC = 1e150
"""Of the size of a metric, so that sums of their squares, which PostgreSQL's mean needs, are finite, too."""
MAX_REPORT_BYTES = 16 * 2**20
"""Of `report.json`."""
MAX_REPORT_BODY_BYTES = 2 * MAX_REPORT_BYTES
"""Of a request that sends a report, to which the events of the run and its problems are added."""
MAX_EVENT_BYTES = 64 * 2**10

REPORT_FILE = "report.json"
EVENTS_FILE = ".kleinkram/events.jsonl"

Code = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_.-]{0,63}$")]
Sentence = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=2000)]
TopicName = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=1024)]
LogTime = Annotated[int, Field(ge=0, lt=2**63)]
LabelName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_.-]{0,63}$")]
LabelValue = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(check_text)]
ReportedVerdict = Literal[Verdict.good, Verdict.warnings, Verdict.bad]
"""What a report can say of a mission."""


class Severity(str, enum.Enum):
    """The severity of a finding."""

    info = "info"
    warning = "warning"
    error = "error"


class Finding(Request):
    """An observation of a run. `file` is the path of an input; times are log times, in ns since 1970."""

    severity: Severity
    code: Code
    message: Sentence
    file: FilePath | None = None
    topic: TopicName | None = None
    time_ns: LogTime | None = None


class Metric(Request):
    """A number that a run measured, of the whole mission or of a file or topic.

    `labels` distinguish numbers of one name, such as `{"method": "kiss-icp"}`. A later one of the same name, file,
    topic and labels replaces an earlier one.
    """

    name: Code
    value: Annotated[FiniteFloat, Field(ge=-MAX_METRIC, le=MAX_METRIC)]
    unit: Annotated[str, Field(max_length=32)] | None = None
    file: FilePath | None = None
    topic: TopicName | None = None
    labels: Annotated[dict[LabelName, LabelValue], Field(max_length=MAX_METRIC_LABELS)] = {}

    @property
    def key(self) -> tuple[object, ...]:
        """What identifies the metric within its run."""
        return self.name, self.file, self.topic, tuple(sorted(self.labels.items()))


class Preview(Request):
    """A picture (PNG, JPEG, SVG), table (CSV) or track (GeoJSON) among the artifacts that is shown with the run."""

    path: FilePath
    title: Annotated[str, AfterValidator(check_text), Field(max_length=200)] = ""


class MissionFile(Request):
    """An artifact that becomes the file `to` of the mission, made from the inputs `derived_from` (empty: all)."""

    path: FilePath
    to: FilePath
    derived_from: Annotated[list[FilePath], Field(max_length=10_000)] = []


class Report(Request):
    """The report of a run. `metadata` is a proposal; a person accepts or ignores it.

    `verdict` is what the run concludes; a failed check or an error among the findings makes it worse, never better.
    """

    checks: Annotated[list[Check], Field(max_length=MAX_CHECKS)] = []
    verdict: ReportedVerdict | None = None
    findings: Annotated[list[Finding], Field(max_length=MAX_FINDINGS)] = []
    metrics: Annotated[list[Metric], Field(max_length=MAX_METRICS)] = []
    previews: Annotated[list[Preview], Field(max_length=MAX_PREVIEWS)] = []
    metadata: BoundedMetadata = {}
    mission_files: Annotated[list[MissionFile], Field(max_length=10_000)] = []


class Progress(Request):
    """The progress of a run: `fraction` from 0 to 1, and a message."""

    fraction: Annotated[float, Field(ge=0, le=1)]
    message: Annotated[str, AfterValidator(check_text), Field(max_length=200)] = ""


class ReportEvent(Request):
    """A single report during a run: exactly one field is set."""

    check: Check | None = None
    verdict: ReportedVerdict | None = None
    finding: Finding | None = None
    metric: Metric | None = None
    progress: Progress | None = None
    preview: Preview | None = None
    metadata: BoundedMetadata | None = None
    mission_file: MissionFile | None = None

    @model_validator(mode="after")
    def _has_one_field(self) -> Self:
        if len(self.model_fields_set) != 1:
            raise ValueError("an event has exactly one field")
        return self


_STATUS_OF_SEVERITY = {Severity.warning: CheckStatus.warning, Severity.error: CheckStatus.error}
_STATUS_OF_VERDICT = {
    Verdict.good: CheckStatus.ok,
    Verdict.warnings: CheckStatus.warning,
    Verdict.bad: CheckStatus.error,
}


def verdict_of_report(report: Report) -> Verdict | None:
    """Return the worst of what a report says: its verdict, its checks, and its findings; None where it judges nothing.

    A check that could not be made counts as a warning, and findings of severity `info` do not count.
    """
    statuses = {entry.status for entry in report.checks}
    statuses |= {
        _STATUS_OF_SEVERITY[entry.severity] for entry in report.findings if entry.severity is not Severity.info
    }
    if report.verdict is not None:
        statuses.add(_STATUS_OF_VERDICT[report.verdict])
    verdict = verdict_of(statuses)
    return None if verdict is Verdict.unchecked else verdict
