"""Routes of people."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.base import Page
from kleinkram.contract.names import Term
from kleinkram.contract.people import Departure, PersonRead
from kleinkram.server.http.dependencies import CurrentActor, Transaction
from kleinkram.server.pagination import CountedPageQuery
from kleinkram.server.people import service

router = APIRouter(prefix="/api/v1/people", tags=["people"])


class PeopleListQuery(CountedPageQuery):
    """Query parameters of the list of people. `text`: words in their names, or in addresses you may know."""

    text: Term | None = None
    active: bool | None = None


@router.get("", operation_id="list_people")
async def list_people(
    query: Annotated[PeopleListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[PersonRead]:
    """List the people who share a group or a project with you; admins see all."""
    return await service.list_people(db, actor, text=query.text, active=query.active, page=query.page)


@router.get("/{person_id}", operation_id="get_person")
async def get_person(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> PersonRead:
    """Return one person."""
    return await service.get_person(db, actor, person_id)


@router.post("/{person_id}/admin", operation_id="make_admin")
async def make_admin(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> PersonRead:
    """Make a person a permanent admin."""
    return await service.appoint_admin(db, actor, person_id)


@router.delete("/{person_id}/admin", operation_id="unmake_admin")
async def unmake_admin(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> PersonRead:
    """Remove a person from the admins, unless they are the last permanent one."""
    return await service.dismiss_admin(db, actor, person_id)


@router.post("/{person_id}/deactivate", operation_id="deactivate_person")
async def deactivate_person(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> Departure:
    """Deactivate a person: their sessions, tokens and links end; projects that only they owned go to the admins."""
    return await service.deactivate(db, actor, person_id)


@router.post("/{person_id}/reactivate", operation_id="reactivate_person")
async def reactivate_person(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> PersonRead:
    """Let a deactivated person sign in again; their tokens stay revoked."""
    return await service.reactivate(db, actor, person_id)
