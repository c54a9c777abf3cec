"""Actions, for programs: definitions of what to run on the data of a mission, in versions that never change."""

import uuid

from kleinkram.client._http import Api, query_of
from kleinkram.client._nouns import Listing, Ref, checked, known_id, pages, resolve_one
from kleinkram.client.projects import Projects
from kleinkram.contract.actions import (
    ActionCreate,
    ActionDefinition,
    ActionFilter,
    ActionRead,
    ActionUpdate,
    ActionVersionRead,
    VersionCreate,
)
from kleinkram.contract.errors import NotFound


class Actions:
    """`client.actions`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(
        self,
        *,
        name: str | None = None,
        project: Ref | None = None,
        archived: bool = False,
        limit: int | None = None,
    ) -> Listing[ActionRead]:
        """Yield actions by name, which may be a glob; of a project: its own, and the whole lab's.

        Those that are archived are listed alone.

        Raises:
            NotFound: there is no such project.
        """
        matching = checked(
            ActionFilter, "The filter", name=name, project_id=self._project_id(project), archived=archived
        )
        return pages(self._api, "/actions", ActionRead, query_of(matching), limit=limit)

    def get(self, ref: Ref, *, project: Ref | None = None) -> ActionRead:
        """Return the action with this id, or with this name: of a project and the whole lab's, where one is given.

        Raises:
            NotFound: there is none.
            AmbiguousName: several have that name, such as one of a project and one of the whole lab.
        """
        if (action_id := known_id(ref, "action")) is not None:
            return self._api.get(f"/actions/{action_id}", ActionRead)
        ref = str(ref)
        project_id = self._project_id(project)
        rows = [*self.list(name=ref, project=project_id)] or [*self.list(name=ref, project=project_id, archived=True)]
        return resolve_one("action", ref, rows, name=lambda row: row.name, label=action_label)

    def create(
        self, definition: ActionDefinition, *, project: Ref | None = None, project_id: Ref | None = None
    ) -> ActionRead:
        """Publish an action in a project, or for the whole lab, as its version 1.

        `kleinkram.client.manifest.read_manifest` makes a definition of a script or of a folder with `action.yaml`.

        Raises:
            NameTaken: there is one of that name; `add_version` publishes its next version.
            Forbidden: that takes WRITE on the project; for the lab, the right to make projects.
        """
        where = self._project_id(project if project is not None else project_id)
        body = checked(ActionCreate, "The action", project_id=where, definition=definition)
        return self._api.send("POST", "/actions", ActionRead, body)

    def add_version(self, action_id: Ref, definition: ActionDefinition, *, if_match: str | None = None) -> ActionRead:
        """Publish the next version of an action, under the name that it has; earlier ones stay and can be run.

        With `if_match`, the `etag` of what was looked at, it is refused where somebody else came first.

        Raises:
            Forbidden: it is not yours to change.
            EditConflict: it is of another ETag by now.
        """
        body = checked(VersionCreate, "The version", definition=definition)
        return self._api.send("POST", f"/actions/{self._id(action_id)}/versions", ActionRead, body, etag=if_match)

    def versions(self, action_id: Ref) -> Listing[ActionVersionRead]:
        """Yield the versions of an action, latest first."""
        return pages(self._api, f"/actions/{self._id(action_id)}/versions", ActionVersionRead, [])

    def version(self, action: ActionRead, number: int | None = None) -> ActionVersionRead:
        """Return a version of an action by its number; without one, the latest.

        Raises:
            NotFound: it has no such version.
        """
        if number is None or number == action.latest.number:
            return action.latest
        found = next((each for each in self.versions(action.id) if each.number == number), None)
        if found is None:
            raise NotFound(noun="version", ref=f"{action.name}@{number}")
        return found

    def archive(self, action_id: Ref, *, archived: bool = True, if_match: str | None = None) -> ActionRead:
        """Take an action out of lists, so that nobody runs it anew, or put it back; its runs stay.

        With `if_match`, the `etag` of what was looked at, it is refused where somebody else came first.

        Raises:
            Forbidden: it is not yours to change.
            EditConflict: it is of another ETag by now.
        """
        body = checked(ActionUpdate, "The action", archived=archived)
        return self._api.patch(f"/actions/{self._id(action_id)}", ActionRead, body, etag=if_match)

    def _project_id(self, project: Ref | None) -> uuid.UUID | None:
        return None if project is None else Projects(self._api).id_of(project)

    def _id(self, action: Ref) -> uuid.UUID:
        return known_id(action, "action") or self.get(action).id


def action_label(action: ActionRead) -> str:
    """Return how an action is listed among candidates."""
    place = f"{action.project.name}/{action.name}" if action.project else f"{action.name} of the whole lab"
    return f"{place} ({action.id})"
