"""What a run says in a form that is understood: findings, metrics, previews, and what it proposes for the mission.

`/out/report.json` holds a `Report`; while a run lasts, each line of `/out/.kleinkram/events.jsonl` is an `Event`.
"""

import enum
from typing import Annotated

from pydantic import AfterValidator, Field, FiniteFloat, model_validator
from typing_extensions import Self

from kleinkram.contract.metadata import GivenMetadata
from kleinkram.contract.names import FilePath, check_text
from kleinkram.contract.wire import Request

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
    """How bad a finding is."""

    info = "info"
    warning = "warning"
    error = "error"


class Finding(Request):
    """Something that a run noticed. `file` is a path of its inputs; times are log times, in ns since 1970."""

    severity: Severity
    code: Code
    message: Sentence
    file: FilePath | None = None
    topic: TopicName | None = None
    time_ns: LogTime | None = None


class Metric(Request):
    """A number that a run found. One of a name and a file: a later one takes the place of an earlier."""

    name: Code
    value: FiniteFloat
    unit: Annotated[str, Field(max_length=32)] | None = None
    file: FilePath | None = None


class Preview(Request):
    """A picture (PNG, JPEG, SVG), a table (CSV) or a track (GeoJSON) among the artifacts, to be shown with the run."""

    path: FilePath
    title: Annotated[str, AfterValidator(check_text), Field(max_length=200)] = ""


class PutBack(Request):
    """An artifact that becomes a file of the mission, at `to`, made from the inputs `made_from` (none named: all)."""

    path: FilePath
    to: FilePath
    made_from: Annotated[list[FilePath], Field(max_length=10_000)] = []


class Report(Request):
    """All that a run says. `metadata` is proposed to people, never taken over by itself."""

    findings: Annotated[list[Finding], Field(max_length=MAX_FINDINGS)] = []
    metrics: Annotated[list[Metric], Field(max_length=MAX_METRICS)] = []
    previews: Annotated[list[Preview], Field(max_length=MAX_PREVIEWS)] = []
    metadata: GivenMetadata = {}
    put_back: Annotated[list[PutBack], Field(max_length=10_000)] = []


class Progress(Request):
    """How far a run is: `fraction` from 0 to 1, and what it is at."""

    fraction: Annotated[float, Field(ge=0, le=1)]
    message: Annotated[str, AfterValidator(check_text), Field(max_length=200)] = ""


class Event(Request):
    """One thing that a run says while it lasts: exactly one of these is there."""

    finding: Finding | None = None
    metric: Metric | None = None
    progress: Progress | None = None
    preview: Preview | None = None
    metadata: GivenMetadata | None = None
    put_back: PutBack | None = None

    @model_validator(mode="after")
    def _says_one_thing(self) -> Self:
        if len(self.model_fields_set) != 1:
            raise ValueError("an event says one thing")
        return self
