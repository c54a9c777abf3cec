"""`/health/live`, `/health/ready`, `/metrics` and `/api/v1/service`."""

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import CONTENT_TYPE_LATEST

import kleinkram
from kleinkram.contract.people import ServiceRead
from kleinkram.server import measures
from kleinkram.server.dependencies import CurrentActor, CurrentSettings, CurrentStorage, Transaction
from kleinkram.server.migrations import at_head

probes = APIRouter(include_in_schema=False)
router = APIRouter(prefix="/api/v1", tags=["service"])


@probes.get("/health/live")
async def live() -> PlainTextResponse:
    """Say that this process answers."""
    return PlainTextResponse("live\n")


@probes.get("/health/ready")
async def ready(db: Transaction, storage: CurrentStorage) -> PlainTextResponse:
    """Say whether database, schema and store are all there."""
    if not await at_head(db):
        return PlainTextResponse("the database schema is not this version's; run the migrations\n", status_code=503)
    await storage.check()
    return PlainTextResponse("ready\n")


@probes.get("/metrics")
async def metrics(db: Transaction) -> Response:
    """Give this process's measures in the Prometheus text format."""
    return Response(await measures.exposition(db), media_type=CONTENT_TYPE_LATEST)


@router.get("/service", operation_id="get_service")
async def service(actor: CurrentActor, storage: CurrentStorage, settings: CurrentSettings) -> ServiceRead:
    """Say what this server is, and who you are to it."""
    return ServiceRead(
        version=kleinkram.__version__,
        public_url=settings.public_url,
        store_url=settings.store_public_url,
        checksum=storage.checksum.value,
        person=actor.ref,
    )
