"""Routes of the home page."""

from fastapi import APIRouter

from kleinkram.contract.home import HomeRead, HomeStorage
from kleinkram.server.home import service
from kleinkram.server.http.dependencies import CurrentActor, CurrentContext, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES

router = APIRouter(prefix="/api/v1", tags=["home"], responses=FAILURE_RESPONSES)


@router.get("/home", operation_id="get_home")
async def get_home(context: CurrentContext, actor: CurrentActor) -> HomeRead:
    """Return recent missions, your unfinished uploads, and what needs attention."""
    return await service.get_home(context, actor)


@router.get("/home/storage", operation_id="get_home_storage")
async def get_home_storage(context: CurrentContext, actor: CurrentActor, db: Transaction) -> HomeStorage:
    """Return the size of the largest projects and, for admins, of the store."""
    return await service.get_storage(db, actor, context.settings)
