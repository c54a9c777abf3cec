"""What a route may ask for in its signature: who asks, a transaction, the store. Only routes import this."""

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import Depends, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from kleinkram.contract.errors import NotAuthenticated
from kleinkram.server.access.actor import Actor, find_actor
from kleinkram.server.db import Connection, Database
from kleinkram.server.settings import Settings
from kleinkram.server.site import Site
from kleinkram.server.storage import Storage

_bearer = HTTPBearer(auto_error=False, description="A Kleinkram token.")


def _settings(request: Request) -> Settings:
    settings: Settings = request.app.state.settings
    return settings


def _database(request: Request) -> Database:
    database: Database = request.app.state.database
    return database


def _storage(request: Request) -> Storage:
    storage: Storage = request.app.state.storage
    return storage


CurrentSettings = Annotated[Settings, Depends(_settings)]
CurrentDatabase = Annotated[Database, Depends(_database)]
CurrentStorage = Annotated[Storage, Depends(_storage)]


def _site(database: CurrentDatabase, storage: CurrentStorage, settings: CurrentSettings) -> Site:
    return Site(database, storage, settings)


async def _actor(
    request: Request,
    database: CurrentDatabase,
    credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)],
) -> Actor:
    if credentials is None:
        raise NotAuthenticated(reason="the request has no bearer token")
    async with database.begin() as db:
        actor = await find_actor(db, credentials.credentials, request_id=request.state.request_id)
    if actor is None:
        raise NotAuthenticated(reason="the token is not valid here")
    request.state.actor = actor
    return actor


CurrentActor = Annotated[Actor, Depends(_actor)]


async def _transaction(database: CurrentDatabase, _known: CurrentActor) -> AsyncIterator[Connection]:
    # Only once it is known who asks: a request that held one connection while it waits for another could starve all.
    async with database.begin() as connection:
        yield connection


CurrentSite = Annotated[Site, Depends(_site)]
# scope="function": committed before the answer leaves, so that nobody reads their own write too early.
Transaction = Annotated[Connection, Depends(_transaction, scope="function")]
