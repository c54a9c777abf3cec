"""The data model: one module a noun. Constraints and indexes stand here; what the database can hold, it holds."""

from kleinkram.server.tables.audit_event import audit_event
from kleinkram.server.tables.base import metadata
from kleinkram.server.tables.blob import blob, topic
from kleinkram.server.tables.file import file, recording
from kleinkram.server.tables.mission import mission
from kleinkram.server.tables.person import person, token
from kleinkram.server.tables.project import project
from kleinkram.server.tables.store_probe import store_probe
from kleinkram.server.tables.upload import upload

__all__ = [
    "audit_event",
    "blob",
    "file",
    "metadata",
    "mission",
    "person",
    "project",
    "recording",
    "store_probe",
    "token",
    "topic",
    "upload",
]
