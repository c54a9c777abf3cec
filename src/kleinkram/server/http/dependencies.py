"""Dependencies of routes: the actor, a transaction, the context. Only routes import this."""

from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Annotated

from fastapi import Depends, Path, Request
from fastapi.routing import APIRoute
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from kleinkram.contract.errors import NotAuthenticated
from kleinkram.server.access.actor import STRANGER, Actor, ActorKind, find_actor, find_signed_in
from kleinkram.server.access.operations import OPERATIONS
from kleinkram.server.access.rights import check_credential, is_public_endpoint, require_fresh_sign_in, still_shares
from kleinkram.server.audit.requests import AdminReads, request_target
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, Database
from kleinkram.server.http.rate_limit import limit_expensive
from kleinkram.server.s3.storage import Storage
from kleinkram.server.settings import Settings

_bearer = HTTPBearer(auto_error=False, description="A Kleinkram token.")


async def _settings(request: Request) -> Settings:
    settings: Settings = request.app.state.settings
    return settings


async def _database(request: Request) -> Database:
    database: Database = request.app.state.database
    return database


async def _storage(request: Request) -> Storage:
    storage: Storage = request.app.state.storage
    return storage


CurrentSettings = Annotated[Settings, Depends(_settings)]
CurrentDatabase = Annotated[Database, Depends(_database)]
CurrentStorage = Annotated[Storage, Depends(_storage)]


async def _context(database: CurrentDatabase, storage: CurrentStorage, settings: CurrentSettings) -> AppContext:
    return AppContext(database, storage, settings)


async def _actor(
    request: Request,
    database: CurrentDatabase,
    credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)],
) -> Actor:
    operation: str = request.scope["route"].operation_id
    requester = await _authenticate(request, database, credentials, is_public_endpoint=is_public_endpoint(operation))
    address = request.client.host if request.client else None
    actor = requester.for_request(operation, request_id=request.state.request_id, address=address)
    request.state.actor = actor
    check_credential(actor, operation)
    if OPERATIONS[operation].fresh:
        require_fresh_sign_in(actor, operation, within_s=request.app.state.settings.fresh_sign_in_s)
    has_text = not request.query_params.keys().isdisjoint({"text", "query"})
    await limit_expensive(database, request.app.state.settings, actor, has_text=has_text)
    if actor.is_admin and request.method == "GET":
        admin_reads: AdminReads = request.app.state.admin_reads
        await admin_reads.audit(database, actor, request_target(request.path_params, request.query_params))
    return actor


async def _authenticate(
    request: Request, database: Database, credentials: HTTPAuthorizationCredentials | None, *, is_public_endpoint: bool
) -> Actor:
    cookie = request.cookies.get(session_cookie(request.app.state.settings))
    if "authorization" not in request.headers and cookie is None:
        return STRANGER
    if credentials is None and cookie is None:
        raise NotAuthenticated(reason="the request has no bearer token")
    async with database.autocommit() as db:
        actor = await _find_credential_holder(request, db, credentials)
    if actor is None and credentials is None and is_public_endpoint:
        return STRANGER  # with an expired session, people may sign in again
    if actor is None:
        raise NotAuthenticated(reason="the token is not valid here" if credentials else "the session has ended")
    if credentials is None:
        require_same_origin(request)
    return actor


async def _find_credential_holder(
    request: Request, db: Connection, credentials: HTTPAuthorizationCredentials | None
) -> Actor | None:
    settings: Settings = request.app.state.settings
    if credentials is None:
        cookie = request.cookies.get(session_cookie(settings), "")
        days = settings.provider_session_days
        return await find_signed_in(db, cookie, idle_s=settings.session_idle_s, provider_days=days)
    actor = await find_actor(db, credentials.credentials, provider_days=settings.provider_session_days)
    if actor is not None and actor.kind is ActorKind.share and not await still_shares(db, actor):
        return None
    return actor


async def _reauthenticate(
    request: Request, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]
) -> Callable[[Connection], Awaitable[Actor | None]]:
    """Return a function that authenticates a streaming request again; None once its credential is no longer valid."""
    operation: str = request.scope["route"].operation_id

    async def authenticate(db: Connection) -> Actor | None:
        actor = await _find_credential_holder(request, db, credentials)
        address = request.client.host if request.client else None
        return actor and actor.for_request(operation, request_id=request.state.request_id, address=address)

    return authenticate


Reauthenticate = Annotated[Callable[[Connection], Awaitable[Actor | None]], Depends(_reauthenticate)]


def session_cookie(settings: Settings) -> str:
    """Return the name of the session cookie; with TLS, its prefix keeps other hosts from setting it."""
    return "__Host-kleinkram" if settings.public_url.startswith("https://") else "kleinkram"


def require_same_origin(request: Request) -> None:
    """Require that a change sent with a session cookie comes from a page of this server (CSRF).

    Raises NotAuthenticated.
    """
    if request.method in {"GET", "HEAD", "OPTIONS"}:
        return
    settings: Settings = request.app.state.settings
    if request.headers.get("origin") != settings.public_origin:
        raise NotAuthenticated(reason="the request did not come from a page of this server")


CurrentActor = Annotated[Actor, Depends(_actor)]


def requires_actor(route: APIRoute) -> bool:
    """Whether a route authenticates its caller and checks their permission for its operation."""
    pending = [route.dependant]
    while pending:
        dependant = pending.pop()
        if dependant.call is _actor:
            return True
        pending += dependant.dependencies
    return False


async def _transaction(database: CurrentDatabase, _actor: CurrentActor) -> AsyncIterator[Connection]:
    # Depends on the actor: a request that kept one connection while it waits for another could block all.
    async with database.begin() as connection:
        yield connection


async def _reading(database: CurrentDatabase, _actor: CurrentActor) -> AsyncIterator[Connection]:
    async with database.autocommit() as connection:
        yield connection


# In a path: of an action, or of a project's checks.
VersionNumber = Annotated[int, Path(ge=1, lt=2**31)]
CurrentContext = Annotated[AppContext, Depends(_context)]
# scope="function": committed before the response is sent, so that clients read their own writes.
Transaction = Annotated[Connection, Depends(_transaction, scope="function")]
# For routes that change nothing and set no transaction-local settings.
Reading = Annotated[Connection, Depends(_reading, scope="function")]
