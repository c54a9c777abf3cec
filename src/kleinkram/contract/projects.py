"""Projects, which contain missions, and the trash."""

import datetime
import enum
import uuid
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator
from typing_extensions import Self

from kleinkram.contract.access import Right
from kleinkram.contract.base import ETag, NamedRef, Request, Response, etag_of
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.metadata import MAX_YAML_CHARACTERS, MetadataFields
from kleinkram.contract.names import Name, check_text
from kleinkram.contract.people import PersonRef

Description = Annotated[str, AfterValidator(check_text), Field(max_length=10_000)]
# An SPDX identifier such as CC-BY-4.0, or the text of the licence.
Licence = Annotated[str, AfterValidator(check_text), Field(max_length=10_000)]
Citation = Annotated[str, AfterValidator(check_text), Field(max_length=10_000)]
Quota = Annotated[int, Field(ge=0, le=2**63 - 1)]
FieldsYaml = Annotated[str, Field(max_length=MAX_YAML_CHARACTERS)]


class ProjectRef(NamedRef):
    """The id and name of a project."""


class _FieldsInput(Request):
    fields_yaml: FieldsYaml | None = None
    metadata_fields: MetadataFields | None = None

    @model_validator(mode="after")
    def _has_one_form(self) -> Self:
        if self.fields_yaml is not None and self.metadata_fields is not None:
            raise ValueError("specify fields_yaml or metadata_fields, not both")
        return self


class ProjectCreate(_FieldsInput):
    """A project to create, with its metadata fields as the text of a `fields.yaml` or as `metadata_fields`."""

    name: Name
    description: Description = ""


class ProjectUpdate(_FieldsInput):
    """Changes of a project; omitted fields stay. Metadata fields are all replaced.

    Everybody may read a public project, also without an account. `isolation` is the weakest class that its runs may
    have. Owners change these. A quota of null is no quota; admins set quotas.
    """

    name: Name | None = None
    description: Description | None = None
    is_public: bool | None = None
    licence: Licence | None = None
    citation: Citation | None = None
    isolation: Isolation | None = None
    quota_bytes: Quota | None = None
    quota_files: Quota | None = None


_EDITED = ("name", "description", "is_public", "licence", "citation", "isolation", "quota_bytes", "quota_files")


def _etag(values: dict[str, Any]) -> str:
    fields: MetadataFields = values["metadata_fields"]
    return etag_of(*(values[name] for name in _EDITED), fields.model_dump_json(exclude_none=True))


class ProjectRead(Response):
    """A project and its contents, without the trash. `right` is the caller's own.

    The quotas limit files and uploads in progress: `used_bytes` and `used_files`. `etag` is of the edited fields.
    `isolation` is the weakest class that its runs may have; where the server asks for a stronger one, that counts.
    """

    id: uuid.UUID
    name: str
    description: str
    metadata_fields: MetadataFields
    created_at: datetime.datetime
    created_by: PersonRef
    mission_count: int
    file_count: int
    size_bytes: int
    duration_ns: int
    unsatisfied_mission_count: int
    is_public: bool
    licence: str
    citation: str
    isolation: Isolation = Isolation.container
    quota_bytes: int | None
    quota_files: int | None
    used_bytes: int
    used_files: int
    right: Right
    etag: ETag = Field(default_factory=_etag)


class ProjectSort(str, enum.Enum):
    """Orders of a list of projects; names by `COLLATE "C"`."""

    name = "name"
    name_desc = "-name"
    created = "created"
    created_desc = "-created"


class TrashResourceType(str, enum.Enum):
    """What can be in the trash."""

    project = "project"
    mission = "mission"
    file = "file"


class TrashRead(Response):
    """A deleted object. `location` is the project of a mission, or project and mission of a file.

    Missions that were deleted with their project are restored with it, and not listed.
    """

    resource_type: TrashResourceType
    id: uuid.UUID
    name: str
    location: str
    size_bytes: int
    file_count: int
    deleted_at: datetime.datetime
    deleted_by: PersonRef
    purged_after: datetime.datetime


class Deleted(Response):
    """What a deletion moved to the trash (or, as a dry run, would move).

    For a single file: how many runs read it, and at most 100 files of the mission that they made from it, which stay.
    """

    missions: int
    files: int
    size_bytes: int
    dry_run: bool
    read_by_runs: int = 0
    made_from_it: list[str] = []
