"""The trash: what was deleted and can still be had back."""

import datetime
import enum
import uuid

from kleinkram.contract.people import PersonRef
from kleinkram.contract.wire import Response


class TrashNoun(str, enum.Enum):
    """What can lie in the trash."""

    project = "project"
    mission = "mission"
    file = "file"


class TrashRead(Response):
    """Something deleted. `place` is what held it: the project of a mission, project and mission of a file.

    A mission that was deleted with its project is not listed by itself; it comes back with the project.
    """

    noun: TrashNoun
    id: uuid.UUID
    name: str
    place: str
    size_bytes: int
    file_count: int
    deleted_at: datetime.datetime
    deleted_by: PersonRef
    purged_after: datetime.datetime


class Deleted(Response):
    """What a deletion moved to the trash (or, as a dry run, would move).

    Of a single file: how many runs read it, and which files of its mission came of that, which stay; 100 at most.
    """

    missions: int
    files: int
    size_bytes: int
    dry_run: bool
    read_by_runs: int = 0
    made_from_it: list[str] = []
