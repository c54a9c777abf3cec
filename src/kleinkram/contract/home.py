"""The home page: recent missions, unfinished uploads, what needs attention, and storage."""

import datetime
import enum
import uuid

from kleinkram.contract.base import Response
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.projects import ProjectRef


class RecentMission(Response):
    """A mission with its last activity."""

    mission: MissionRef
    active_at: datetime.datetime
    file_count: int
    size_bytes: int


class UnfinishedUpload(Response):
    """An unfinished upload. `sent_bytes` are in the store; null if it did not answer.

    Until `expires_at`, uploading the same file again continues it.
    """

    id: uuid.UUID
    mission: MissionRef
    path: str
    size_bytes: int
    sent_bytes: int | None
    created_at: datetime.datetime
    expires_at: datetime.datetime


class AttentionKind(str, enum.Enum):
    """Reasons for attention. The last four concern the whole server and are shown to admins."""

    files_corrupt = "files_corrupt"
    files_lost = "files_lost"
    files_broken = "files_broken"
    files_unread = "files_unread"
    files_recovered = "files_recovered"
    runs_cannot_start = "runs_cannot_start"
    runs_failed = "runs_failed"
    metadata_missing = "metadata_missing"
    scrub_stopped = "scrub_stopped"
    verifications_overdue = "verifications_overdue"
    jobs_failed = "jobs_failed"
    disk_low = "disk_low"


class Attention(Response):
    """A number of objects that need attention, in one mission or on the whole server."""

    kind: AttentionKind
    count: int
    mission: MissionRef | None = None


class ProjectStorage(Response):
    """The size of a project. Files count with all their bytes, even if they share them with others."""

    project: ProjectRef
    file_count: int
    size_bytes: int
    quota_bytes: int | None


class StoreUse(Response):
    """The bytes in the store, and the free space if its disk is on the server's machine or its capacity is set."""

    used_bytes: int
    free_bytes: int | None
    disk_bytes: int | None


class HomeStorage(Response):
    """`GET /api/v1/home/storage`: the largest projects and, for admins, the store."""

    projects: list[ProjectStorage]
    store: StoreUse | None


class FailedChecks(Response):
    """The number of visible missions that became bad since Monday (`since`, in UTC), and the latest of them."""

    since: datetime.datetime
    count: int
    missions: list[MissionRef]


class HomeRead(Response):
    """`GET /api/v1/home`. Every list is bounded. `failed_checks` is null from earlier servers."""

    missions: list[RecentMission]
    uploads: list[UnfinishedUpload]
    attention: list[Attention]
    failed_checks: FailedChecks | None = None
