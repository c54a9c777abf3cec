"""People over HTTP."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict

from kleinkram.contract.names import Term
from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.contract.people import Departure, PersonRead
from kleinkram.server.http.dependencies import CurrentActor, Transaction
from kleinkram.server.paging import PageRequest
from kleinkram.server.people import service

router = APIRouter(prefix="/api/v1/people", tags=["people"])


class PeopleListQuery(BaseModel):
    """The query of a list of people. Every word of `text` is in their name, or in an address that one may know."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    text: Term | None = None
    active: bool | None = None
    limit: PageSize = 100
    cursor: Cursor | None = None
    count: bool = False


@router.get("", operation_id="list_people")
async def list_people(
    query: Annotated[PeopleListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[PersonRead]:
    """List the people one may know of: who shares a group or a project; admins see all."""
    page = PageRequest(query.limit, query.cursor, query.count)
    return await service.list_people(db, actor, text=query.text, active=query.active, page=page)


@router.get("/{person_id}", operation_id="get_person")
async def get_person(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> PersonRead:
    """Return one person."""
    return await service.get_person(db, actor, person_id)


@router.post("/{person_id}/admin", operation_id="make_admin")
async def make_admin(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> PersonRead:
    """Make somebody an admin, without an end."""
    return await service.appoint(db, actor, person_id)


@router.delete("/{person_id}/admin", operation_id="unmake_admin")
async def unmake_admin(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> PersonRead:
    """Take the power of an admin from somebody; the last lasting one keeps it."""
    return await service.dismiss(db, actor, person_id)


@router.post("/{person_id}/deactivate", operation_id="deactivate_person")
async def deactivate_person(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> Departure:
    """End somebody's sessions, tokens and links at once; what only they owned goes to the admins."""
    return await service.deactivate(db, actor, person_id)


@router.post("/{person_id}/reactivate", operation_id="reactivate_person")
async def reactivate_person(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> PersonRead:
    """Let somebody who left sign in again; their tokens stay revoked."""
    return await service.reactivate(db, actor, person_id)
