"""Actions: definitions of what to run on the data of a mission, in versions that never change; and their manifests.

A manifest is a folder with `action.yaml`, or one script that describes itself in its first comment. `if_match` is the
ETag that an action must still have to be changed, else EditConflict.
"""

import builtins
import uuid
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pydantic import ValidationError

from kleinkram.client._http import query_of
from kleinkram.client._resources import ApiResource, Listing, NamedResource, Ref, checked, known_id, pages, resolve_one
from kleinkram.client.errors import InvalidInput
from kleinkram.client.missions import Projects
from kleinkram.contract import project_actions as contract
from kleinkram.contract.actions import (
    ActionCreate,
    ActionDefinition,
    ActionFilter,
    ActionRead,
    ActionUpdate,
    ActionVersionRead,
    ParameterValues,
    VersionCreate,
)
from kleinkram.contract.library import LIBRARY_PREFIX, LibraryActionRead, LibraryAdd, LibraryFilter, LibraryRead
from kleinkram.contract.problems import first_problem
from kleinkram.contract.project_actions import ProjectActionAdd, ProjectActionRead, RunTrigger
from kleinkram.contract.scripts import read_script

MANIFEST = "action.yaml"
MAIN = "main.py"
_MAX_BYTES = 1_000_000
_MAX_DEPTH = 50


