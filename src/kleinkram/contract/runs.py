"""Runs: executions of an action on a mission, their reports and artifacts."""

import datetime
import enum
import uuid
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator
from typing_extensions import Self

from kleinkram.contract.actions import (
    MAX_SCRIPT_CHARACTERS,
    ActionDefinition,
    Network,
    OwnDefinition,
    ParameterValues,
)
from kleinkram.contract.base import Request, Response
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.contract.files import FetchPurpose, FileRead, RecordingRead, TopicRead
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.missions import LocationFilter, MissionRead, MissionRef
from kleinkram.contract.names import FilePath, Name, Term, check_text
from kleinkram.contract.people import PersonRef
from kleinkram.contract.problems import ProblemDocument
from kleinkram.contract.reports import Finding, Metric, Preview, Progress, Report, ReportedVerdict, Severity

CONTEXT_FILE = "mission.json"
MAX_LAUNCHED = 1000
MAX_RECORDED_FILES = 10_000
MAX_SAMPLES = 720
# Metrics that a run in a list carries.
MAX_LISTED_METRICS = 12
# The maximum stored size of the output of a run; the log shows where it was truncated.
LOG_BYTES = 100 * 2**20


class RunState(str, enum.Enum):
    """The state of a run. `preparing` fetches image and inputs, `collecting` uploads results; three are final."""

    queued = "queued"
    preparing = "preparing"
    running = "running"
    collecting = "collecting"
    done = "done"
    failed = "failed"
    cancelled = "cancelled"


class EndReason(str, enum.Enum):
    """Why a run ended. `done` and `exit_code` come from the command itself."""

    done = "done"
    exit_code = "exit_code"
    signal = "signal"
    memory = "memory"
    time = "time"
    disk = "disk"
    cancelled = "cancelled"
    command_not_found = "command_not_found"
    image_unavailable = "image_unavailable"
    not_possible = "not_possible"
    inputs_unavailable = "inputs_unavailable"
    broken_report = "broken_report"
    results_not_stored = "results_not_stored"
    lost = "lost"


class ActionRef(Response):
    """A version of an action; id and version are null where the action is not published."""

    id: uuid.UUID | None = None
    name: str
    version: Annotated[int, Field(ge=1)] | None


class Cause(Response):
    """Who launched a run, and which run it retries."""

    person: PersonRef | None = None
    retry_of_id: uuid.UUID | None = None


class RunChecks(Response):
    """The `checks.yaml` of the project as it was at the launch. `version` is its number, `sha256` that of the text."""

    version: Annotated[int, Field(ge=1)]
    sha256: str
    text: str


class RunContext(Response):
    """The content of `/in/mission.json`: the mission, the input files with their topics, the parameters.

    `run_id` is null for a local run. `topics` belong to the files, `recordings` to the mission. Metadata that the
    action declares as inputs have their values at the launch; with `checks` or `reference`, all have. `checks` and
    `reference` are null unless the action declares to read them, and where there is none. `reference` is the name of
    the trajectory with which estimates are compared: of the mission's metadata, or else of the `checks.yaml`.
    """

    contract: Literal[1] = 1
    run_id: uuid.UUID | None
    action: ActionRef
    parameters: ParameterValues
    cause: Cause
    mission: MissionRead
    files: list[FileRead]
    topics: list[TopicRead]
    recordings: list[RecordingRead]
    checks: RunChecks | None = None
    reference: str | None = None


class RunPriority(str, enum.Enum):
    """Which queued runs start first; among those of one priority, projects take turns, and people within a project.

    `high` requires DELETE on the mission. A run of priority `low` that waited for an hour counts as `normal`.
    """

    low = "low"
    normal = "normal"
    high = "high"


class RunsCreate(Request):
    """An action to run on each of some missions: a published one by id, or an unpublished definition.

    Without `version`, the latest version runs. Results of an earlier successful run with the same version, image,
    parameters and inputs (files, and the metadata, checks and reference that it declares) are reused unless `force`.
    """

    mission_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=MAX_LAUNCHED)]
    action_id: uuid.UUID | None = None
    version: Annotated[int, Field(ge=1, lt=2**31)] | None = None
    definition: OwnDefinition | None = None
    parameters: ParameterValues = {}
    priority: RunPriority = RunPriority.normal
    force: bool = False

    @model_validator(mode="after")
    def _names_one_action(self) -> Self:
        if (self.action_id is None) == (self.definition is None):
            raise ValueError("specify either action_id or definition")
        if self.version is not None and self.action_id is None:
            raise ValueError("only a published action has versions")
        return self


