"""Projects, for programs."""

import uuid

from kleinkram.client._http import Api, query_of
from kleinkram.client._nouns import Listing, Ref, checked, count, known_id, pages, resolve_one
from kleinkram.contract.metadata import MetadataFields
from kleinkram.contract.missions import MissionTemplate
from kleinkram.contract.projects import Deleted, ProjectCreate, ProjectRead, ProjectSort, ProjectUpdate


class Projects:
    """`client.projects`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(
        self,
        *,
        name: str | None = None,
        text: str | None = None,
        sort: ProjectSort | str | None = None,
        limit: int | None = None,
    ) -> Listing[ProjectRead]:
        """Yield projects, by name unless `sort` says otherwise; `name` may be a glob, `text` is found anywhere."""
        query = query_of(None, name=name, text=text, sort=sort)
        return pages(self._api, "/projects", ProjectRead, query, limit=limit)

    def count(self, *, name: str | None = None, text: str | None = None) -> int:
        """Return how many projects there are."""
        return count(self._api, "/projects", ProjectRead, query_of(None, name=name, text=text))

    def get(self, ref: Ref) -> ProjectRead:
        """Return the project with this id or name. Wherever a project is meant, either will do, or the project itself.

        Raises:
            NotFound: there is none.
            AmbiguousName: a glob matches several.
        """
        if (project_id := known_id(ref, "project")) is not None:
            return self._api.get(f"/projects/{project_id}", ProjectRead)
        return resolve_one(
            "project", str(ref), self.list(name=str(ref)), name=lambda row: row.name, label=project_label
        )

    def id_of(self, ref: Ref) -> uuid.UUID:
        """Return the id of a project that is named; one that is known is not asked for.

        Raises:
            NotFound, AmbiguousName: as in `get`.
        """
        return known_id(ref, "project") or self.get(ref).id

    def create(
        self,
        name: str,
        *,
        description: str = "",
        fields_yaml: str | None = None,
        metadata_fields: MetadataFields | None = None,
    ) -> ProjectRead:
        """Make a project; `fields_yaml`, the text of a `fields.yaml`, or `metadata_fields` declare its metadata fields.

        Raises:
            NameTaken: there is one of that name.
            FieldsInvalid: the definitions are not usable; names every problem.
            YamlInvalid: the YAML cannot be read; says where.
            InvalidInput: the name is not usable.
        """
        fields = {"fields_yaml": fields_yaml, "metadata_fields": metadata_fields}
        body = checked(ProjectCreate, "The project", name=name, description=description, **fields)
        return self._api.send("POST", "/projects", ProjectRead, body)

    def update(
        self,
        project_id: Ref,
        *,
        if_match: str | None = None,
        **changes: str | bool | int | MetadataFields | None,
    ) -> ProjectRead:
        """Change what is given (the fields of `ProjectUpdate`) and return the project; a quota of None lifts it.

        With `if_match`, the `etag` of what was looked at, a change is refused where somebody else came first.

        Raises:
            NameTaken, FieldsInvalid, YamlInvalid, InvalidInput: as in `create`.
            Forbidden: to publish is for owners, quotas are for admins.
            EditConflict: it is of another ETag by now.
        """
        body = checked(ProjectUpdate, "The project", **changes)
        return self._api.patch(f"/projects/{self.id_of(project_id)}", ProjectRead, body, etag=if_match)

    def delete(self, project_id: Ref, *, dry_run: bool = False) -> Deleted:
        """Move a project and all in it to the trash; with `dry_run`, only say what would go."""
        answer = self._api.delete(f"/projects/{self.id_of(project_id)}", query_of(None, dry_run=dry_run or None))
        return self._api.understood(Deleted, "DELETE project", answer)

    def template(self, project_id: Ref) -> MissionTemplate:
        """Return what to fill in for the next mission, as YAML or as a form, prefilled from the last one."""
        return self._api.get(f"/projects/{self.id_of(project_id)}/template", MissionTemplate)


def project_label(project: ProjectRead) -> str:
    """Return how a project is listed among candidates."""
    return f"{project.name} ({project.id})"
