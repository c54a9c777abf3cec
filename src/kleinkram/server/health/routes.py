"""`/health/live`, `/health/ready` and `/api/v1/service`."""

import asyncio
import ipaddress
from collections.abc import AsyncIterator

from fastapi import APIRouter, Request, Response
from fastapi.responses import PlainTextResponse, StreamingResponse

import kleinkram
from kleinkram.contract.access import TokenKind
from kleinkram.contract.people import MapTiles, ServiceRead, ViewerRead
from kleinkram.diagnostics import Diagnostic, DiagnosticSeverity, find_problems
from kleinkram.server.health.readiness import CachedLookup, check_service
from kleinkram.server.http.dependencies import CurrentActor, CurrentDatabase, CurrentSettings, CurrentStorage
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import EVENT_STREAM, UNBUFFERED, request_origin
from kleinkram.server.http.middleware import mark_as_stream
from kleinkram.server.settings import Settings
from kleinkram.server.tokens.service import default_days

# Probes need no token, so the result is cached for this long.
_HOLDS_S = 1
_PAUSE_S = 4
_STOPPING = "This process is stopping."

probes = APIRouter(include_in_schema=False)
router = APIRouter(prefix="/api/v1", tags=["service"], responses=FAILURE_RESPONSES)


@probes.get("/health/live")
async def live(request: Request, settings: CurrentSettings) -> Response:
    """Answer; for `check`, with how its request reached this process."""
    if (origin := request_origin(request, settings)) is not None:
        if request.headers.get("accept") == EVENT_STREAM:
            mark_as_stream(request.scope)
            return StreamingResponse(_event_and_pause(), media_type=EVENT_STREAM, headers=UNBUFFERED)
        return Response(origin.model_dump_json(), media_type="application/json")
    return PlainTextResponse("live\n")


async def _event_and_pause() -> AsyncIterator[str]:
    """Yield an event, and the end only later: a proxy that collects a whole response holds the event back."""
    yield "event: live\n\n"
    await asyncio.sleep(_PAUSE_S)


@probes.get("/health/ready")
async def ready(
    request: Request, database: CurrentDatabase, storage: CurrentStorage, settings: CurrentSettings
) -> PlainTextResponse:
    """Return whether database, schema and store are available; reasons and warnings only for monitoring networks.

    A process that stops is not ready.
    """
    state = request.app.state
    if not hasattr(state, "readiness"):
        state.readiness = CachedLookup(lambda: check_service(database, storage), holds_s=_HOLDS_S)
    results: list[Diagnostic] = await state.readiness.get()
    shows = _watches(request, settings)
    reasons = [_STOPPING] if state.is_draining else [problem.message for problem in find_problems(results)]
    if reasons:
        return PlainTextResponse(f"{reasons[0] if shows else 'not ready'}\n", status_code=503)
    warnings = [result for result in results if shows and result.severity is DiagnosticSeverity.warning]
    return PlainTextResponse("".join(["ready\n", *(f"warning: {it.message} {it.remedy}\n" for it in warnings)]))


def _watches(request: Request, settings: Settings) -> bool:
    """Whether a request comes from a monitoring network, and not through an untrusted proxy."""
    if request.client is None or ("x-forwarded-for" in request.headers and not settings.trusted_proxies):
        return False
    address = ipaddress.ip_address(request.client.host)
    return any(address in network for network in settings.monitoring_networks)


@router.get("/service", operation_id="get_service")
async def service(actor: CurrentActor, storage: CurrentStorage, settings: CurrentSettings) -> ServiceRead:
    """Return what this server is, and who you are."""
    return ServiceRead(
        name=settings.lab_name,
        version=kleinkram.__version__,
        public_url=settings.public_url,
        store_url=settings.store_public_url,
        store_origin=settings.store_origin,
        checksum=storage.checksum.value,
        token_days_default=default_days(TokenKind.personal, settings) or 0,
        token_days_max=settings.token_days_max,
        weakest_isolation=settings.weakest_isolation,
        has_local_accounts=settings.local_accounts,
        viewers=[ViewerRead(name=viewer.name, url=viewer.url) for viewer in settings.viewers],
        map_tiles=_map_tiles(settings),
        person=actor.ref,
    )


def _map_tiles(settings: Settings) -> MapTiles | None:
    url, attribution = settings.map_tiles_url, settings.map_tiles_attribution
    if url is None or attribution is None:
        return None
    return MapTiles(url=url, attribution=attribution, max_zoom=settings.map_tiles_max_zoom)
