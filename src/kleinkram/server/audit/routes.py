"""Routes of the audit log, which is read-only."""

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import StreamingResponse

from kleinkram.contract.audit import AuditFilter, AuditRead
from kleinkram.contract.base import Page
from kleinkram.server.audit import service
from kleinkram.server.http.dependencies import CurrentActor, CurrentDatabase, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.pagination import PageQuery

router = APIRouter(prefix="/api/v1/audit", tags=["audit"], responses=FAILURE_RESPONSES)

_JSON_LINES = "application/jsonl"


class AuditListQuery(AuditFilter, PageQuery):
    """Query parameters of the list of events."""


@router.get("", operation_id="list_audit_events")
async def list_audit_events(
    query: Annotated[AuditListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[AuditRead]:
    """List audit events, latest first."""
    return await service.list_events(db, actor, matching=query, page=query.page)


@router.get(
    "/export",
    operation_id="export_audit_events",
    response_class=StreamingResponse,
    responses={200: {"description": "One event a line.", "content": {_JSON_LINES: {"schema": {"type": "string"}}}}},
)
async def export_audit_events(
    query: Annotated[AuditFilter, Query()], database: CurrentDatabase, actor: CurrentActor
) -> StreamingResponse:
    """Return all events that match, oldest first, one JSON object a line."""

    async def lines() -> AsyncIterator[str]:
        async for event in service.export_events(database, actor, matching=query):
            yield event.model_dump_json() + "\n"

    return StreamingResponse(lines(), media_type=_JSON_LINES)
