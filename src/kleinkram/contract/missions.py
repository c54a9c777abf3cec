"""Missions: one outing of a robot, with the metadata that its project requires."""

import datetime
import enum
import uuid
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator
from typing_extensions import Self

from kleinkram.contract.access import Right
from kleinkram.contract.base import ETag, Request, Response, etag_of
from kleinkram.contract.errors import FieldProblem
from kleinkram.contract.metadata import MAX_YAML_CHARACTERS, BoundedMetadata, Metadata, MetadataFields
from kleinkram.contract.names import Name, Term, Terms, check_text
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef

Notes = Annotated[str, AfterValidator(check_text), Field(max_length=100_000)]
MetadataYaml = Annotated[str, Field(max_length=MAX_YAML_CHARACTERS)]


class MissionRef(Response):
    """A mission, as named beside what it holds."""

    id: uuid.UUID
    name: str
    project: ProjectRef


class _MetadataOnce(Request):
    metadata_yaml: MetadataYaml | None = None
    metadata: BoundedMetadata | None = None

    @model_validator(mode="after")
    def _in_one_way(self) -> Self:
        if self.metadata is not None and self.metadata_yaml is not None:
            raise ValueError("say metadata or metadata_yaml, not both")
        return self


class MissionCreate(_MetadataOnce):
    """A mission to make, whose metadata must satisfy the project's fields.

    Said as a document, `metadata_yaml`, which is kept to the letter, or as the values of a form, `metadata`.
    """

    name: Name
    notes: Notes = ""


class MissionUpdate(_MetadataOnce):
    """Changes of a mission; omitted fields stay. A new `project_id` moves the mission with its files.

    `metadata_yaml` is all metadata anew; with `merge_yaml`, it changes the fields that it names, and a field without a
    value (null) is removed. `metadata` changes the fields that it names, null takes one away, and the
    document that values all is dropped.
    """

    name: Name | None = None
    project_id: uuid.UUID | None = None
    merge_yaml: bool | None = None
    notes: Notes | None = None
    completed: bool | None = None


def _etag(values: dict[str, Any]) -> str:
    words, project = (values[name] for name in ("name", "metadata_yaml", "notes")), values["project"]
    metadata = sorted(values["metadata"].items())
    return etag_of(*words, metadata, project.id, values["completed_at"] is not None)


class MissionRead(Response):
    """A mission and what it amounts to.

    `start_ns` and `end_ns` (log clock, since 1970, UTC) span its recordings without suspect stamps.
    `metadata_problems` names what no longer satisfies the project's fields. `pending_file_count` counts the files whose
    content nobody has read yet, those included that only the verification will read; `recordings_current` says whether
    recordings and span follow from today's files. `right` is the asker's own on it, from wherever it comes.
    `etag` names what people edited last: given back with a change, that is refused where somebody else came first.
    """

    id: uuid.UUID
    name: str
    project: ProjectRef
    metadata: Metadata
    metadata_yaml: str | None
    metadata_problems: list[FieldProblem]
    notes: str
    completed_at: datetime.datetime | None
    created_at: datetime.datetime
    created_by: PersonRef
    start_ns: int | None
    end_ns: int | None
    file_count: int
    size_bytes: int
    message_count: int
    pending_file_count: int
    recordings_current: bool
    right: Right
    etag: ETag = Field(default_factory=_etag)


class MissionTemplate(Response):
    """Template for the next mission of a project: as YAML, or as a form of `fields` with initial `values`.

    `carried` are values of the mission `prefilled_from`, for somebody to confirm field by field. In the YAML they
    stand in comments. Dates, weather and operator are not among them.
    """

    yaml: str
    fields: MetadataFields
    values: Metadata
    carried: Metadata = {}
    prefilled_from: MissionRef | None


class MissionSort(str, enum.Enum):
    """Orders of a list of missions."""

    name = "name"
    name_desc = "-name"
    created = "created"
    created_desc = "-created"
    start = "start"
    start_desc = "-start"


# An order by a field of the metadata: `meta.robot`, `-meta.site.latitude`. Missions without the field come last.
MetadataSort = Annotated[str, Field(pattern=r"^-?meta\.[A-Za-z][A-Za-z0-9_.]{0,199}$")]
MissionOrder = MissionSort | MetadataSort


class MissionFilter(Request):
    """Which missions: all that are given must hold. Names may be globs (`*`, `?`), in any case.

    `where` are comparisons with metadata: `robot=anymal`, `temperature>20`, `operator!=ada`, `site~zur*`.
    `text` is found in names, notes and metadata values. `projects` and `missions` are names, globs or ids of several,
    of which any may hold.
    """

    text: Term | None = None
    project: Term | None = None
    project_id: uuid.UUID | None = None
    projects: Terms = []
    name: Term | None = None
    missions: Terms = []
    where: Terms = []
    topic: Terms = []
    message_type: Terms = []
    recorded_after: datetime.datetime | None = None
    recorded_before: datetime.datetime | None = None
    completed: bool | None = None
    satisfied: bool | None = None
