"""Actions over HTTP."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.actions import (
    ActionCreate,
    ActionFilter,
    ActionRead,
    ActionUpdate,
    ActionVersionRead,
    VersionCreate,
)
from kleinkram.contract.base import Page
from kleinkram.contract.library import LibraryAdd, LibraryFilter, LibraryRead
from kleinkram.server.actions import library, service
from kleinkram.server.http.dependencies import CurrentActor, CurrentContext, Reading, Transaction, VersionNumber
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import IfMatch
from kleinkram.server.pagination import PageQuery

router = APIRouter(prefix="/api/v1/actions", tags=["actions"], responses=FAILURE_RESPONSES)
library_router = APIRouter(prefix="/api/v1/library", tags=["actions"], responses=FAILURE_RESPONSES)


class ActionListQuery(ActionFilter, PageQuery):
    """The query of a list of actions."""


@router.get("", operation_id="list_actions")
async def list_actions(
    query: Annotated[ActionListQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[ActionRead]:
    """List actions by name: those of projects that you may read, and those of the whole lab."""
    return await service.list_actions(db, actor, matching=query, page=query.page)


@router.post("", operation_id="create_action", status_code=201)
async def create_action(requested: ActionCreate, context: CurrentContext, actor: CurrentActor) -> ActionRead:
    """Publish an action. The dependencies of its script are locked, unless it has a lock."""
    project_id, definition = requested.project_id, requested.definition
    return await service.create_action(context, actor, project_id=project_id, definition=definition)


@router.get("/{action_id}", operation_id="get_action")
async def get_action(action_id: uuid.UUID, db: Reading, actor: CurrentActor) -> ActionRead:
    """Get an action with its latest version."""
    return await service.get_action(db, actor, action_id)


@router.patch("/{action_id}", operation_id="update_action")
async def update_action(
    action_id: uuid.UUID, changes: ActionUpdate, db: Transaction, actor: CurrentActor, if_match: IfMatch = None
) -> ActionRead:
    """Archive or restore an action. With If-Match, only if its ETag still matches."""
    return await service.set_archived(db, actor, action_id=action_id, archived=changes.archived, if_match=if_match)


@router.get("/{action_id}/versions", operation_id="list_action_versions")
async def list_action_versions(
    action_id: uuid.UUID, query: Annotated[PageQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[ActionVersionRead]:
    """List the versions of an action, latest first."""
    return await service.list_versions(db, actor, action_id=action_id, page=query.page)


@router.get("/{action_id}/versions/{number}", operation_id="get_action_version")
async def get_action_version(
    action_id: uuid.UUID, number: VersionNumber, db: Reading, actor: CurrentActor
) -> ActionVersionRead:
    """Get a version of an action, with its lock."""
    return await service.get_version(db, actor, action_id=action_id, number=number)


@router.post("/{action_id}/versions", operation_id="publish_action_version", status_code=201)
async def publish_action_version(
    action_id: uuid.UUID,
    requested: VersionCreate,
    context: CurrentContext,
    actor: CurrentActor,
    if_match: IfMatch = None,
) -> ActionRead:
    """Publish a further version of an action, locked like the first. With If-Match, only if its ETag still matches."""
    definition = requested.definition
    return await service.add_version(context, actor, action_id=action_id, definition=definition, if_match=if_match)


@library_router.get("", operation_id="list_library")
async def list_library(
    query: Annotated[LibraryFilter, Query()], context: CurrentContext, db: Reading, actor: CurrentActor
) -> LibraryRead:
    """List the actions that are shipped with this server, and which of them a project, or the whole lab, has."""
    return await library.list_library(db, actor, context.settings, project_id=query.project_id)


@library_router.post("/{name}", operation_id="add_from_library", status_code=201)
async def add_from_library(
    name: str, requested: LibraryAdd, context: CurrentContext, actor: CurrentActor
) -> ActionRead:
    """Publish a shipped action under its name, locked like others; where it was added before, its next version.

    It is unchanged where nothing newer is shipped.
    """
    return await library.add_from_library(context, actor, name=name, project_id=requested.project_id)
