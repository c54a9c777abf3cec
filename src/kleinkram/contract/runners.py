"""What runners and the server say to each other. A runner asks, over HTTPS, with a runner's token; nothing calls it.

All that it says about a run carries the attempt by which it holds the run, and is refused once another one counts.
"""

import datetime
import enum
import uuid
from typing import Annotated

from pydantic import Field

from kleinkram.contract.actions import Network, ParameterValues, Resources
from kleinkram.contract.names import Label
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.reports import Progress, Report
from kleinkram.contract.runs import ActionRef, EndReason, RunState, Sample, Usage
from kleinkram.contract.uploads import Crc64, Sha256, UploadFile
from kleinkram.contract.wire import Request, Response

# A run is held for so long after its runner was last heard of, by the database's clock.
LEASE_S = 60
# So often a runner says what its runs are at; so soon it hears that one is to be cancelled.
BEAT_S = 2.0
MAX_WAIT_S = 25
# The path of a run's whole log among what a runner sends at its end; no artifact can have it.
LOG_PATH = ".kleinkram/log"

Attempt = Annotated[int, Field(ge=1, lt=2**31)]


class Isolation(str, enum.Enum):
    """How well a run is kept away from its machine and from others."""

    container = "container"
    namespaces = "namespaces"
    none = "none"


class Abilities(Response):
    """What an executor can do. `images`: run container images, not only scripts."""

    executor: Annotated[str, Field(pattern=r"^[a-z]{1,32}$")]
    isolation: Isolation
    images: bool
    networks: frozenset[Network]
    gpus: bool
    bounds_memory: bool
    bounds_disk: bool


class Capacity(Response):
    """What a machine has, or has free, for runs."""

    cores: Annotated[float, Field(ge=0, le=100_000)]
    memory_bytes: Annotated[int, Field(ge=0, lt=2**63)]
    disk_bytes: Annotated[int, Field(ge=0, lt=2**63)]
    gpus: Annotated[int, Field(ge=0, le=1000)]


class RunnerHello(Request):
    """A runner says what it is, whenever it starts. `id` is its own for good: it keeps it in its folder.

    `stock_image` is the digest of the image that it runs scripts on; null where it has none.
    """

    id: uuid.UUID
    name: Label
    labels: Annotated[list[Label], Field(max_length=50)] = []
    capacity: Capacity
    abilities: Abilities
    stock_image: Annotated[str, Field(max_length=200)] | None = None
    version: Annotated[str, Field(max_length=64)]


class RunnerToken(Response):
    """The token of a runner, and what it is limited to: runs on these projects, that ask for one of these labels.

    `projects` and `labels` are null where it is not limited by them.
    """

    id: uuid.UUID
    name: str
    expires_at: datetime.datetime | None
    projects: list[ProjectRef] | None
    labels: list[str] | None


class RunnerRead(Response):
    """A runner, as admins see it. `token` is null until it says hello again after an update of the server."""

    id: uuid.UUID
    name: str
    labels: list[str]
    capacity: Capacity
    abilities: Abilities
    stock_image: str | None
    version: str
    last_seen_at: datetime.datetime
    is_alive: bool
    active_runs: int
    token: RunnerToken | None = None


class ClaimAsk(Request):
    """What is free for a further run, and how long to wait for one. `held`: the runs that the runner knows it has."""

    free: Capacity
    wait_s: Annotated[float, Field(ge=0, le=MAX_WAIT_S)] = 0
    held: Annotated[list[uuid.UUID], Field(max_length=10_000)] = []


class ClaimInput(Response):
    """A file that a run is given."""

    path: str
    size_bytes: int
    sha256: Sha256


class Claim(Response):
    """A run that is this runner's until its lease ends.

    `image_digest` is what the image's name was first resolved to, by whichever runner: no other may be run under it.
    `token` is there unless the network is `none`: it is the run's own, and good as long as the run lasts.
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
    parameters: ParameterValues
    resources: Resources
    network: Network
    inputs: list[ClaimInput]
    token: Annotated[str | None, Field(repr=False)]
    lease_s: float


class Claimed(Response):
    """The answer to a claim; null where nothing came that fits."""

    claim: Claim | None


class Beat(Request):
    """What one run is at. `started`: its container was. Samples are those since the last beat."""

    run_id: uuid.UUID
    attempt: Attempt
    state: RunState
    progress: Progress | None = None
    image_digest: Annotated[str, Field(max_length=200)] | None = None
    usage: Usage | None = None
    samples: Annotated[list[Sample], Field(max_length=100)] = []


class Beats(Request):
    """What all runs of a runner are at."""

    runs: Annotated[list[Beat], Field(max_length=1000)]


class Verdict(str, enum.Enum):
    """What becomes of a run: it goes on, it is to be ended because somebody says so, or it is not this runner's."""

    go_on = "go_on"
    cancel = "cancel"
    gone = "gone"


class BeatAnswer(Response):
    """What becomes of one run."""

    run_id: uuid.UUID
    attempt: Attempt
    verdict: Verdict


class BeatAnswers(Response):
    """What becomes of each, and how long they are held from now on."""

    runs: list[BeatAnswer]
    lease_s: float


class InputsAsk(Request):
    """Inputs to be fetched."""

    attempt: Attempt
    paths: Annotated[list[Annotated[str, Field(max_length=1024)]], Field(min_length=1, max_length=1000)]


class InputUrls(Response):
    """Where to GET each, in the order asked, before `expires_at`."""

    urls: list[str]
    expires_at: datetime.datetime


class SegmentAsk(Request):
    """A piece of the log about to be stored: where it begins in the log, its size, and its checksums."""

    attempt: Attempt
    offset: Annotated[int, Field(ge=0, lt=2**40)]
    size_bytes: Annotated[int, Field(ge=1, le=8 * 2**20)]
    sha256: Sha256
    crc64nvme: Crc64
    md5: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]


class SegmentPut(Response):
    """PUT the piece's bytes to `url` with exactly these headers, then say so."""

    url: str
    headers: dict[str, str]


class SegmentKept(Request):
    """A piece of the log that was stored: from now on people see it."""

    attempt: Attempt
    offset: Annotated[int, Field(ge=0, lt=2**40)]
    size_bytes: Annotated[int, Field(ge=1, le=8 * 2**20)]


class ArtifactsBegin(Request):
    """Artifacts to upload, and the whole log under `LOG_PATH`: by the same protocol as files of a mission."""

    attempt: Attempt
    files: Annotated[list[UploadFile], Field(min_length=1, max_length=200)]


class RunFinish(Request):
    """How a run ended, once all that it left is uploaded. Said again, the same answer comes."""

    attempt: Attempt
    reason: EndReason
    message: Annotated[str, Field(max_length=2000)]
    exit_code: Annotated[int, Field(ge=-(2**31), lt=2**31)] | None = None
    report: Report = Report()
    problems: Annotated[list[Annotated[str, Field(max_length=2000)]], Field(max_length=200)] = []
    usage: Usage | None = None
    samples: Annotated[list[Sample], Field(max_length=100)] = []


class RunFinished(Response):
    """What became of the run."""

    state: RunState
