"""What admins see of the whole server: its store, its jobs, its health, its settings."""

import datetime
import uuid
from typing import Any

from kleinkram.contract.base import Response
from kleinkram.contract.home import StoreUse


class StateAmount(Response):
    """So many blobs, or uploads, in a state, and their bytes."""

    state: str
    count: int
    size_bytes: int


class AdminStorage(Response):
    """Stored blobs by state, those that only the trash uses, uploads in progress, and what is about to be deleted.

    A blob counts once, however many files are made of it.
    """

    store: StoreUse
    is_low: bool
    blobs: list[StateAmount]
    trash: StateAmount
    uploads: StateAmount
    marked_for_deletion: StateAmount


class JobAmount(Response):
    """So many jobs of a kind in a state: `todo`, `doing` or `failed`; `oldest_at` is since when the oldest waits."""

    kind: str
    state: str
    count: int
    oldest_at: datetime.datetime | None


class FailedJob(Response):
    """A job that was given up. `ref` is the id of what it was for; `error` says why, where that could be kept, and the
    worker's log says more.
    """

    id: int
    kind: str
    ref: str | None
    attempts: int
    failed_at: datetime.datetime | None
    error: str | None


class RetryingJob(Response):
    """A job that failed and waits for another attempt. `error` says why the last one failed."""

    id: int
    kind: str
    ref: str | None
    attempts: int
    next_attempt_at: datetime.datetime | None
    error: str | None


class AdminJobs(Response):
    """The queue; jobs that wait for another attempt, and those that were given up last, at most 100 of each.

    A job that was given up is forgotten after a week.
    """

    queue: list[JobAmount]
    failed: list[FailedJob]
    retrying: list[RetryingJob]


class RetriedJobs(Response):
    """How many jobs that were given up are in the queue again."""

    count: int


class AdminHealth(Response):
    """How the server is.

    `not_ready`: what keeps it from serving; `warnings`: what does not, but needs somebody to look at it. `workers_at`:
    when each worker process that is alive was last heard of; `worker_last_at`: when any was.
    `runs_problem`: why runs cannot start, and what to do; null where they can, or where no runner was ever started.
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
    store_writes_once: bool
    store_takes_pages: bool


class ScrubRequest(Response):
    """A scrub to be asked for. `believe`: whoever asks has looked, and objects that are missing are gone indeed."""

    believe: bool = False


class ScrubRead(Response):
    """One comparison of what the store lists with what the database knows of it.

    `lost` and `corrupt` are blobs newly found so, `recovered` lost ones whose objects are there again and are being
    verified, `unknown` objects that the database does not know. `stopped` says why it marked nothing, or ended early.
    Until it has `ended_at`, all this is of what it has compared so far.
    """

    id: uuid.UUID
    created_at: datetime.datetime
    started_at: datetime.datetime | None
    seen_at: datetime.datetime
    ended_at: datetime.datetime | None
    stopped: str | None
    compared: int
    compared_bytes: int
    lost: int
    corrupt: int
    recovered: int
    unknown: int


class ScrubState(Response):
    """The last scrub, if there was one, and how many blobs are in which state now, each with their bytes.

    Of the lost and corrupt those count that something still refers to.

    `oldest_verification_at` is the oldest `verified_at` of all blobs. A blob is verified again `again_after_days` days
    after its last verification.
    """

    last: ScrubRead | None
    every_hours: float
    again_after_days: int
    oldest_verification_at: datetime.datetime | None
    blobs: list[StateAmount]


class SettingRead(Response):
    """One setting in force. `is_set`: by the environment, else it is the default. A secret has no value here."""

    name: str
    value: Any
    is_set: bool
    is_secret: bool


class AdminSettings(Response):
    """The settings of the process that answered, by name."""

    settings: list[SettingRead]
