"""Nouns as a server would send them."""

import datetime
import hashlib
import uuid

from kleinkram.contract.files import BlobState, ContentState, DownloadLink, FileRead
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef

NOW = datetime.datetime(2026, 5, 1, tzinfo=datetime.timezone.utc)


def file_read(path: str, *, mission: str = "day", project: str = "alps", content: bytes = b"") -> FileRead:
    """A file as a server, honest or not, may describe it."""
    given: dict[str, object] = dict.fromkeys(FileRead.model_fields)
    given |= {
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
    }
    return FileRead.model_validate(given)


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