class Actions(NamedResource[ActionRead]):
    """`client.actions`."""

    _resource_type = "action"

    def list(
        self, *, name: str | None = None, project: Ref | None = None, archived: bool = False, limit: int | None = None
    ) -> Listing[ActionRead]:
        """Yield actions by name, which may be a glob; with a project, its own and the whole lab's; without their locks.

        Archived actions are listed alone.
        """
        matching = checked(
            ActionFilter, "The filter", name=name, project_id=self._project_id(project), archived=archived
        )
        return pages(self._api, "/actions", ActionRead, query_of(matching), limit=limit)

    def get(self, ref: Ref, *, project: Ref | None = None) -> ActionRead:
        """Return the action with this id, or this name: with a project, among its own and the whole lab's.

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

    def create(self, definition: ActionDefinition, *, project: Ref | None = None) -> ActionRead:
        """Publish an action in a project, or for the whole lab, as its version 1.

        `read_manifest` returns the definition of a script or of a folder with `action.yaml`.

        Raises:
            NameTaken: there is one of that name; `add_version` publishes its next version.
            Forbidden: it requires WRITE on the project; for the lab, the right to create projects.
        """
        body = checked(ActionCreate, "The action", project_id=self._project_id(project), definition=definition)
        return self._api.send("POST", "/actions", ActionRead, body)

    def add_version(self, action_id: Ref, definition: ActionDefinition, *, if_match: str | None = None) -> ActionRead:
        """Publish the next version of an action, under its name; earlier ones stay and can be run."""
        body = checked(VersionCreate, "The version", definition=definition)
        return self._api.send("POST", f"/actions/{self.id_of(action_id)}/versions", ActionRead, body, etag=if_match)

    def library(self, *, project: Ref | None = None) -> builtins.list[LibraryActionRead]:
        """Return the actions that the server is shipped with, and which of them a project or the whole lab has."""
        matching = checked(LibraryFilter, "The filter", project_id=self._project_id(project))
        return self._api.get("/library", LibraryRead, query_of(matching)).items

    def add_from_library(self, name: str, *, project: Ref | None = None) -> ActionRead:
        """Publish a shipped action (`kleinkram/preview`) in a project, or for the whole lab, under its name.

        Where it was added before, publish its next version; unchanged where nothing newer is shipped.

        Raises:
            NotFound: the library has no such action.
            NotFromLibrary: there is another action of that name.
            Forbidden: it requires WRITE on the project; for the lab, the right to create projects.
        """
        body = checked(LibraryAdd, "The action", project_id=self._project_id(project))
        return self._api.send("POST", f"/library/{quote(name.removeprefix(LIBRARY_PREFIX), safe='')}", ActionRead, body)

    def versions(self, action_id: Ref) -> Listing[ActionVersionRead]:
        """Yield the versions of an action, latest first, without their locks, which `version` returns."""
        return pages(self._api, f"/actions/{self.id_of(action_id)}/versions", ActionVersionRead, [])

    def version(self, action: ActionRead, number: int | None = None) -> ActionVersionRead:
        """Return a version of an action by its number, with its lock; without a number, the latest as in `action`.

        Raises:
            NotFound: there is none of that number.
        """
        if number is None:
            return action.latest
        return self._api.get(f"/actions/{action.id}/versions/{number}", ActionVersionRead)

    def archive(self, action_id: Ref, *, archived: bool = True, if_match: str | None = None) -> ActionRead:
        """Archive an action, which removes it from lists, or with `archived=False` restore it; its runs stay."""
        body = checked(ActionUpdate, "The action", archived=archived)
        return self._api.patch(f"/actions/{self.id_of(action_id)}", ActionRead, body, etag=if_match)

    def _project_id(self, project: Ref | None) -> uuid.UUID | None:
        return None if project is None else Projects(self._api).id_of(project)


def action_label(action: ActionRead) -> str:
    """Return an action as it is listed among candidates."""
    full_name = f"{action.project.name}/{action.name}" if action.project else f"{action.name} of the whole lab"
    return f"{full_name} ({action.id})"


class ProjectActions(ApiResource):
    """`client.project_actions`: the actions that a project names, which run by themselves and count for verdicts."""

    def list(self, project: Ref) -> list[ProjectActionRead]:
        """Return the actions that a project names, by name."""
        return [*self._api.get(self._path(project), contract.ProjectActionList).items]

    def add(
        self,
        project: Ref,
        action: Ref,
        *,
        on: RunTrigger | str,
        idle_s: int | None = None,
        parameters: ParameterValues | None = None,
    ) -> ProjectActionRead:
        """Have an action run by itself: `on="complete"`, or `on="idle"` once files have not changed for `idle_s`.

        It acts for you, with your rights at that time.
        """
        project_id = Projects(self._api).id_of(project)
        action_id = known_id(action, "action") or Actions(self._api).get(action, project=project_id).id
        fields = {"action_id": action_id, "on": on, "idle_s": idle_s, "parameters": parameters or {}}
        body = checked(ProjectActionAdd, "The action", **fields)
        return self._api.send("POST", self._path(project_id), ProjectActionRead, body)

    def remove(self, project: Ref, action: Ref) -> None:
        """Stop an action from running by itself, and its results from counting; its runs stay."""
        project_id = Projects(self._api).id_of(project)
        action_id = known_id(action, "action") or Actions(self._api).get(action, project=project_id).id
        self._api.delete(f"{self._path(project_id)}/{action_id}")

    def _path(self, project: Ref) -> str:
        return f"/projects/{Projects(self._api).id_of(project)}/actions"


def read_manifest(path: Path) -> ActionDefinition:
    """Return the action of a folder with `action.yaml` (else `main.py`), of such a file, or of a Python script.

    A script's PEP 723 header may have a table `[tool.kleinkram]` with all fields of `action.yaml`; the default name is
    that of the file. `dependencies` and `requires-python` are those that PEP 723 defines.

    Raises:
        InvalidInput: it is missing, or not a definition.
    """
    file = path
    if path.is_dir():
        file = path / (MAIN if (path / MAIN).exists() and not (path / MANIFEST).exists() else MANIFEST)
    try:
        with file.open("rb") as stream:
            text = stream.read(_MAX_BYTES).decode()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise InvalidInput(what=str(file), reason=f"cannot be read as an action: {reason}") from error
    try:
        if file.suffix == ".py":
            return read_script(text, name=file.stem)
        return ActionDefinition.model_validate(_of_yaml(file, text))
    except ValidationError as error:
        raise InvalidInput(what=str(file), reason=first_problem(error, "the action")) from error
    except ValueError as error:
        raise InvalidInput(what=str(file), reason=str(error)) from error


def _of_yaml(file: Path, text: str) -> dict[str, Any]:
    from ruamel.yaml.error import YAMLError  # slow to import

    from kleinkram.recordings.yaml_depth import shallow_yaml

    try:
        fields = shallow_yaml("safe", max_depth=_MAX_DEPTH).load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        raise InvalidInput(what=str(file), reason=f"is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(fields, dict):
        raise InvalidInput(what=str(file), reason="it is not a mapping of names to values")
    return fields