class Usage(Response):
    """Resource usage of a run. `memory_bytes` is the current value, `peak_memory_bytes` the maximum."""

    cpu_s: Annotated[float, Field(ge=0)]
    memory_bytes: Annotated[int, Field(ge=0)]
    peak_memory_bytes: Annotated[int, Field(ge=0)]
    read_bytes: Annotated[int, Field(ge=0)]
    written_bytes: Annotated[int, Field(ge=0)]


class UsageSample(Response):
    """Resource usage of a run `at_s` seconds after its start."""

    at_s: Annotated[float, Field(ge=0)]
    usage: Usage


class RunRecord(Request):
    """A run that was executed elsewhere, such as by Snakemake or a job of a cluster, with its results.

    `script` is the text that was executed, for people to read. `inputs` and `outputs` are paths of files of the
    mission; the caller has uploaded the outputs, which become files that the run made. Recording the same again, with
    the same bytes, returns the same run.
    """

    mission_id: uuid.UUID
    name: Name
    script: Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=MAX_SCRIPT_CHARACTERS)]
    parameters: ParameterValues = {}
    inputs: Annotated[list[FilePath], Field(min_length=1, max_length=MAX_RECORDED_FILES)]
    outputs: Annotated[list[FilePath], Field(max_length=MAX_RECORDED_FILES)] = []
    report: Report = Report()
    duration_s: Annotated[float, Field(ge=0, le=365 * 86_400)] | None = None

    @model_validator(mode="after")
    def _reports_no_artifacts(self) -> Self:
        if self.report.previews or self.report.mission_files:
            raise ValueError("a recorded run has outputs instead of previews and mission_files")
        if both := sorted({*self.inputs} & {*self.outputs}):
            raise ValueError(f"{both[0]!r} is both an input and an output")
        return self


class RunPlacement(Response):
    """Where a run is on its cluster or machine, and what that measured.

    `job_id` is the cluster's own, such as `4711` or `4711_3` of Slurm. `queued_s` is how long its job waited there.
    `gpus` are the devices that it has, by id. `cpu_s` and `peak_memory_bytes` are from the accounting of the cluster.
    `requeues` is how often the cluster started it again.
    """

    job_id: Annotated[str, Field(max_length=200)] | None = None
    node: Annotated[str, Field(max_length=300)] | None = None
    queued_s: Annotated[float, Field(ge=0)] | None = None
    gpus: Annotated[list[Annotated[str, Field(max_length=200)]], Field(max_length=64)] = []
    cpu_s: Annotated[float, Field(ge=0)] | None = None
    peak_memory_bytes: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    requeues: Annotated[int, Field(ge=0, lt=2**31)] = 0


class RunRead(Response):
    """A run of an action on a mission.

    `reason`, `message` and `exit_code` describe how it ended, `waits_for` why it is still queued. `image_digest` is of
    the image that was run. `reuses_id` is the earlier run whose results this run reuses; it has none of its own.
    `verdict` is the worst of what its report says: its verdict, checks and findings. Null where it is not `done`, and
    where it judged nothing. `metrics` are the first reported ones, those of the run before those of single files; empty
    in a lineage. `isolation` is the class that its runner gave it; null before a runner has it, and where that was not
    recorded yet. `placement` is null before its runner reports one. `is_recorded`: it was executed elsewhere, and
    recorded with its results. `may_cancel`: the caller may cancel it, and it has not ended.
    """

    id: uuid.UUID
    mission: MissionRef
    action: ActionRef
    version_id: uuid.UUID
    network: Network
    parameters: ParameterValues
    state: RunState
    reason: EndReason | None
    message: str
    exit_code: int | None
    waits_for: str | None
    progress: Progress | None
    attempt: int
    priority: RunPriority = RunPriority.normal
    cause: Cause
    runner: str | None
    isolation: Isolation | None = None
    placement: RunPlacement | None = None
    image_digest: str | None
    usage: Usage | None
    input_count: int
    input_bytes: int
    artifact_count: int
    verdict: ReportedVerdict | None = None
    check_counts: dict[CheckStatus, int] = {}
    finding_counts: dict[Severity, int]
    metric_count: int
    metrics: Annotated[list[Metric], Field(max_length=MAX_LISTED_METRICS)] = []
    reuses_id: uuid.UUID | None
    is_recorded: bool = False
    created_at: datetime.datetime
    claimed_at: datetime.datetime | None
    started_at: datetime.datetime | None
    ended_at: datetime.datetime | None
    cancel_requested_at: datetime.datetime | None
    may_cancel: bool


class RunDetail(RunRead):
    """A run with its details. `problems` name the results that could not be stored.

    `metadata` is what the run proposes for the mission. There are at most 720 `samples`. `packages` are the versions in
    the lock of its definition, such as `evo==1.38.1`; the lock itself is left out, since it is large.
    """

    definition: ActionDefinition
    packages: list[str] = []
    problems: list[str]
    metadata: Metadata
    previews: list[Preview]
    samples: list[UsageSample]


