"""The report of a run: findings, metrics, previews, and metadata that it proposes for the mission.

`/out/report.json` contains a `Report`; during a run, each line of `/out/.kleinkram/events.jsonl` is a `ReportEvent`.
"""

import enum
from typing import Annotated

from pydantic import AfterValidator, Field, FiniteFloat, model_validator
from typing_extensions import Self

from kleinkram.contract.base import Request
from kleinkram.contract.metadata import BoundedMetadata
from kleinkram.contract.names import FilePath, check_text

MAX_FINDINGS = 10_000
MAX_METRICS = 10_000
MAX_PREVIEWS = 100
MAX_REPORT_BYTES = 16 * 2**20
MAX_EVENT_BYTES = 64 * 2**10

REPORT_FILE = "report.json"
EVENTS_FILE = ".kleinkram/events.jsonl"

Code = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_.-]{0,63}$")]
Sentence = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=2000)]
TopicName = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=1024)]
LogTime = Annotated[int, Field(ge=0, lt=2**63)]


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
    """A number that a run measured. A later one of the same name and file replaces an earlier one."""

    name: Code
    value: FiniteFloat
    unit: Annotated[str, Field(max_length=32)] | None = None
    file: FilePath | None = None


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
    """The report of a run. `metadata` is a proposal; a person accepts or ignores it."""

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
