"""Groups over HTTP."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict

from kleinkram.contract.groups import GroupCreate, GroupRead, GroupUpdate, MemberRead, MemberSet
from kleinkram.contract.names import Term
from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.server.groups import service
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Transaction
from kleinkram.server.http.etags import IfMatch
from kleinkram.server.paging import PageRequest

router = APIRouter(prefix="/api/v1/groups", tags=["groups"])


class GroupListQuery(BaseModel):
    """The query of a list of groups. `name` may be a glob."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Term | None = None
    limit: PageSize = 100
    cursor: Cursor | None = None
    count: bool = False


class MemberListQuery(BaseModel):
    """Which page of a list of members."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    limit: PageSize = 100
    cursor: Cursor | None = None
    count: bool = False


@router.get("", operation_id="list_groups")
async def list_groups(
    query: Annotated[GroupListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[GroupRead]:
    """List the groups one is in, by name; admins see all."""
    page = PageRequest(query.limit, query.cursor, query.count)
    return await service.list_groups(db, actor, name=query.name, page=page)


@router.post("", operation_id="create_group", status_code=201)
async def create_group(
    wanted: GroupCreate, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> GroupRead:
    """Make a group; its maker is its first member and editor."""
    return await service.create_group(db, actor, wanted=wanted, creators=settings.creators)


@router.get("/{group_id}", operation_id="get_group")
async def get_group(group_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> GroupRead:
    """Return one group."""
    return await service.get_group(db, actor, group_id)


@router.patch("/{group_id}", operation_id="update_group")
async def update_group(
    group_id: uuid.UUID, changes: GroupUpdate, db: Transaction, actor: CurrentActor, if_match: IfMatch = None
) -> GroupRead:
    """Rename a group. With If-Match, only where it is still of that ETag."""
    return await service.rename_group(db, actor, group_id=group_id, changes=changes, if_match=if_match)


@router.delete("/{group_id}", operation_id="delete_group", status_code=204)
async def delete_group(group_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Delete a group, and with it what was granted to it."""
    await service.delete_group(db, actor, group_id)


@router.get("/{group_id}/members", operation_id="list_group_members")
async def list_group_members(
    group_id: uuid.UUID, query: Annotated[MemberListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[MemberRead]:
    """List the people in a group, by name; addresses and those whose time is over are for its editors."""
    page = PageRequest(query.limit, query.cursor, query.count)
    return await service.list_members(db, actor, group_id=group_id, page=page)


@router.put("/{group_id}/members/{person_id}", operation_id="set_group_member")
async def set_group_member(
    group_id: uuid.UUID,
    person_id: uuid.UUID,
    wanted: MemberSet,
    db: Transaction,
    actor: CurrentActor,
    if_match: IfMatch = None,
) -> MemberRead:
    """Put somebody into a group, or change how and until when they are in it.

    With If-Match, only where they are in it, and their membership is still of that ETag.
    """
    return await service.set_member(db, actor, group_id=group_id, person_id=person_id, wanted=wanted, if_match=if_match)


@router.delete("/{group_id}/members/{person_id}", operation_id="remove_group_member", status_code=204)
async def remove_group_member(group_id: uuid.UUID, person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Take somebody out of a group, or leave it."""
    await service.remove_member(db, actor, group_id=group_id, person_id=person_id)
