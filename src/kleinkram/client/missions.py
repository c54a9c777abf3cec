"""Missions, for programs."""

import uuid
from collections.abc import Iterator

from typing_extensions import Unpack

from kleinkram.client._http import Api, query_of
from kleinkram.client._nouns import Listing, Ref, checked, count, known_id, pages, resolve_one
from kleinkram.client.errors import InvalidInput
from kleinkram.client.projects import Projects
from kleinkram.client.search import MissionFields, as_mission_filter
from kleinkram.contract.errors import NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.missions import (
    MissionCreate,
    MissionFilter,
    MissionOrder,
    MissionRead,
    MissionUpdate,
)
from kleinkram.contract.overviews import MAX_MISSION_TOPICS, MissionTimeline, MissionTopics, TimelineFile
from kleinkram.contract.projects import Deleted


class Missions:
    """`client.missions`."""

    def __init__(self, api: Api) -> None:
        self._api = api

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

        Say which by keywords, as in `list(project="alpine", topic="*imu*")` (those of `MissionFields`), or by a filter.
        With the text of a `query`, those that it finds: by what they say themselves, or by their files.

        Raises:
            InvalidQuery: the query cannot be read, or a comparison cannot be made.
        """
        parameters = query_of(as_mission_filter(matching, fields), query=query, sort=sort)
        return pages(self._api, "/missions", MissionRead, parameters, limit=limit)

    def count(
        self, matching: MissionFilter | None = None, *, query: str | None = None, **fields: Unpack[MissionFields]
    ) -> int:
        """Return how many missions match, and are found by the `query`."""
        return count(self._api, "/missions", MissionRead, query_of(as_mission_filter(matching, fields), query=query))

    def get(self, ref: Ref, *, project: Ref | None = None) -> MissionRead:
        """Return the mission with this id, or with this name (in that project, where one is given).

        `"PROJECT/MISSION"` names both. Wherever a mission is meant, any of these will do, or the mission itself.

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
        """Return the id of a mission that is named; one that is known is not asked for.

        Raises:
            NotFound, AmbiguousName: as in `get`.
        """
        return known_id(ref, "mission") or self.get(ref, project=project).id

    def within(self, project: Ref) -> MissionFilter:
        """Return the filter on the missions of a project, by its id or name.

        Who has rights on missions alone sees no project, but its name beside them; they may say that name, too.

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
        """Yield when each file of a mission was recorded, by path: few bytes a file, ten thousand files a request."""
        cursor: str | None = None
        while True:
            page = self._api.get(
                f"/missions/{self.id_of(mission_id)}/timeline", MissionTimeline, query_of(None, cursor=cursor)
            )
            yield from page.items
            cursor = page.next
            if cursor is None:
                return

    def topics(self, mission_id: Ref, *, bins: int = 256) -> MissionTopics:
        """Return the topics of all recordings of a mission, by name and type, with their messages in few bins.

        `bins` is at most 512; 0 leaves them out.
        """
        path, query = f"/missions/{self.id_of(mission_id)}/topics", query_of(None, bins=bins, limit=MAX_MISSION_TOPICS)
        whole = self._api.get(path, MissionTopics, query)
        cursor, items = whole.next, [*whole.items]
        while cursor is not None:
            page = self._api.get(path, MissionTopics, [*query, ("cursor", cursor)])
            cursor, items = page.next, [*items, *page.items]
        return whole.model_copy(update={"items": items, "next": None})

    def create(
        self,
        name: str,
        *,
        project_id: Ref | None = None,
        project: Ref | None = None,
        metadata_yaml: str | None = None,
        metadata: Metadata | None = None,
        notes: str = "",
    ) -> MissionRead:
        """Make a mission; the server judges its metadata against the project's fields.

        Say the metadata as a document, `metadata_yaml`, which is kept to the letter, or as values, `metadata`.

        Raises:
            MetadataInvalid: names every missing or wrong field at once; nothing was made.
            YamlInvalid: the YAML cannot be read; says where.
            NameTaken: the project has a mission of that name.
            InvalidInput: the name is not usable.
        """
        metadata_fields = {"metadata_yaml": metadata_yaml, "metadata": metadata}
        body = checked(MissionCreate, "The mission", name=name, notes=notes, **metadata_fields)
        where = project if project is not None else project_id
        if where is None:
            raise InvalidInput(what="The mission", reason="say in which project, by project=")
        return self._api.send("POST", f"/projects/{Projects(self._api).id_of(where)}/missions", MissionRead, body)

    def update(
        self, mission_id: Ref, *, if_match: str | None = None, **changes: str | bool | uuid.UUID | Metadata
    ) -> MissionRead:
        """Change what is given (the fields of `MissionUpdate`) and return the mission; a `project_id` moves it.

        `metadata` changes the fields that it names, and None takes one away; `metadata_yaml` is all of it anew.
        With `if_match`, the `etag` of what was looked at, a change is refused where somebody else came first.

        Raises:
            MetadataInvalid, YamlInvalid, NameTaken, InvalidInput: as in `create`.
            EditConflict: it is of another ETag by now.
        """
        body = checked(MissionUpdate, "The mission", **changes)
        return self._api.patch(f"/missions/{self.id_of(mission_id)}", MissionRead, body, etag=if_match)

    def complete(self, mission_id: Ref) -> MissionRead:
        """Say that all of the mission is uploaded."""
        return self.update(mission_id, completed=True)

    def delete(self, mission_id: Ref, *, dry_run: bool = False) -> Deleted:
        """Move a mission and its files to the trash; with `dry_run`, only say what would go."""
        answer = self._api.delete(f"/missions/{self.id_of(mission_id)}", query_of(None, dry_run=dry_run or None))
        return self._api.understood(Deleted, "DELETE mission", answer)


def mission_label(mission: MissionRead) -> str:
    """Return how a mission is listed among candidates."""
    return f"{mission.project.name}/{mission.name} ({mission.id})"
