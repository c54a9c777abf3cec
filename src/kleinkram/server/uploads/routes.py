"""The upload protocol over HTTP."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.base import Cursor, Page, PageSize
from kleinkram.contract.uploads import (
    PartsSign,
    SignedParts,
    UploadBegin,
    UploadDecisions,
    UploadOutcomes,
    UploadRead,
    UploadsComplete,
)
from kleinkram.server.http.dependencies import CurrentActor, CurrentContext, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.pagination import PageRequest
from kleinkram.server.uploads import completion, parts, service

router = APIRouter(prefix="/api/v1", tags=["uploads"], responses=FAILURE_RESPONSES)


@router.post("/missions/{mission_id}/uploads", operation_id="begin_uploads")
async def begin(
    mission_id: uuid.UUID, body: UploadBegin, actor: CurrentActor, context: CurrentContext
) -> UploadDecisions:
    """Announce files to upload and learn what to send."""
    decisions = await service.begin_uploads(context, actor, mission_id=mission_id, requested=body.files)
    return UploadDecisions(items=decisions)


@router.get("/missions/{mission_id}/uploads", operation_id="list_uploads")
async def list_open(
    mission_id: uuid.UUID,
    actor: CurrentActor,
    db: Transaction,
    limit: Annotated[PageSize, Query()] = 100,
    cursor: Cursor | None = None,
) -> Page[UploadRead]:
    """List your open uploads into a mission."""
    return await service.list_uploads(db, actor, mission_id=mission_id, page=PageRequest(limit, cursor))


@router.get("/uploads/{upload_id}", operation_id="get_upload")
async def get(upload_id: uuid.UUID, actor: CurrentActor, context: CurrentContext) -> UploadRead:
    """Get one of your uploads, with the parts that the store has."""
    return await service.get_upload(context, actor, upload_id=upload_id)


@router.post("/uploads/parts", operation_id="sign_parts")
async def sign(body: PartsSign, actor: CurrentActor, context: CurrentContext) -> SignedParts:
    """Get the URLs to send parts to; this also renews the leases of their uploads."""
    return SignedParts(items=await parts.sign_parts(context, actor, parts=body.parts))


@router.post("/uploads/complete", operation_id="complete_uploads")
async def complete(body: UploadsComplete, actor: CurrentActor, context: CurrentContext) -> UploadOutcomes:
    """Finish uploads whose parts are all sent."""
    return UploadOutcomes(items=await completion.complete_uploads(context, actor, finishes=body.uploads))


@router.delete("/uploads/{upload_id}", operation_id="abort_upload", status_code=204)
async def abort(upload_id: uuid.UUID, actor: CurrentActor, context: CurrentContext) -> None:
    """Abort an upload."""
    await service.abort_upload(context, actor, upload_id=upload_id)
