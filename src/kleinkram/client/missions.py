"""Projects and missions. `if_match` is the ETag that something must still have to be changed, else EditConflict."""

import uuid
from collections.abc import Iterator, Sequence

from typing_extensions import Unpack

from kleinkram.client._http import query_of
from kleinkram.client._resources import Listing, NamedResource, Ref, checked, count, known_id, pages, resolve_one
from kleinkram.client.errors import InvalidInput
from kleinkram.client.search import MissionFields, as_mission_filter
from kleinkram.contract.errors import NotFound
from kleinkram.contract.files import MAX_MISSION_TOPICS, MissionTimeline, MissionTopics, TimelineFile
from kleinkram.contract.metadata import Metadata, MetadataFields
from kleinkram.contract.mission_positions import MissionPositions
from kleinkram.contract.missions import (
    MissionCreate,
    MissionFilter,
    MissionOrder,
    MissionRead,
    MissionTemplate,
    MissionUpdate,
)
from kleinkram.contract.previews import MissionPreview, MissionPreviews
from kleinkram.contract.projects import Deleted, ProjectCreate, ProjectRead, ProjectSort, ProjectUpdate


class Projects(NamedResource[ProjectRead]):
    """`client.projects`."""

    _resource_type = "project"

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
        """Return how many projects match."""
        return count(self._api, "/projects", ProjectRead, query_of(None, name=name, text=text))

    def get(self, ref: Ref) -> ProjectRead:
        """Return the project with this id or name; raise AmbiguousName for a glob that matches several."""
        if (project_id := known_id(ref, "project")) is not None:
            return self._api.get(f"/projects/{project_id}", ProjectRead)
        rows = self.list(name=str(ref))
        return resolve_one("project", str(ref), rows, name=lambda row: row.name, label=project_label)

    def create(
        self,
        name: str,
        *,
        description: str = "",
        fields_yaml: str | None = None,
        metadata_fields: MetadataFields | None = None,
    ) -> ProjectRead:
        """Create a project; `fields_yaml`, the text of a `fields.yaml`, or `metadata_fields` declare its fields.

        Raises:
            NameTaken: there is one of that name.
            FieldsInvalid: lists every problem of the fields.
            YamlInvalid: the YAML cannot be read.
        """
        fields = {"fields_yaml": fields_yaml, "metadata_fields": metadata_fields}
        body = checked(ProjectCreate, "The project", name=name, description=description, **fields)
        return self._api.send("POST", "/projects", ProjectRead, body)

    def update(
        self, project_id: Ref, *, if_match: str | None = None, **changes: str | bool | int | MetadataFields | None
    ) -> ProjectRead:
        """Change some fields of `ProjectUpdate` and return the project; a quota of None removes it.

        Raises:
            NameTaken, FieldsInvalid, YamlInvalid, InvalidInput: as in `create`.
            Forbidden: only owners can publish and set the isolation of runs, and only admins can set quotas.
        """
        body = checked(ProjectUpdate, "The project", **changes)
        return self._api.patch(f"/projects/{self.id_of(project_id)}", ProjectRead, body, etag=if_match)

    def delete(self, project_id: Ref, *, dry_run: bool = False) -> Deleted:
        """Move a project and all in it to the trash; with `dry_run`, only return what would go."""
        return self._to_trash(f"/projects/{self.id_of(project_id)}", dry_run=dry_run)

    def template(self, project_id: Ref) -> MissionTemplate:
        """Return the metadata form for the next mission, as YAML and as fields, prefilled from the last one."""
        return self._api.get(f"/projects/{self.id_of(project_id)}/template", MissionTemplate)


def project_label(project: ProjectRead) -> str:
    """Return a project as it is listed among candidates."""
    return f"{project.name} ({project.id})"


