"""Objects of the API with default values, for tests."""

import datetime
import hashlib
import uuid

from kleinkram.contract.access import Right
from kleinkram.contract.actions import ActionDefinition, ActionRead, ActionVersionRead, Network
from kleinkram.contract.files import BlobState, ContentState, DownloadLink, FileRead
from kleinkram.contract.missions import MissionRead, MissionRef
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.runs import ActionRef, Cause, RunDetail, RunState

NOW = datetime.datetime(2026, 5, 1, tzinfo=datetime.timezone.utc)


def file_read(path: str, *, mission: str = "day", project: str = "alps", content: bytes = b"") -> FileRead:
    """A file as a server, honest or not, may describe it."""
    fields: dict[str, object] = dict.fromkeys(FileRead.model_fields)
    fields |= {
        "id": uuid.uuid4(),
        "mission": MissionRef(id=uuid.uuid4(), name=mission, project=ProjectRef(id=uuid.uuid4(), name=project)),
        "path": path,
        "size_bytes": len(content),
        "state": BlobState.stored,
        "content": ContentState.pending,
        "sha256": hashlib.sha256(content).hexdigest(),
        "labels": [],
        "origin": "upload",
        "uploaded_by": PersonRef(id=uuid.uuid4(), name="ada"),
        "created_at": NOW,
        "compression": [],
        "problems": [],
        "facts": [],
        "etag": "0" * 16,
    }
    return FileRead.model_validate(fields)


def link_to(file: FileRead, *, sha256: str | None, crc64nvme: str | None = None) -> DownloadLink:
    """A link to a file's bytes."""
    return DownloadLink(
        file_id=file.id,
        path=file.path,
        size_bytes=file.size_bytes,
        sha256=sha256,
        crc64nvme=crc64nvme,
        state=BlobState.stored,
        url="http://store/key",
        expires_at=NOW,
    )


def mission_read(name: str, *, project: str = "alps") -> MissionRead:
    """A mission without files."""
    fields: dict[str, object] = dict.fromkeys(
        name for name, field in MissionRead.model_fields.items() if field.is_required()
    )
    fields |= dict.fromkeys(("file_count", "size_bytes", "message_count", "pending_file_count"), 0)
    fields |= {
        "etag": "0" * 16,
        "id": uuid.uuid4(),
        "name": name,
        "project": ProjectRef(id=uuid.uuid4(), name=project),
        "metadata": {},
        "metadata_problems": [],
        "notes": "",
        "created_at": NOW,
        "created_by": PersonRef(id=uuid.uuid4(), name="ada"),
        "recordings_current": True,
        "right": Right.write,
    }
    return MissionRead.model_validate(fields)


def action_read(name: str, *, project: str | None = None, number: int = 1) -> ActionRead:
    """An action that looks at everything."""
    person = PersonRef(id=uuid.uuid4(), name="ada")
    definition = ActionDefinition(name=name, script="print(1)")
    latest = ActionVersionRead(
        id=uuid.uuid4(), number=number, definition=definition, image_digest=None, created_at=NOW, created_by=person
    )
    return ActionRead(
        id=uuid.uuid4(),
        name=name,
        description="",
        project=None if project is None else ProjectRef(id=uuid.uuid4(), name=project),
        latest=latest,
        archived=False,
        created_at=NOW,
        created_by=person,
        may_change=True,
    )


def run_detail(state: RunState, **more: object) -> RunDetail:
    """A run of a script on a mission."""
    fields: dict[str, object] = dict.fromkeys(RunDetail.model_fields)
    fields |= {
        "id": uuid.uuid4(),
        "mission": MissionRef(id=uuid.uuid4(), name="day", project=ProjectRef(id=uuid.uuid4(), name="alps")),
        "action": ActionRef(id=uuid.uuid4(), name="look", version=1),
        "version_id": uuid.uuid4(),
        "network": Network.none,
        "parameters": {},
        "state": state,
        "message": "",
        "attempt": 1,
        "cause": Cause(person=PersonRef(id=uuid.uuid4(), name="ada")),
        "input_count": 1,
        "input_bytes": 10,
        "artifact_count": 0,
        "priority": "normal",
        "is_recorded": False,
        "check_counts": {},
        "finding_counts": {},
        "metric_count": 0,
        "metrics": [],
        "created_at": NOW,
        "may_cancel": False,
        "definition": ActionDefinition(name="look", script="print(1)"),
        "packages": [],
        "problems": [],
        "metadata": {},
        "previews": [],
        "samples": [],
    }
    return RunDetail.model_validate(fields | more)
