"""Adds shipped actions to a project or the whole lab, as versions of an action of their name."""

import uuid

from kleinkram import __version__
from kleinkram.contract.actions import ActionDefinition, ActionRead
from kleinkram.contract.errors import NotFound, NotFromLibrary
from kleinkram.contract.library import LIBRARY_PREFIX, LibraryActionRead, LibraryRead, LibraryState
from kleinkram.contract.names import name_key
from kleinkram.library import shipped_actions
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_project
from kleinkram.server.actions import dependency_locks, service
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.settings import Settings

# The fields of a definition that the list shows.
_SHOWN = LibraryActionRead.model_fields.keys() & ActionDefinition.model_fields.keys() - {"name"}


async def list_library(
    db: Connection, actor: Actor, settings: Settings, *, project_id: uuid.UUID | None
) -> LibraryRead:
    """Return the shipped actions, and which of them a project, or the whole lab, has.

    Raises:
        NotFound: the project is not there, or not for this actor.
    """
    if project_id is not None:
        await require_project(db, actor, "list_library", project_id)
    existing = await service.find_actions(db, actor, project_id=project_id)
    items = [_to_read(shipped, existing.get(name_key(name)), settings) for name, shipped in shipped_actions().items()]
    return LibraryRead(items=items)


def _to_read(shipped: ActionDefinition, existing: ActionRead | None, settings: Settings) -> LibraryActionRead:
    return LibraryActionRead(
        **{name: getattr(shipped, name) for name in _SHOWN},
        name=f"{LIBRARY_PREFIX}{shipped.name}",
        version=__version__,
        state=LibraryState.available if existing is None else _state(shipped, existing.latest.definition, settings),
        action_id=existing.id if existing else None,
        action_version=existing.latest.number if existing else None,
    )


def _state(shipped: ActionDefinition, latest: ActionDefinition, settings: Settings) -> LibraryState:
    if not _is_from_library(latest):
        return LibraryState.name_taken
    is_unlocked = latest.lock is None and dependency_locks.needs_lock(shipped, settings)
    if is_unlocked or not service.is_same(shipped, latest.model_copy(update={"lock": None})):
        return LibraryState.outdated
    return LibraryState.added


def _is_from_library(definition: ActionDefinition) -> bool:
    return definition.library is not None and definition.library.startswith(f"{LIBRARY_PREFIX}{definition.name}@")


async def add_from_library(context: AppContext, actor: Actor, *, name: str, project_id: uuid.UUID | None) -> ActionRead:
    """Publish a shipped action, or its next version, and return the action; unchanged where nothing newer is shipped.

    Opens its own transactions.

    Raises:
        NotFound: the library has no such action; or the project is not there, or not for this actor.
        Forbidden: this actor may not publish there, or may not change that action of the whole lab.
        NotFromLibrary: there is another action of that name.
        InvalidRequest: its dependencies cannot be locked.
        NameTaken, EditConflict: somebody else published it, or its next version, in the meantime.
    """
    shipped = shipped_actions().get(name)
    if shipped is None:
        raise NotFound(resource_type="action of the library", ref=f"{LIBRARY_PREFIX}{name}")
    definition = shipped.model_copy(update={"library": f"{LIBRARY_PREFIX}{name}@{__version__}"})
    async with context.database.begin() as db:
        await service.require_publisher(db, actor, project_id, context.settings.creators)
        existing = (await service.find_actions(db, actor, project_id=project_id)).get(name_key(name))
    if existing is None:
        return await service.create_action(context, actor, project_id=project_id, definition=definition)
    if not _is_from_library(existing.latest.definition):
        raise NotFromLibrary(name=existing.name)
    return await service.add_version(
        context, actor, action_id=existing.id, definition=definition, if_match=existing.etag
    )
