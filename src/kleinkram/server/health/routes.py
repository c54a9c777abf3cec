"""`/health/live`, `/health/ready`, `/metrics` and `/api/v1/service`."""

import ipaddress

from fastapi import APIRouter, Request, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import CONTENT_TYPE_LATEST

import kleinkram
from kleinkram.contract.errors import NotFound
from kleinkram.contract.people import ServiceRead, ViewerRead
from kleinkram.contract.rights import TokenKind
from kleinkram.server import measures
from kleinkram.server.dependencies import CurrentActor, CurrentDatabase, CurrentSettings, CurrentStorage
from kleinkram.server.health.readiness import missing
from kleinkram.server.health.recent import Recent
from kleinkram.server.settings import Settings
from kleinkram.server.tokens.service import default_days

# Probes and scrapes come without a token: whatever their number, they look no more often than this.
_HOLDS_S = 1

probes = APIRouter(include_in_schema=False)
router = APIRouter(prefix="/api/v1", tags=["service"])


@probes.get("/health/live")
async def live() -> PlainTextResponse:
    """Say that this process answers."""
    return PlainTextResponse("live\n")


@probes.get("/health/ready")
async def ready(
    request: Request, database: CurrentDatabase, storage: CurrentStorage, settings: CurrentSettings
) -> PlainTextResponse:
    """Say whether database, schema and store are all there; what is missing is for those who watch the server."""
    state = request.app.state
    if not hasattr(state, "readiness"):
        state.readiness = Recent(lambda: missing(database, storage), holds_s=_HOLDS_S)
    reason: str | None = await state.readiness.get()
    if reason is None:
        return PlainTextResponse("ready\n")
    return PlainTextResponse(f"{reason if _watches(request, settings) else 'not ready'}\n", status_code=503)


@probes.get("/metrics")
async def metrics(request: Request, database: CurrentDatabase, settings: CurrentSettings) -> Response:
    """Give this process's measures in the Prometheus text format, to those who watch the server."""
    if not _watches(request, settings):
        raise NotFound(noun="page", ref="/metrics")
    state = request.app.state
    if not hasattr(state, "gauges"):
        state.gauges = Recent(lambda: measures.look(database), holds_s=_HOLDS_S)
    return Response(measures.exposition(await state.gauges.get()), media_type=CONTENT_TYPE_LATEST)


def _watches(request: Request, settings: Settings) -> bool:
    """Say whether a request comes from where the server is watched, and not through a proxy that hides who asks."""
    if request.client is None or ("x-forwarded-for" in request.headers and not settings.trusted_proxies):
        return False
    address = ipaddress.ip_address(request.client.host)
    return any(address in network for network in settings.watcher_networks)


@router.get("/service", operation_id="get_service")
async def service(actor: CurrentActor, storage: CurrentStorage, settings: CurrentSettings) -> ServiceRead:
    """Say what this server is, and who you are to it."""
    return ServiceRead(
        name=settings.lab_name,
        version=kleinkram.__version__,
        public_url=settings.public_url,
        store_url=settings.store_public_url,
        store_origin=settings.store_origin,
        checksum=storage.checksum.value,
        token_days_default=default_days(TokenKind.personal, settings) or 0,
        token_days_max=settings.token_days_max,
        has_local_accounts=settings.local_accounts,
        viewers=[ViewerRead(name=each.name, url=each.url) for each in settings.viewers],
        person=actor.ref,
    )
