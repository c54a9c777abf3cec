"""The state of the server for admins: store, jobs, health, scrubs and settings."""

import datetime
import enum
import uuid
from typing import Any

from kleinkram.contract.base import Request, Response
from kleinkram.contract.home import StoreUse
from kleinkram.contract.projects import ProjectRef


class StateAmount(Response):
    """Number and bytes of the blobs or uploads in a state."""

    state: str
    count: int
    size_bytes: int


class AdminStorage(Response):
    """Stored blobs by state, those that only the trash uses, uploads in progress, and what is about to be deleted.

    A blob counts once, however many files have it.
    """

    store: StoreUse
    is_low: bool
    blobs: list[StateAmount]
    trash: StateAmount
    uploads: StateAmount
    marked_for_deletion: StateAmount


class JobAmount(Response):
    """Number of jobs of a kind in a state: `todo`, `doing` or `failed`; `oldest_at`: when the oldest was enqueued."""

    kind: str
    state: str
    count: int
    oldest_at: datetime.datetime | None


class _JobRead(Response):
    id: int
    kind: str
    ref: str | None
    attempts: int
    error: str | None


class FailedJob(_JobRead):
    """A job that failed for the last time. `ref` is the id of its object; the worker's log has more than `error`."""

    failed_at: datetime.datetime | None


class RetryingJob(_JobRead):
    """A job that failed and waits for another attempt. `error` is of the last one."""

    next_attempt_at: datetime.datetime | None


class AdminJobs(Response):
    """The queue, the jobs that wait for another attempt, and the last failed ones, at most 100 of each.

    Failed jobs are deleted after a week.
    """

    queue: list[JobAmount]
    failed: list[FailedJob]
    retrying: list[RetryingJob]


class RetriedJobs(Response):
    """The number of failed jobs that were requeued."""

    count: int


class AdminHealth(Response):
    """The state of the server.

    `not_ready`: why it cannot serve. `workers_at`: last heartbeat of each living worker; `worker_last_at`: of any.
    `runs_problem`: why runs cannot start, and what to do; null if they can, or if no runner was ever started.
    `invitation_warning`: what stops once a second person has an account, and what to do before.
    """

    not_ready: str | None
    warnings: list[str]
    version: str
    schema_version: str
    database_version: str
    database_bytes: int
    now: datetime.datetime
    clock_skew_s: float
    workers_at: list[datetime.datetime]
    worker_last_at: datetime.datetime | None
    runs_problem: str | None
    invitation_warning: str | None
    store_checksum: str
    store_refuses_overwrites: bool
    store_allows_browser_uploads: bool


class StatusSeverity(str, enum.Enum):
    """`problem`: something does not work, or data are damaged; `warning`: it will not work for long, or is late."""

    problem = "problem"
    warning = "warning"


class StatusItem(Response):
    """Something that an admin should attend to. `remedy` says what to do; empty if the message does."""

    severity: StatusSeverity
    subject: str
    message: str
    remedy: str


class CapacityUnit(str, enum.Enum):
    """What a limit counts."""

    bytes = "bytes"
    files = "files"


class CapacityForecast(Response):
    """A limit, and when it will be reached: the quota of a project, or the store's disk (`project` is null).

    `per_day` is the mean of the last 30 days, or of the project's or server's life if that is shorter: what was added
    and still exists. `full_at`: null if nothing is added, or for more than ten years.
    """

    project: ProjectRef | None
    unit: CapacityUnit
    used: int
    limit: int
    per_day: int
    full_at: datetime.datetime | None


class AdminStatus(Response):
    """Whether the server is healthy, what is full and when, and what needs an admin; problems come first.

    `capacities` are in the order in which they will be full. The store is one of them if its size is known:
    KLEINKRAM_STORE_FOLDER or KLEINKRAM_STORE_CAPACITY_BYTES.
    """

    now: datetime.datetime
    version: str
    is_healthy: bool
    items: list[StatusItem]
    stored_bytes: int
    stored_bytes_per_day: int
    capacities: list[CapacityForecast]


class ScrubRequest(Request):
    """A scrub to start. `accept_losses`: the admin has checked that missing objects are really gone."""

    accept_losses: bool = False


class ScrubRead(Response):
    """A comparison of the objects in the store with the database.

    `lost` and `corrupt`: newly detected blobs; `recovered`: lost ones whose objects are back and are being verified;
    `unknown`: objects that the database does not have. `aborted_reason`: why it marked nothing, or not all.
    Until `ended_at`, the numbers cover what was compared so far.
    """

    id: uuid.UUID
    created_at: datetime.datetime
    started_at: datetime.datetime | None
    seen_at: datetime.datetime
    ended_at: datetime.datetime | None
    aborted_reason: str | None
    compared: int
    compared_bytes: int
    lost: int
    corrupt: int
    recovered: int
    unknown: int


class ScrubState(Response):
    """The last scrub, if any, and the blobs by state; lost and corrupt ones count if something refers to them.

    `oldest_verification_at` is the oldest `verified_at` of all blobs; they are verified again after `again_after_days`.
    """

    last: ScrubRead | None
    every_hours: float
    again_after_days: int
    oldest_verification_at: datetime.datetime | None
    blobs: list[StateAmount]


class SettingRead(Response):
    """A setting in force. `is_set`: by the environment, otherwise the default. Secrets have no value here."""

    name: str
    value: Any
    is_set: bool
    is_secret: bool


class AdminSettings(Response):
    """The settings of the process that answered, by name."""

    settings: list[SettingRead]
