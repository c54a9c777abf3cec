"""The context of a run on a mission that does not exist."""

import datetime
import uuid

from kleinkram.contract.access import Right
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef

LATER = datetime.datetime(2100, 1, 1, tzinfo=datetime.timezone.utc)


def a_mission(mission_id: uuid.UUID, project_id: uuid.UUID) -> MissionRead:
    """Return an empty mission."""
    return MissionRead(
        id=mission_id,
        name="a-mission",
        project=ProjectRef(id=project_id, name="a-project"),
        metadata={},
        metadata_yaml=None,
        metadata_problems=[],
        notes="",
        completed_at=None,
        created_at=LATER,
        created_by=PersonRef(id=uuid.UUID(int=1), name="somebody"),
        start_ns=None,
        end_ns=None,
        file_count=0,
        size_bytes=0,
        message_count=0,
        pending_file_count=0,
        recordings_current=True,
        right=Right.read,
    )
