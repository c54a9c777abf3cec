"""`klein action library` and `klein action add`: the actions that are shipped with Kleinkram."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from kleinkram import __version__
from kleinkram.cli import options
from kleinkram.cli.commands import Text, argument, closest, option
from kleinkram.cli.render import Output, as_list, note, table
from kleinkram.client import Client, connect
from kleinkram.client.actions import read_manifest
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.actions import ActionDefinition
from kleinkram.contract.library import LIBRARY_PREFIX, LibraryActionRead, LibraryState

_STATES = {
    LibraryState.available: "not added",
    LibraryState.added: "added as version {number}",
    LibraryState.outdated: "added as version {number}; a newer one is shipped",
    LibraryState.name_taken: "not added: there is another action of this name",
}


def library(
    project: options.ProjectOption = None,
    show: Annotated[
        Text, option("--show", "NAME", "Print the script of an action, as a file to change, and nothing else.")
    ] = None,
) -> Output:
    """List the actions that the server is shipped with, and which of them a project or the whole lab has."""
    if show is not None:
        return _script(_shipped(show))
    with connect() as client:
        return as_list(client.actions.library(project=project), _show)


def add(
    client: Client,
    action: Annotated[str, argument("ACTION", "Name of a shipped action, such as kleinkram/preview.")],
    project: options.ProjectOption = None,
) -> Output:
    """Add a shipped action to a project under its name. Without a project, add it for the whole lab.

    After an upgrade of the server, the same command publishes the next version, if there is one.
    """
    known = {entry.name: entry for entry in client.actions.library(project=project)}
    entry = known[_resolve(action, known)]
    added = client.actions.add_from_library(entry.name, project=project)
    number = added.latest.number
    place = f"in the project {added.project.name}" if added.project else "for the whole lab"
    if (entry.action_id, entry.action_version) == (added.id, number):
        return Output(added, f"{added.name}@{number} {place} is {entry.name} as it is shipped; nothing was published.")
    runs_itself = f"klein project actions add {added.name} -p {added.project.name if added.project else 'PROJECT'}"
    return Output(
        added, [f"Published {entry.name} {place} as {added.name}@{number}.", f"`{runs_itself}` lets it run by itself."]
    )


def read_action(path: Path) -> ActionDefinition:
    """Return the definition of a script or folder, or of a shipped action (`kleinkram/preview`) of this installation.

    Raises:
        InvalidInput: there is none, or it is not a definition.
    """
    if path.exists() or not str(path).startswith(LIBRARY_PREFIX):
        return read_manifest(path)
    definition = _shipped(str(path))
    note(f"{path} is that of kleinkram {__version__}, which is installed here.")
    return definition


def _shipped(name: str) -> ActionDefinition:
    from kleinkram.library import shipped_actions

    known = shipped_actions()
    return known[_resolve(name, known).removeprefix(LIBRARY_PREFIX)]


def _resolve(name: str, known: Iterable[str]) -> str:
    """Return the full name of a shipped action, which may be given without its prefix."""
    short_name = name.removeprefix(LIBRARY_PREFIX)
    short_names = [full_name.removeprefix(LIBRARY_PREFIX) for full_name in known]
    if short_name in short_names:
        return f"{LIBRARY_PREFIX}{short_name}"
    match = closest(short_name, short_names)
    listed = ", ".join(f"{LIBRARY_PREFIX}{known_name}" for known_name in short_names)
    hint = f"the closest is {LIBRARY_PREFIX}{match}" if match else f"it has {listed}"
    raise InvalidInput(what=f"The action {name!r}", reason=f"the library has none of this name; {hint}")


def _script(definition: ActionDefinition) -> Output:
    text = definition.script or ""
    return Output({"name": definition.name, "script": text}, lambda: sys.stdout.write(text))


def _show(entries: Iterable[LibraryActionRead]) -> None:
    table(
        ["action", "state", "description", "right", "network"],
        [
            (
                entry.name,
                _STATES[entry.state].format(number=entry.action_version),
                entry.description.partition("\n")[0],
                entry.right.value,
                entry.network.value,
            )
            for entry in entries
        ],
    )
