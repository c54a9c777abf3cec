"""What a route may ask for in its signature: who asks, a transaction, the store. Only routes import this."""

from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Annotated

from fastapi import Depends, Request
from fastapi.routing import APIRoute
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from kleinkram.contract.errors import NotAuthenticated
from kleinkram.server.access.actor import STRANGER, Actor, ActorKind, find_actor, find_signed_in
from kleinkram.server.access.operations import OPERATIONS
from kleinkram.server.access.rights import admit, is_door, require_fresh_sign_in, still_shares
from kleinkram.server.audit.looking import Looks
from kleinkram.server.audit.places import named
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, Database
from kleinkram.server.rate_limit import limit_expensive
from kleinkram.server.settings import Settings
from kleinkram.server.storage import Storage

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
    who = await _who(request, database, credentials, is_door=is_door(operation))
    address = request.client.host if request.client else None
    actor = who.asking(operation, request_id=request.state.request_id, address=address)
    request.state.actor = actor
    admit(actor, operation)
    if OPERATIONS[operation].fresh:
        require_fresh_sign_in(actor, operation, within_s=request.app.state.settings.fresh_sign_in_s)
    has_text = not request.query_params.keys().isdisjoint({"text", "query"})
    await limit_expensive(database, request.app.state.settings, actor, has_text=has_text)
    if actor.is_admin and request.method == "GET":
        looks: Looks = request.app.state.looks
        await looks.note(database, actor, named(request.path_params, request.query_params))
    return actor


async def _who(
    request: Request, database: Database, credentials: HTTPAuthorizationCredentials | None, *, is_door: bool
) -> Actor:
    cookie = request.cookies.get(session_cookie(request.app.state.settings))
    if "authorization" not in request.headers and cookie is None:
        return STRANGER
    if credentials is None and cookie is None:
        raise NotAuthenticated(reason="the request has no bearer token")
    async with database.autocommit() as db:
        found = await _carrier(request, db, credentials)
    if found is None and credentials is None and is_door:
        return STRANGER  # whoever's session has ended may sign in again
    if found is None:
        raise NotAuthenticated(reason="the token is not valid here" if credentials else "the session has ended")
    if credentials is None:
        refuse_foreign_page(request)
    return found


async def _carrier(request: Request, db: Connection, credentials: HTTPAuthorizationCredentials | None) -> Actor | None:
    settings: Settings = request.app.state.settings
    if credentials is None:
        cookie = request.cookies.get(session_cookie(settings), "")
        return await find_signed_in(db, cookie, idle_s=settings.session_idle_s)
    found = await find_actor(db, credentials.credentials)
    if found is not None and found.kind is ActorKind.share and not await still_shares(db, found):
        return None
    return found


async def _find_again(
    request: Request, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]
) -> Callable[[Connection], Awaitable[Actor | None]]:
    """Return what finds out anew who asked, for an answer that lasts: None once they are nobody any more."""
    operation: str = request.scope["route"].operation_id

    async def find(db: Connection) -> Actor | None:
        found = await _carrier(request, db, credentials)
        address = request.client.host if request.client else None
        return found and found.asking(operation, request_id=request.state.request_id, address=address)

    return find


FindAgain = Annotated[Callable[[Connection], Awaitable[Actor | None]], Depends(_find_again)]


def session_cookie(settings: Settings) -> str:
    """Return the name of the cookie that holds a browser's session; with TLS, one that no other host can set."""
    return "__Host-kleinkram" if settings.public_url.startswith("https://") else "kleinkram"


def refuse_foreign_page(request: Request) -> None:
    """See that what a browser sends along with its cookie comes from a page of ours, where it may change anything.

    Raises:
        NotAuthenticated: it comes from another site's page, or does not say where it comes from.
    """
    if request.method in {"GET", "HEAD", "OPTIONS"}:
        return
    settings: Settings = request.app.state.settings
    if request.headers.get("origin") != settings.public_origin:
        raise NotAuthenticated(reason="the request did not come from a page of this server")


CurrentActor = Annotated[Actor, Depends(_actor)]


def asks_who(route: APIRoute) -> bool:
    """Say whether a route lets nobody in before it knows who comes, and that its operation is for them."""
    waiting = [route.dependant]
    while waiting:
        dependant = waiting.pop()
        if dependant.call is _actor:
            return True
        waiting += dependant.dependencies
    return False


async def _transaction(database: CurrentDatabase, _known: CurrentActor) -> AsyncIterator[Connection]:
    # Only once it is known who asks: a request that held one connection while it waits for another could starve all.
    async with database.begin() as connection:
        yield connection


async def _reading(database: CurrentDatabase, _known: CurrentActor) -> AsyncIterator[Connection]:
    async with database.autocommit() as connection:
        yield connection


CurrentSite = Annotated[AppContext, Depends(_context)]
# scope="function": committed before the answer leaves, so that nobody reads their own write too early.
Transaction = Annotated[Connection, Depends(_transaction, scope="function")]
# For routes that change nothing, and set nothing for the rest of a transaction.
Reading = Annotated[Connection, Depends(_reading, scope="function")]
