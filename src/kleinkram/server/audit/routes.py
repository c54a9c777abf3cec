"""The record over HTTP: it can be read, and nothing else."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict

from kleinkram.contract.audit import AuditRead
from kleinkram.contract.names import Term
from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.server.audit import service
from kleinkram.server.dependencies import CurrentActor, Transaction
from kleinkram.server.pages import PageRequest

router = APIRouter(prefix="/api/v1/audit", tags=["audit"])


class AuditListQuery(BaseModel):
    """The query of a list of events."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    noun: Term | None = None
    noun_id: uuid.UUID | None = None
    project_id: uuid.UUID | None = None
    limit: PageSize = 100
    cursor: Cursor | None = None


@router.get("", operation_id="list_audit_events")
async def list_audit_events(
    query: Annotated[AuditListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[AuditRead]:
    """List what happened, latest first."""
    page = PageRequest(query.limit, query.cursor)
    return await service.list_events(
        db, actor, page=page, noun=query.noun, noun_id=query.noun_id, project_id=query.project_id
    )
