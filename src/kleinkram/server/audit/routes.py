"""The record over HTTP: it can be read, and nothing else."""

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import StreamingResponse

from kleinkram.contract.audit import AuditFilter, AuditRead
from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.server.audit import service
from kleinkram.server.http.dependencies import CurrentActor, CurrentDatabase, Transaction
from kleinkram.server.paging import PageRequest

router = APIRouter(prefix="/api/v1/audit", tags=["audit"])

_JSON_LINES = "application/jsonl"


class AuditListQuery(AuditFilter):
    """The query of a list of events."""

    limit: PageSize = 100
    cursor: Cursor | None = None


@router.get("", operation_id="list_audit_events")
async def list_audit_events(
    query: Annotated[AuditListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[AuditRead]:
    """List what happened, latest first."""
    return await service.list_events(db, actor, matching=query, page=PageRequest(query.limit, query.cursor))


@router.get(
    "/export",
    operation_id="export_audit_events",
    response_class=StreamingResponse,
    responses={200: {"description": "One event a line.", "content": {_JSON_LINES: {"schema": {"type": "string"}}}}},
)
async def export_audit_events(
    query: Annotated[AuditFilter, Query()], database: CurrentDatabase, actor: CurrentActor
) -> StreamingResponse:
    """Give all events that match, oldest first, one JSON object a line."""

    async def lines() -> AsyncIterator[str]:
        async for event in service.export_events(database, actor, matching=query):
            yield event.model_dump_json() + "\n"

    return StreamingResponse(lines(), media_type=_JSON_LINES)
