"""Home over HTTP."""

from fastapi import APIRouter

from kleinkram.contract.home import HomeRead
from kleinkram.server.dependencies import CurrentActor, CurrentSite
from kleinkram.server.home import service

router = APIRouter(prefix="/api/v1", tags=["home"])


@router.get("/home", operation_id="get_home")
async def get_home(site: CurrentSite, actor: CurrentActor) -> HomeRead:
    """Return what moved lately, what you left unfinished, what needs attention, and what all takes."""
    return await service.get_home(site, actor)
