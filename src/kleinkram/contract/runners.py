"""The protocol between runners and the server: HTTPS requests that a runner makes with its token; nothing calls it.

Every request about a run carries the attempt number of the runner's lease and is refused once that is outdated.
"""

import base64
import datetime
import enum
import uuid
from typing import Annotated

from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema

from kleinkram.contract.actions import ClusterRequest, Network, ParameterValues, Resources
from kleinkram.contract.base import Request, Response
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.names import Label
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.reports import Progress, Report
from kleinkram.contract.runs import ActionRef, EndReason, RunContext, RunPlacement, RunState, Usage, UsageSample
from kleinkram.contract.uploads import Crc64, Sha256, UploadFile

# The usual length of a lease, by the database's clock; every heartbeat renews it.
LEASE_S = 60
# The longest: jobs of a cluster go on while its login node is restarted.
MAX_LEASE_S = 3600
# The interval of heartbeats, and so the delay with which a runner learns of a cancellation. With hundreds of runs, it
# is up to twice as long.
HEARTBEAT_S = 2.0
MAX_WAIT_S = 25
# The most runs that one claim assigns.
MAX_CLAIMED = 100
# The most runs whose contexts are requested, or whose ends are reported, at once.
MAX_RUNS = 100
# A log of at most this size is part of the report of the end of its run.
SMALL_LOG_BYTES = 32 * 1024
# The path under which a runner uploads the complete log of a run, unless it is small; no artifact can have it.
LOG_PATH = ".kleinkram/log"

Attempt = Annotated[int, Field(ge=1, lt=2**31)]


def _from_base64(value: object) -> object:
    return base64.b64decode(value, validate=True) if isinstance(value, str) else value


