"""Missions: recordings of one deployment of a robot, with the metadata that the project requires."""

import datetime
import enum
import uuid
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator
from typing_extensions import Self

from kleinkram.contract.access import Right
from kleinkram.contract.base import ETag, Request, Response, etag_of
from kleinkram.contract.checks import CheckCounts, Verdict
from kleinkram.contract.errors import FieldProblem
from kleinkram.contract.metadata import MAX_YAML_CHARACTERS, BoundedMetadata, Metadata, MetadataFields
from kleinkram.contract.names import Ids, Name, Term, Terms, check_text
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef

Notes = Annotated[str, AfterValidator(check_text), Field(max_length=100_000)]
MetadataYaml = Annotated[str, Field(max_length=MAX_YAML_CHARACTERS)]


class MissionRef(Response):
    """The id, name and project of a mission."""

    id: uuid.UUID
    name: str
    project: ProjectRef


class _MetadataInput(Request):
    metadata_yaml: MetadataYaml | None = None
    metadata: BoundedMetadata | None = None

    @model_validator(mode="after")
    def _has_one_form(self) -> Self:
        if self.metadata is not None and self.metadata_yaml is not None:
            raise ValueError("specify metadata or metadata_yaml, not both")
        return self


class MissionCreate(_MetadataInput):
    """A mission to create, whose metadata must satisfy the project's fields.

    The metadata is a YAML document, `metadata_yaml`, which is stored unchanged, or values, `metadata`.
    """

    name: Name
    notes: Notes = ""


class MissionUpdate(_MetadataInput):
    """Changes of a mission; omitted fields stay. A new `project_id` moves the mission with its files.

    `metadata_yaml` replaces all metadata; with `merge_yaml`, it changes only the fields that it contains. `metadata`
    changes the fields that it contains and drops the stored YAML document. A field with the value null is removed.
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
    """A mission and its totals.

    `start_ns` and `end_ns` (log time, ns since 1970) span its recordings without implausible timestamps.
    `metadata_problems` is what does not satisfy the project's fields. `pending_file_count` is the number of files whose
    content the server has not read yet. `recordings_current`: recordings and span reflect the current files. `verdict`
    and `checks`: what its checks amount to, and their number by status. `right` is the caller's. `etag` covers the
    edited fields: a change with an outdated one is refused.
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
    verdict: Verdict = Verdict.unchecked
    checks: CheckCounts = CheckCounts()
    right: Right
    etag: ETag = Field(default_factory=_etag)


class MissionTemplate(Response):
    """Template for the next mission of a project: as YAML, or as a form of `fields` with initial `values`.

    `carried` are values of the mission `prefilled_from`, to be confirmed field by field; in the YAML they are comments.
    Dates, weather and operator are not carried over.
    """

    yaml: str
    fields: MetadataFields
    values: Metadata
    carried: Metadata = {}
    prefilled_from: MissionRef | None


class MissionSort(str, enum.Enum):
    """Orders of a list of missions. `verdict`: bad ones first; of one verdict, in both directions, the latest first."""

    name = "name"
    name_desc = "-name"
    created = "created"
    created_desc = "-created"
    start = "start"
    start_desc = "-start"
    verdict = "verdict"
    verdict_desc = "-verdict"


# An order by a field of the metadata: `meta.robot`, `-meta.site.latitude`. Missions without the field come last.
MetadataSort = Annotated[str, Field(pattern=r"^-?meta\.[A-Za-z][A-Za-z0-9_.]{0,199}$")]
MissionOrder = MissionSort | MetadataSort


class LocationFilter(Request):
    """A filter by where something happened; of several projects or missions, any may match."""

    project_id: uuid.UUID | None = None
    project_ids: Ids = []
    mission_id: uuid.UUID | None = None
    mission_ids: Ids = []


class MissionCriteria(Request):
    """The criteria that filters of missions and of files have in common.

    `event` are names or globs of events, in any case: of a mission that has one of them, of a file that was recorded
    during one or to which one refers. Of the missions' checks: `verdict`; `check`, names or globs of checks that fail;
    of the latest results of runs, `finding`, codes or globs, of which any suffices; and `metric`, comparisons such as
    `ate_rmse>0.5`, which all hold.
    """

    text: Term | None = None
    project: Term | None = None
    project_id: uuid.UUID | None = None
    projects: Terms = []
    missions: Terms = []
    where: Terms = []
    topic: Terms = []
    message_type: Terms = []
    recorded_after: datetime.datetime | None = None
    recorded_before: datetime.datetime | None = None
    event: Terms = []
    verdict: list[Verdict] = []
    check: Terms = []
    finding: Terms = []
    metric: Terms = []


class MissionFilter(MissionCriteria):
    """A filter of missions; all criteria must match, and of `projects` and `missions`, any. Names may be globs.

    `projects` and `missions` are names, globs or ids. `where` compares metadata: `robot=anymal`, `temperature>20`,
    `operator!=ada`, `site~zur*`. `text` is searched for in names, notes and metadata values.
    """

    name: Term | None = None
    completed: bool | None = None
    satisfied: bool | None = None