class Missions(NamedResource[MissionRead]):
    """`client.missions`."""

    _resource_type = "mission"

    def list(
        self,
        matching: MissionFilter | None = None,
        *,
        query: str | None = None,
        sort: MissionOrder | None = None,
        limit: int | None = None,
        **fields: Unpack[MissionFields],
    ) -> Listing[MissionRead]:
        """Yield the missions that match, by name unless `sort` says otherwise: also by metadata, as in `meta.robot`.

        Select by keywords, as in `list(project="alpine", topic="*imu*")` (those of `MissionFields`), by a filter, or by
        the text of a `query`, which also matches the files of a mission.
        """
        parameters = query_of(as_mission_filter(matching, fields), query=query, sort=sort)
        return pages(self._api, "/missions", MissionRead, parameters, limit=limit)

    def count(
        self, matching: MissionFilter | None = None, *, query: str | None = None, **fields: Unpack[MissionFields]
    ) -> int:
        """Return how many missions match."""
        return count(self._api, "/missions", MissionRead, query_of(as_mission_filter(matching, fields), query=query))

    def positions(
        self, matching: MissionFilter | None = None, *, query: str | None = None, **fields: Unpack[MissionFields]
    ) -> MissionPositions:
        """Return where missions were recorded that match, selected as in `list`: their first GNSS fixes.

        Where no recording has one, it is the location in the metadata. At most 2,000 missions, those recorded last.
        """
        parameters = query_of(as_mission_filter(matching, fields), query=query)
        return self._api.get("/mission-positions", MissionPositions, parameters)

    def get(self, ref: Ref, *, project: Ref | None = None) -> MissionRead:
        """Return the mission with this id, or this name (in that project); `"PROJECT/MISSION"` names both.

        Raises:
            NotFound: there is none, or no such project.
            AmbiguousName: several projects have one of that name.
        """
        if (mission_id := known_id(ref, "mission")) is not None:
            return self._api.get(f"/missions/{mission_id}", MissionRead)
        name = str(ref)
        if project is None and "/" in name:
            project, _, name = name.partition("/")
        within = MissionFilter() if project is None else self.within(project)
        rows = self.list(within.model_copy(update={"name": name}))
        return resolve_one("mission", name, rows, name=lambda row: row.name, label=mission_label)

    def id_of(self, ref: Ref, *, project: Ref | None = None) -> uuid.UUID:
        """Return the id of a mission; asks the server only for a name."""
        return known_id(ref, "mission") or self.get(ref, project=project).id

    def within(self, project: Ref) -> MissionFilter:
        """Return the filter on the missions of a project, by its id or name.

        A person with rights on missions only cannot see the project; its name, shown beside its missions, works too.

        Raises:
            NotFound: there is no such project, and no mission of one.
            AmbiguousName: a glob matches several.
        """
        try:
            return MissionFilter(project_id=Projects(self._api).get(project).id)
        except NotFound:
            project_id = known_id(project, "project")
            matching = MissionFilter(project_id=project_id) if project_id else MissionFilter(project=str(project))
            if not any(self.list(matching, limit=1)):
                raise
            return matching

    def timeline(self, mission_id: Ref) -> Iterator[TimelineFile]:
        """Yield when each file of a mission was recorded, by path, ten thousand files per request."""
        path, cursor = f"/missions/{self.id_of(mission_id)}/timeline", None
        while True:
            page = self._api.get(path, MissionTimeline, query_of(None, cursor=cursor))
            yield from page.items
            cursor = page.next
            if cursor is None:
                return

    def topics(self, mission_id: Ref, *, bins: int = 256) -> MissionTopics:
        """Return the topics of all recordings of a mission, by name and type, with message counts in `bins`.

        `bins` is at most 512; 0 leaves them out.
        """
        path, query = f"/missions/{self.id_of(mission_id)}/topics", query_of(None, bins=bins, limit=MAX_MISSION_TOPICS)
        whole = self._api.get(path, MissionTopics, query)
        cursor, items = whole.next, [*whole.items]
        while cursor is not None:
            page = self._api.get(path, MissionTopics, [*query, ("cursor", cursor)])
            cursor, items = page.next, [*items, *page.items]
        return whole.model_copy(update={"items": items, "next": None})

    def previews(self, mission_id: Ref) -> Sequence[MissionPreview]:
        """Return the first 100 previews of a mission: of each action, those of the latest run that is done and has any.

        Those of the action `preview` come first. `client.runs.download_previews` downloads them.
        """
        return self._api.get(f"/missions/{self.id_of(mission_id)}/previews", MissionPreviews).items

    def create(
        self,
        name: str,
        *,
        project: Ref | None = None,
        metadata_yaml: str | None = None,
        metadata: Metadata | None = None,
        notes: str = "",
    ) -> MissionRead:
        """Create a mission, with metadata as a document, `metadata_yaml`, which is stored unchanged, or as values.

        Raises:
            MetadataInvalid: lists every missing or wrong field; nothing was created.
            YamlInvalid: the YAML cannot be read.
            NameTaken: the project has a mission of that name.
        """
        metadata_fields = {"metadata_yaml": metadata_yaml, "metadata": metadata}
        body = checked(MissionCreate, "The mission", name=name, notes=notes, **metadata_fields)
        if project is None:
            raise InvalidInput(what="The mission", reason="specify its project with project=")
        return self._api.send("POST", f"/projects/{Projects(self._api).id_of(project)}/missions", MissionRead, body)

    def update(
        self, mission_id: Ref, *, if_match: str | None = None, **changes: str | bool | uuid.UUID | Metadata
    ) -> MissionRead:
        """Change some fields of `MissionUpdate` and return the mission; a `project_id` moves it.

        `metadata` changes the fields that it names, and None removes one; `metadata_yaml` replaces all of it.

        Raises:
            MetadataInvalid, YamlInvalid, NameTaken, InvalidInput: as in `create`.
        """
        body = checked(MissionUpdate, "The mission", **changes)
        return self._api.patch(f"/missions/{self.id_of(mission_id)}", MissionRead, body, etag=if_match)

    def complete(self, mission_id: Ref) -> MissionRead:
        """Mark a mission as completely uploaded."""
        return self.update(mission_id, completed=True)

    def delete(self, mission_id: Ref, *, dry_run: bool = False) -> Deleted:
        """Move a mission and its files to the trash; with `dry_run`, only return what would go."""
        return self._to_trash(f"/missions/{self.id_of(mission_id)}", dry_run=dry_run)


def mission_label(mission: MissionRead) -> str:
    """Return a mission as it is listed among candidates."""
    return f"{mission.project.name}/{mission.name} ({mission.id})"
