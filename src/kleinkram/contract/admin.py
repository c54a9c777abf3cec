"""What admins see of the whole server: its store, its jobs, its health, its settings."""

import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict

from kleinkram.contract.home import StoreUse


class _Told(BaseModel):
    model_config = ConfigDict(frozen=True)


class StateAmount(_Told):
    """So many blobs, or uploads, in a state, and their bytes."""

    state: str
    count: int
    size_bytes: int


class AdminStorage(_Told):
    """What the store keeps, by state; what only the trash still holds; what is on its way; what goes at the next sweep.

    A blob counts once, however many files are made of it.
    """

    store: StoreUse
    is_low: bool
    blobs: list[StateAmount]
    trash: StateAmount
    uploads: StateAmount
    doomed: StateAmount


class JobAmount(_Told):
    """So many jobs of a kind in a state: `todo`, `doing` or `failed`; `oldest_at` is since when the oldest waits."""

    kind: str
    state: str
    count: int
    oldest_at: datetime.datetime | None


class FailedJob(_Told):
    """A job that was given up. `ref` is the id of what it was for; `error` says why, where that could be kept, and the
    worker's log says more.
    """

    id: int
    kind: str
    ref: str | None
    attempts: int
    failed_at: datetime.datetime | None
    error: str | None


class AdminJobs(_Told):
    """The queue, and the jobs that were given up last, at most 100; each is forgotten after a week."""

    queue: list[JobAmount]
    failed: list[FailedJob]


class AdminHealth(_Told):
    """How the server is. `not_ready`: what keeps it from serving; `workers_at`: when each worker was last heard of."""

    not_ready: str | None
    version: str
    schema_version: str
    database_version: str
    database_bytes: int
    now: datetime.datetime
    clock_skew_s: float
    workers_at: list[datetime.datetime]
    store_checksum: str
    store_writes_once: bool
    store_takes_pages: bool


class SettingRead(_Told):
    """One setting in force. `is_set`: by the environment, else it is the default. A secret has no value here."""

    name: str
    value: Any
    is_set: bool
    is_secret: bool


class AdminSettings(_Told):
    """The settings of the process that answered, by name."""

    settings: list[SettingRead]
