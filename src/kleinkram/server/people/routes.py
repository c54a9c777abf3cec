"""Routes of people."""

import uuid
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import StreamingResponse

from kleinkram.contract.base import Page
from kleinkram.contract.names import Term
from kleinkram.contract.people import Departure, Erasure, PersonErase, PersonRead
from kleinkram.server.http.dependencies import CurrentActor, CurrentDatabase, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.pagination import CountedPageQuery
from kleinkram.server.people import erasure, export, service

router = APIRouter(prefix="/api/v1/people", tags=["people"], responses=FAILURE_RESPONSES)
_JSON_LINES = "application/jsonl"


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


@router.post("/{person_id}/erase", operation_id="erase_person")
async def erase_person(person_id: uuid.UUID, request: PersonErase, db: Transaction, actor: CurrentActor) -> Erasure:
    """Erase a person irrevocably: their data is deleted, and a pseudonym replaces their name. The second time, report.

    What they did stays on record. Texts that mention them are reported, and stay as they are.
    """
    return await erasure.erase_person(db, actor, person_id=person_id, confirmation=request.confirmation)


@router.get("/{person_id}/erasure", operation_id="get_erasure")
async def get_erasure(person_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> Erasure:
    """Return whether the audit log of an erased person is redacted."""
    return await erasure.get_erasure(db, person_id)


@router.get(
    "/{person_id}/export",
    operation_id="export_person",
    response_class=StreamingResponse,
    responses={200: {"description": "One record a line.", "content": {_JSON_LINES: {"schema": {"type": "string"}}}}},
)
async def export_person(person_id: uuid.UUID, database: CurrentDatabase, actor: CurrentActor) -> StreamingResponse:
    """Return all that is kept of a person, one JSON object a line: for yourself, or as an admin for anybody."""
    async with database.begin() as db:
        await export.begin_export(db, actor, person_id)

    async def lines() -> AsyncIterator[str]:
        async for record in export.export_person(database, actor, person_id):
            yield record.model_dump_json() + "\n"

    return StreamingResponse(lines(), media_type=_JSON_LINES)
