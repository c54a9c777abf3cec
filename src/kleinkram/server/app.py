"""The composition root of the API; no other module imports it."""

import logging
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute

import kleinkram
from kleinkram import traces
from kleinkram.metric_definitions import MetricSource
from kleinkram.server.access.operations import OPEN_PAGES, OPERATIONS
from kleinkram.server.actions.routes import library_router as library
from kleinkram.server.actions.routes import router as actions
from kleinkram.server.admin.routes import router as admin
from kleinkram.server.audit.requests import AdminReads, Refusals
from kleinkram.server.audit.routes import router as audit
from kleinkram.server.auth.bootstrap import ensure_local_owner, log_bootstrap_code
from kleinkram.server.auth.local_accounts import PasswordHasher
from kleinkram.server.auth.pages import router as sign_in_pages
from kleinkram.server.auth.providers import open_providers
from kleinkram.server.auth.routes import me_router, people_router
from kleinkram.server.auth.routes import router as auth
from kleinkram.server.checks.routes import router as checks
from kleinkram.server.db import open_database
from kleinkram.server.events.hub import open_hub
from kleinkram.server.events.routes import router as events
from kleinkram.server.files.routes import router as files
from kleinkram.server.files.slices import SliceSlots
from kleinkram.server.grants.routes import router as grants
from kleinkram.server.groups.affiliations import ensure_affiliations
from kleinkram.server.groups.routes import router as groups
from kleinkram.server.health.metrics_server import serve_metrics
from kleinkram.server.health.routes import probes
from kleinkram.server.health.routes import router as service
from kleinkram.server.home.routes import router as home_summary
from kleinkram.server.http.dependencies import requires_actor
from kleinkram.server.http.errors import install_error_handlers
from kleinkram.server.http.middleware import RequestMiddleware
from kleinkram.server.http.trace_middleware import TraceMiddleware
from kleinkram.server.http.web_app import router as web
from kleinkram.server.mission_events.routes import router as mission_events
from kleinkram.server.missions.routes import router as missions
from kleinkram.server.overviews.routes import router as overviews
from kleinkram.server.people.routes import router as people
from kleinkram.server.projects.routes import router as projects
from kleinkram.server.recordings.routes import router as recordings
from kleinkram.server.runners.routes import router as runners
from kleinkram.server.runs.routes import router as runs
from kleinkram.server.s3.capabilities import configure_cors, probe, record_capabilities
from kleinkram.server.s3.storage import open_storage
from kleinkram.server.search.routes import router as search
from kleinkram.server.settings import Settings
from kleinkram.server.shares.routes import page_router as share_page
from kleinkram.server.shares.routes import router as shares
from kleinkram.server.tokens.routes import router as tokens
from kleinkram.server.trash.routes import router as trash
from kleinkram.server.uploads.routes import router as uploads
from kleinkram.server.viewer_layouts.routes import router as viewer_layouts

_log = logging.getLogger("kleinkram.app")
ROUTERS = (
    probes,
    service,
    projects,
    missions,
    mission_events,
    viewer_layouts,
    files,
    recordings,
    overviews,
    checks,
    uploads,
    search,
    actions,
    library,
    runs,
    runners,
    trash,
    tokens,
    grants,
    groups,
    people,
    shares,
    audit,
    events,
    home_summary,
    admin,
    auth,
    me_router,
    people_router,
    sign_in_pages,
    share_page,
    web,
)


def create_app(settings: Settings) -> FastAPI:
    """Return the API; it connects when it starts."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        database = open_database(settings)
        try:
            async with (
                open_storage(settings) as store,
                open_providers(settings) as providers,
                open_hub(settings) as app.state.hub,
                serve_metrics(settings, database, MetricSource.api) as app.state.metrics_port,
            ):
                abilities = await probe(store)
                async with database.begin() as db:
                    await record_capabilities(db, settings.store_id, abilities)
                    await ensure_affiliations(db, settings.affiliations)
                    if settings.owner_token_file is None:
                        await log_bootstrap_code(db)
                    else:
                        await ensure_local_owner(db, settings.owner_token_file)
                app.state.database = database
                app.state.providers = providers
                app.state.password_hasher = PasswordHasher()
                app.state.storage = store.with_capabilities(abilities)
                app.state.pages_may_send = await configure_cors(store, settings)
                _log.info(
                    "serving",
                    extra={"fields": {"version": kleinkram.__version__, "checksum": abilities.checksum.value}},
                )
                yield
        finally:
            await database.close()

    require_guards(ROUTERS)
    app = FastAPI(
        title="Kleinkram",
        version=kleinkram.__version__,
        summary="Keeps every recording a robotics lab makes: organised, verified, findable down to the topic.",
        lifespan=lifespan,
        # The Location would be derived from the Host header, which the client chooses.
        redirect_slashes=False,
        docs_url=None,
        redoc_url=None,
        # Its spans, metrics and logs would be exported with the queries of requests, which may hold secrets.
        telemetry={"tracing": False, "metrics": False, "logs": False, "auto_configure": False},
    )
    app.state.settings, app.state.is_draining = settings, False
    app.state.admin_reads, app.state.refusals = AdminReads(), Refusals()
    app.state.slice_slots = SliceSlots(settings.slices_at_once, settings.slices_per_account)
    app.add_middleware(RequestMiddleware, settings=settings)
    if traces.is_on():
        app.add_middleware(TraceMiddleware)  # the one added last is the outermost
    install_error_handlers(app)
    # `include_router` would build each route once more, and compare each request with all of them twice.
    app.router.routes.extend(route for router in ROUTERS for route in router.routes)
    return app


def require_guards(routers: Sequence[APIRouter]) -> None:
    """Check that each route authenticates and has a row in the table of operations, or is an open page.

    Raises RuntimeError.
    """
    for route in (route for router in routers for route in router.routes):
        is_guarded = isinstance(route, APIRoute) and requires_actor(route) and route.operation_id in OPERATIONS
        path = getattr(route, "path", str(route))
        if not is_guarded and path not in OPEN_PAGES:
            raise RuntimeError(f"{path} has no row in access/operations.py, or does not authenticate")
