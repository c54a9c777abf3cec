"""Runs: executions of an action on a mission, and what they say and leave."""

import datetime
import enum
import uuid
from typing import Annotated, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from kleinkram.contract.actions import ActionDefinition, Network, ParameterValues
from kleinkram.contract.files import FileRead, RecordingRead, TopicRead
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.missions import MissionRead, MissionRef
from kleinkram.contract.names import Ids, Term
from kleinkram.contract.people import PersonRef
from kleinkram.contract.problems import ProblemDocument
from kleinkram.contract.reports import Finding, Metric, Preview, Progress, Severity
from kleinkram.contract.wire import Request, Response

CONTEXT_FILE = "mission.json"
MAX_LAUNCHED = 1000
MAX_SAMPLES = 720
# Metrics that a run in a list carries.
MAX_LISTED_METRICS = 12
# What a run may write to stdout and stderr; what comes after is dropped, and the log says so.
LOG_BYTES = 100 * 2**20


class RunState(str, enum.Enum):
    """Where a run is. `preparing` fetches image and inputs, `collecting` keeps what it left; three are ends."""

    queued = "queued"
    preparing = "preparing"
    running = "running"
    collecting = "collecting"
    done = "done"
    failed = "failed"
    cancelled = "cancelled"


class EndReason(str, enum.Enum):
    """Why a run is over. `exit_code`: the command said so itself; all after it are not the command's word."""

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
    results_not_kept = "results_not_kept"
    lost = "lost"


class ActionRef(Response):
    """An action in one version; id and version are null where it is run from a folder that nobody has published."""

    id: uuid.UUID | None = None
    name: str
    version: Annotated[int, Field(ge=1)] | None


class Cause(Response):
    """Why a run is: who asked for it, and of which run it is another try."""

    person: PersonRef | None = None
    retry_of_id: uuid.UUID | None = None


class RunContext(Response):
    """What `/in/mission.json` says: the mission, the files that the run gets with what is known of them, and its task.

    `run_id` is null where no server knows of the run. `topics` are of the files, `recordings` of the mission.
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


class RunsCreate(Request):
    """An action to run on each of some missions: a published one by its id, in its latest version unless another is
    named; or as a definition, which is then run without being published.

    Results of an earlier good run of the very same (version, image, parameters, inputs) are reused unless `force`.
    """

    mission_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=MAX_LAUNCHED)]
    action_id: uuid.UUID | None = None
    version: Annotated[int, Field(ge=1, lt=2**31)] | None = None
    definition: ActionDefinition | None = None
    parameters: ParameterValues = {}
    force: bool = False

    @model_validator(mode="after")
    def _names_one_action(self) -> Self:
        if (self.action_id is None) == (self.definition is None):
            raise ValueError("say action_id or definition, and not both")
        if self.version is not None and self.action_id is None:
            raise ValueError("only a published action has versions")
        return self


class Usage(Response):
    """What a run has used so far. `memory_bytes` is now, `peak_memory_bytes` the most seen."""

    cpu_s: Annotated[float, Field(ge=0)]
    memory_bytes: Annotated[int, Field(ge=0)]
    peak_memory_bytes: Annotated[int, Field(ge=0)]
    read_bytes: Annotated[int, Field(ge=0)]
    written_bytes: Annotated[int, Field(ge=0)]


class Sample(Response):
    """What a run used at some moment, `at_s` after its container was started."""

    at_s: Annotated[float, Field(ge=0)]
    usage: Usage


class RunRead(Response):
    """A run.

    `reason`, `message` and `exit_code` say how it ended; `waits_for` why it has not begun. `image_digest` is of the
    image that was run. `reuses_id` names the earlier run whose results stand for this one's, which has none itself.
    `metrics` are the first that it reported, those of the whole run before those of one file; empty in a lineage.
    `may_cancel`: the asker may, and it is not over.
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
    cause: Cause
    runner: str | None
    image_digest: str | None
    usage: Usage | None
    input_count: int
    input_bytes: int
    artifact_count: int
    finding_counts: dict[Severity, int]
    metric_count: int
    metrics: Annotated[list[Metric], Field(max_length=MAX_LISTED_METRICS)] = []
    reuses_id: uuid.UUID | None
    created_at: datetime.datetime
    claimed_at: datetime.datetime | None
    started_at: datetime.datetime | None
    ended_at: datetime.datetime | None
    cancel_requested_at: datetime.datetime | None
    may_cancel: bool