SmallLog = Annotated[
    bytes,
    Field(max_length=SMALL_LOG_BYTES),
    BeforeValidator(_from_base64),
    PlainSerializer(lambda value: base64.b64encode(value).decode(), when_used="json"),
    WithJsonSchema({"type": "string", "contentEncoding": "base64", "maxLength": 4 * (SMALL_LOG_BYTES // 3 + 1)}),
]


class ExecutorAbilities(Response):
    """What an executor supports.

    `images`: it runs container images, not only scripts. `environments`: it installs locked dependencies of scripts.
    """

    executor: Annotated[str, Field(pattern=r"^[a-z]{1,32}$")]
    isolation: Isolation
    images: bool
    networks: frozenset[Network]
    gpus: bool
    bounds_memory: bool
    bounds_disk: bool
    environments: bool = False


class Capacity(Response):
    """Resources of a machine for runs: all of them, or those that are free."""

    cores: Annotated[float, Field(ge=0, le=100_000)]
    memory_bytes: Annotated[int, Field(ge=0, lt=2**63)]
    disk_bytes: Annotated[int, Field(ge=0, lt=2**63)]
    gpus: Annotated[int, Field(ge=0, le=1000)]


class RunnerRegistration(Request):
    """A runner's description of itself, sent at each start. `id` is permanent, and stored in its state directory.

    `default_image` is the digest of the image that it runs scripts on; null where it has none. `lease_s` is how long
    its runs may go on without news from it. `capacity` is the largest that a single run may ask for.
    """

    id: uuid.UUID
    name: Label
    labels: Annotated[list[Label], Field(max_length=50)] = []
    capacity: Capacity
    lease_s: Annotated[int, Field(ge=LEASE_S, le=MAX_LEASE_S)] = LEASE_S
    abilities: ExecutorAbilities
    default_image: Annotated[str, Field(max_length=200)] | None = None
    version: Annotated[str, Field(max_length=64)]


class RunnerToken(Response):
    """The token of a runner and its limits: runs of these projects that require one of these labels; null: any."""

    id: uuid.UUID
    name: str
    expires_at: datetime.datetime | None
    projects: list[ProjectRef] | None
    labels: list[str] | None


class RunnerRead(Response):
    """A runner, as admins see it. `token` is null until it registers again after an update of the server.

    `lease_s` is how long its runs may go on without news from it.
    """

    id: uuid.UUID
    name: str
    labels: list[str]
    capacity: Capacity
    abilities: ExecutorAbilities
    default_image: str | None
    lease_s: int = LEASE_S
    version: str
    last_seen_at: datetime.datetime
    is_alive: bool
    active_runs: int
    token: RunnerToken | None = None


class ClaimRequest(Request):
    """A runner's free resources, and how long to wait for a run. `active_run_ids`: the runs that it already has.

    At most `max_runs` are assigned at once; each of them may need all of the free resources, so that a runner with room
    for one at a time asks for one.
    """

    free: Capacity
    max_runs: Annotated[int, Field(ge=1, le=MAX_CLAIMED)] = 1
    wait_s: Annotated[float, Field(ge=0, le=MAX_WAIT_S)] = 0
    active_run_ids: Annotated[list[uuid.UUID], Field(max_length=10_000)] = []


class AssignedInput(Response):
    """An input file of a run."""

    path: str
    size_bytes: int
    sha256: Sha256


class RunAssignment(Response):
    """A run that is leased to a runner.

    `image_digest` is what the image's name was first resolved to, by any runner: only that image may be run.
    `token` is the run's own and valid while the run lasts; null where the network is `none`. `traceparent` (W3C Trace
    Context) is the trace that the run belongs to, if the server exports traces.
    """

    run_id: uuid.UUID
    attempt: Attempt
    project_id: uuid.UUID
    mission_id: uuid.UUID
    action: ActionRef
    image: str | None
    image_digest: str | None
    command: list[str]
    script: str | None
    dependencies: list[str]
    requires_python: str | None = None
    lock: str | None = None
    parameters: ParameterValues
    resources: Resources
    cluster: ClusterRequest = ClusterRequest()
    network: Network
    inputs: list[AssignedInput]
    token: Annotated[str | None, Field(repr=False)]
    lease_s: float
    traceparent: str | None = None


class ClaimReply(Response):
    """The answer to a claim; `run` is null where no run fits. `more` are those beyond the first."""

    run: RunAssignment | None
    more: list[RunAssignment] = []


class Heartbeat(Request):
    """The state of one run. `samples` are those since the last heartbeat."""

    run_id: uuid.UUID
    attempt: Attempt
    state: RunState
    progress: Progress | None = None
    image_digest: Annotated[str, Field(max_length=200)] | None = None
    placement: RunPlacement | None = None
    usage: Usage | None = None
    samples: Annotated[list[UsageSample], Field(max_length=100)] = []


class RunAttempt(Request):
    """A run, and the attempt of the runner's lease."""

    run_id: uuid.UUID
    attempt: Attempt


class Heartbeats(Request):
    """The states of all runs of a runner. `unchanged`: those of which an earlier heartbeat said all that is known."""

    runs: Annotated[list[Heartbeat], Field(max_length=1000)]
    unchanged: Annotated[list[RunAttempt], Field(max_length=10_000)] = []


class LeaseStatus(str, enum.Enum):
    """The lease of a run: renewed; renewed, and the run is to be cancelled; or no longer this runner's."""

    active = "active"
    cancel = "cancel"
    lost = "lost"


class HeartbeatReply(Response):
    """The lease of one run."""

    run_id: uuid.UUID
    attempt: Attempt
    status: LeaseStatus


class HeartbeatReplies(Response):
    """The leases of runs, and their length from now on. Those of unchanged runs without a reply are active."""

    runs: list[HeartbeatReply]
    lease_s: float


class InputsRequest(Request):
    """Inputs to fetch."""

    attempt: Attempt
    paths: Annotated[list[Annotated[str, Field(max_length=1024)]], Field(min_length=1, max_length=1000)]


class InputUrls(Response):
    """URLs to GET the inputs from before `expires_at`, in the requested order."""

    urls: list[str]
    expires_at: datetime.datetime


class LogChunkCreate(Request):
    """A chunk of the log to upload: its offset in the log, its size and its checksums."""

    attempt: Attempt
    offset: Annotated[int, Field(ge=0, lt=2**40)]
    size_bytes: Annotated[int, Field(ge=1, le=8 * 2**20)]
    sha256: Sha256
    crc64nvme: Crc64
    md5: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]


class LogChunkUpload(Response):
    """Where to PUT the bytes of a chunk, with exactly these headers; confirm the chunk afterwards."""

    url: str
    headers: dict[str, str]


class LogChunkConfirm(Request):
    """A chunk of the log that was uploaded and becomes visible."""

    attempt: Attempt
    offset: Annotated[int, Field(ge=0, lt=2**40)]
    size_bytes: Annotated[int, Field(ge=1, le=8 * 2**20)]


class ArtifactUploadsCreate(Request):
    """Artifacts to upload, and the complete log as `LOG_PATH`, by the same protocol as files of a mission."""

    attempt: Attempt
    files: Annotated[list[UploadFile], Field(min_length=1, max_length=200)]


class RunFinish(Request):
    """How a run ended, sent once its artifacts are uploaded. Idempotent.

    `log`: the complete log, if it is small and was not uploaded.
    """

    attempt: Attempt
    reason: EndReason
    message: Annotated[str, Field(max_length=2000)]
    exit_code: Annotated[int, Field(ge=-(2**31), lt=2**31)] | None = None
    image_digest: Annotated[str, Field(max_length=200)] | None = None
    report: Report = Report()
    problems: Annotated[list[Annotated[str, Field(max_length=2000)]], Field(max_length=200)] = []
    placement: RunPlacement | None = None
    usage: Usage | None = None
    samples: Annotated[list[UsageSample], Field(max_length=100)] = []
    log: SmallLog | None = None


class RunFinished(Response):
    """The final state of a run."""

    state: RunState


class RunEnd(Request):
    """The end of one of several runs."""

    run_id: uuid.UUID
    finish: RunFinish


class RunEnds(Request):
    """The ends of several runs of a runner."""

    ends: Annotated[list[RunEnd], Field(min_length=1, max_length=MAX_RUNS)]


class RunEndsRecorded(Response):
    """The final states of runs, in the order sent; null for a run that the runner does not have by this attempt."""

    states: list[RunState | None]


class ContextsRequest(Request):
    """Runs whose contexts are requested."""

    runs: Annotated[list[RunAttempt], Field(min_length=1, max_length=MAX_RUNS)]


class RunContexts(Response):
    """The contents of `/in/mission.json`, in the order requested; null for a run that the runner does not have."""

    contexts: list[RunContext | None]
