"""Home over HTTP."""

from fastapi import APIRouter

from kleinkram.contract.home import HomeRead, HomeStorage
from kleinkram.server.home import service
from kleinkram.server.http.dependencies import CurrentActor, CurrentContext, Transaction

router = APIRouter(prefix="/api/v1", tags=["home"])


@router.get("/home", operation_id="get_home")
async def get_home(context: CurrentContext, actor: CurrentActor) -> HomeRead:
    """Return what moved lately, what you left unfinished, and what needs attention."""
    return await service.get_home(context, actor)


@router.get("/home/storage", operation_id="get_home_storage")
async def get_home_storage(context: CurrentContext, actor: CurrentActor, db: Transaction) -> HomeStorage:
    """Return what the largest projects take, and, to admins, what the store holds."""
    return await service.get_storage(db, actor, context.settings)