class RunCreated(Response):
    """A run that was created; one that reuses results has already ended."""

    outcome: Literal["created"] = "created"
    run: RunRead


class RunRefused(Response):
    """Why no run was created on a mission; runs on the other missions were."""

    outcome: Literal["refused"] = "refused"
    mission_id: uuid.UUID
    problem: ProblemDocument


class RunsCreated(Response):
    """One outcome per mission, in the requested order."""

    items: list[Annotated[RunCreated | RunRefused, Field(discriminator="outcome")]]


class RunFilter(LocationFilter):
    """A filter for runs: all criteria must match. `action` may be a glob of the name.

    Of several projects, missions, states or verdicts, any may match. `job_id` is that of a cluster, `node` a node or
    machine; `isolation` the class that runs had.
    """

    action_id: uuid.UUID | None = None
    action: Term | None = None
    state: Annotated[list[RunState], Field(max_length=len(RunState))] = []
    verdict: Annotated[list[ReportedVerdict], Field(max_length=3)] = []
    job_id: Term | None = None
    node: Term | None = None
    isolation: Annotated[list[Isolation], Field(max_length=len(Isolation))] = []
    active: bool | None = None
    mine: bool = False


class RunInput(Response):
    """An input of a run, as it was at launch. `file_id` is null where the file no longer exists."""

    path: str
    size_bytes: int
    sha256: str
    file_id: uuid.UUID | None


class ArtifactRead(Response):
    """A file that a run produced. `file_id` is the file of the mission that was created from it, if any."""

    id: uuid.UUID
    run_id: uuid.UUID
    path: str
    size_bytes: int
    sha256: str
    file_id: uuid.UUID | None


class ArtifactUrl(Response):
    """A URL to GET an artifact from before `expires_at`."""

    artifact: ArtifactRead
    url: str
    expires_at: datetime.datetime


class ArtifactsRequest(Request):
    """Artifacts of a run to download or preview; the audit log contains the purpose."""

    artifact_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=500)]
    purpose: FetchPurpose = FetchPurpose.download


class ArtifactUrls(Response):
    """URLs of artifacts, in the requested order."""

    items: list[ArtifactUrl]


class _FromRun(Response):
    id: int
    run_id: uuid.UUID
    mission: MissionRef
    action: ActionRef
    parameters: ParameterValues
    ended_at: datetime.datetime | None


class CheckRead(_FromRun):
    """A check, and the run that reported it with its parameters."""

    check: Check


class FindingRead(_FromRun):
    """A finding, and the run that reported it with its parameters."""

    finding: Finding


class MetricRead(_FromRun):
    """A metric, and the run that reported it with its parameters."""

    metric: Metric


class ReportFilter(LocationFilter):
    """What filters for checks, findings and metrics have in common. `action` and `topic` may be globs.

    `latest`: only of the latest run that is done, of each mission and action with the same parameters.
    """

    run_id: uuid.UUID | None = None
    action_id: uuid.UUID | None = None
    action: Term | None = None
    version: Annotated[int, Field(ge=1, lt=2**31)] | None = None
    topic: Term | None = None
    latest: bool = False


class CheckFilter(ReportFilter):
    """A filter for the checks that runs reported. `name` may be a glob."""

    name: Term | None = None
    status: Annotated[list[CheckStatus], Field(max_length=len(CheckStatus))] = []


class FindingFilter(ReportFilter):
    """A filter for findings. `code` may be a glob."""

    code: Term | None = None
    severity: Annotated[list[Severity], Field(max_length=len(Severity))] = []


class MetricFilter(ReportFilter):
    """A filter for metrics. `name` may be a glob."""

    name: Term | None = None


class LogChunkRead(Response):
    """A chunk of the log of a run from the byte `offset` on; the next one begins at `next_offset`.

    It ends with a complete line, unless the log ends or the line is very long. `is_over`: the log ends there.
    """

    attempt: int
    offset: int
    next_offset: int
    text: str
    is_over: bool


class LineageFile(Response):
    """A file in a lineage. `id` is null where it no longer exists or is not visible to the reader."""

    id: uuid.UUID | None
    path: str
    sha256: str


class LineageRun(Response):
    """A run in a lineage: its inputs, and the files of the mission that were created from its artifacts."""

    run: RunRead
    inputs: list[LineageFile]
    files: list[LineageFile]
    artifact_count: int


class LineageRead(Response):
    """The run that produced a file and the runs that read it; `truncated` where more runs read it."""

    file: LineageFile
    made_by: LineageRun | None
    read_by: list[LineageRun]
    truncated: bool
