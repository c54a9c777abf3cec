"""Routes of groups."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.access import GroupCreate, GroupRead, GroupUpdate, MemberRead, MemberSet
from kleinkram.contract.base import Page
from kleinkram.contract.names import Term
from kleinkram.server.groups import service
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import IfMatch
from kleinkram.server.pagination import CountedPageQuery

router = APIRouter(prefix="/api/v1/groups", tags=["groups"], responses=FAILURE_RESPONSES)


class GroupListQuery(CountedPageQuery):
    """Query parameters of the list of groups. `name` may be a glob."""

    name: Term | None = None


@router.get("", operation_id="list_groups")
async def list_groups(
    query: Annotated[GroupListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[GroupRead]:
    """List your groups by name; admins see all."""
    return await service.list_groups(db, actor, name=query.name, page=query.page)


@router.post("", operation_id="create_group", status_code=201)
async def create_group(
    request: GroupCreate, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> GroupRead:
    """Create a group; you become its first member and editor."""
    return await service.create_group(db, actor, request=request, creators=settings.creators)


@router.get("/{group_id}", operation_id="get_group")
async def get_group(group_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> GroupRead:
    """Return one group."""
    return await service.get_group(db, actor, group_id)


@router.patch("/{group_id}", operation_id="update_group")
async def update_group(
    group_id: uuid.UUID, changes: GroupUpdate, db: Transaction, actor: CurrentActor, if_match: IfMatch = None
) -> GroupRead:
    """Rename a group; with If-Match, only if it still has that ETag."""
    return await service.rename_group(db, actor, group_id=group_id, changes=changes, if_match=if_match)


@router.delete("/{group_id}", operation_id="delete_group", status_code=204)
async def delete_group(group_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Delete a group and the grants to it."""
    await service.delete_group(db, actor, group_id)


@router.get("/{group_id}/members", operation_id="list_group_members")
async def list_group_members(
    group_id: uuid.UUID, query: Annotated[CountedPageQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[MemberRead]:
    """List the members of a group by name; addresses and past members are for its editors."""
    return await service.list_members(db, actor, group_id=group_id, page=query.page)


@router.put("/{group_id}/members/{person_id}", operation_id="set_group_member")
async def set_group_member(
    group_id: uuid.UUID,
    person_id: uuid.UUID,
    request: MemberSet,
    db: Transaction,
    actor: CurrentActor,
    if_match: IfMatch = None,
) -> MemberRead:
    """Add a person to a group, or change their membership; with If-Match, only if it still has that ETag."""
    return await service.set_member(
        db, actor, group_id=group_id, person_id=person_id, request=request, if_match=if_match
    )


@router.delete("/{group_id}/members/{person_id}", operation_id="remove_group_member", status_code=204)
async def remove_group_member(group_id: uuid.UUID, person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Remove a person from a group, or leave it."""
    await service.remove_member(db, actor, group_id=group_id, person_id=person_id)