class RunDetail(RunRead):
    """A run with all that fits one answer. `problems` say what of its words or files could not be taken.

    `metadata` is what it proposes for the mission. `samples` are thinned out: at most 720.
    """

    definition: ActionDefinition
    problems: list[str]
    metadata: Metadata
    previews: list[Preview]
    samples: list[Sample]


class RunMade(Response):
    """A run that was made; one that reuses results is over already."""

    outcome: Literal["made"] = "made"
    run: RunRead


class RunRefused(Response):
    """Why no run was made on a mission; those on the others were."""

    outcome: Literal["refused"] = "refused"
    mission_id: uuid.UUID
    problem: ProblemDocument


class RunsMade(Response):
    """One outcome a mission, in the order asked."""

    items: list[Annotated[RunMade | RunRefused, Field(discriminator="outcome")]]


class RunFilter(Request):
    """Which runs are wanted: those that satisfy all that is given. `action` may be a glob of its name.

    Of several projects, or several missions, any may hold.
    """

    project_id: uuid.UUID | None = None
    project_ids: Ids = []
    mission_id: uuid.UUID | None = None
    mission_ids: Ids = []
    action_id: uuid.UUID | None = None
    action: Term | None = None
    state: Annotated[list[RunState], Field(max_length=len(RunState))] = []
    active: bool | None = None
    mine: bool = False


class RunInput(Response):
    """A file that a run was given, as it was then. `file_id` is null where it is no longer there."""

    path: str
    size_bytes: int
    sha256: str
    file_id: uuid.UUID | None


class ArtifactRead(Response):
    """A file that a run left. `file_id` is that of the mission's file that was made of it, where one was."""

    id: uuid.UUID
    run_id: uuid.UUID
    path: str
    size_bytes: int
    sha256: str
    file_id: uuid.UUID | None


class ArtifactUrl(Response):
    """Where to GET an artifact, before `expires_at`."""

    artifact: ArtifactRead
    url: str
    expires_at: datetime.datetime


class ArtifactsRequest(Request):
    """Artifacts of a run to fetch."""

    artifact_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=500)]


class ArtifactUrls(Response):
    """Where to fetch them, in the order asked."""

    items: list[ArtifactUrl]


class FindingRead(Response):
    """A finding, and the run that said it."""

    id: int
    run_id: uuid.UUID
    mission: MissionRef
    action: ActionRef
    finding: Finding


class MetricRead(Response):
    """A metric, and the run that said it."""

    id: int
    run_id: uuid.UUID
    mission: MissionRef
    action: ActionRef
    metric: Metric


class SayingFilter(Request):
    """Which findings or metrics are wanted. `code` (a metric's name) may be a glob; any of several places may hold."""

    run_id: uuid.UUID | None = None
    mission_id: uuid.UUID | None = None
    mission_ids: Ids = []
    project_id: uuid.UUID | None = None
    project_ids: Ids = []
    code: Term | None = None
    severity: Annotated[list[Severity], Field(max_length=len(Severity))] = []


class LogPiece(Response):
    """A piece of what a run wrote, from the byte `offset` on; the next one begins at `next_offset`.

    It ends with a whole line, unless the log ends or a line is very long. `is_over`: nothing comes after `next_offset`.
    """

    attempt: int
    offset: int
    next_offset: int
    text: str
    is_over: bool


class LineageFile(Response):
    """A file in a lineage. `id` is null where it is no longer there, or not for the asker."""

    id: uuid.UUID | None
    path: str
    sha256: str


class LineageRun(Response):
    """A run in a lineage: what it was given, and the files of the mission and the artifacts that it made."""

    run: RunRead
    inputs: list[LineageFile]
    files: list[LineageFile]
    artifact_count: int


class LineageRead(Response):
    """Where a file comes from and what came from it, one step each way; `truncated` where more runs read it."""

    file: LineageFile
    made_by: LineageRun | None
    read_by: list[LineageRun]
    truncated: bool
