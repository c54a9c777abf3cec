"""What somebody finds when they come: what moved lately, what is unfinished, what needs them; what it all takes."""

import datetime
import enum
import uuid

from kleinkram.contract.base import Response
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.projects import ProjectRef


class RecentMission(Response):
    """A mission in which something arrived lately; `active_at` is when."""

    mission: MissionRef
    active_at: datetime.datetime
    file_count: int
    size_bytes: int


class UnfinishedUpload(Response):
    """A file that somebody began to send. `sent_bytes` is what the store holds of it, null where it did not say.

    It lapses at `expires_at`; until then the same file, chosen again, goes on where it stopped.
    """

    id: uuid.UUID
    mission: MissionRef
    path: str
    size_bytes: int
    sent_bytes: int | None
    created_at: datetime.datetime
    expires_at: datetime.datetime


class Need(str, enum.Enum):
    """What needs somebody. The last four are of the whole server, and for admins."""

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
    """So many things of a kind that need somebody, in one mission where they are of one."""

    need: Need
    count: int
    mission: MissionRef | None = None


class ProjectStorage(Response):
    """What a project takes. A file counts with all its bytes, whether or not others share them."""

    project: ProjectRef
    file_count: int
    size_bytes: int
    quota_bytes: int | None


class StoreUse(Response):
    """What the store holds, and what is free on its disk where that is this server's to know."""

    used_bytes: int
    free_bytes: int | None
    disk_bytes: int | None


class HomeStorage(Response):
    """`GET /api/v1/home/storage`: the largest projects, and for admins the store."""

    projects: list[ProjectStorage]
    store: StoreUse | None


class HomeRead(Response):
    """`GET /api/v1/home`. Lists are bounded: the latest, the most pressing."""

    missions: list[RecentMission]
    uploads: list[UnfinishedUpload]
    attention: list[Attention]
