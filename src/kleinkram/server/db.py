"""Connections and transactions: SQLAlchemy Core over psycopg 3, no ORM.

A request has one transaction by default: committed when the route returns, rolled back when it raises. Where the object
store must be asked in between, a flow opens several with `Database.begin`.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import psycopg
from sqlalchemy.exc import DBAPIError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine, create_async_engine

from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.server.settings import Settings, async_dsn

# What a service takes first: an open transaction it must not end.
Connection = AsyncConnection


class Database:
    """The pool of one process."""

    def __init__(self, engine: AsyncEngine) -> None:
        self.engine = engine

    @asynccontextmanager
    async def begin(self) -> AsyncIterator[Connection]:
        """Run a transaction: commit at the end, roll back on any error.

        Raises:
            DatabaseUnavailable: no connection could be had, or it broke.
        """
        try:
            async with self.engine.begin() as connection:
                yield connection
        except DBAPIError as error:
            if error.connection_invalidated or isinstance(error.orig, psycopg.OperationalError):
                raise DatabaseUnavailable from error
            raise

    async def close(self) -> None:
        """Close every connection."""
        await self.engine.dispose()


def open_database(settings: Settings) -> Database:
    """Return a pool that connects when first used, and notices connections that a restart of PostgreSQL broke."""
    engine = create_async_engine(
        async_dsn(settings.database_url),
        pool_size=settings.database_connections,
        max_overflow=0,
        pool_timeout=20,
        pool_pre_ping=True,
        connect_args={"connect_timeout": 5, "application_name": "kleinkram"},
    )
    return Database(engine)


async def driver_connection(connection: Connection) -> psycopg.AsyncConnection[Any]:
    """Return the psycopg connection of an open transaction, to enqueue jobs inside it."""
    raw = (await connection.get_raw_connection()).driver_connection
    if not isinstance(raw, psycopg.AsyncConnection):
        raise TypeError(f"the driver is {type(raw).__name__}, not psycopg")
    return raw


def violated_constraint(error: DBAPIError) -> str | None:
    """Return the name of the constraint that a statement broke, to say which rule it was."""
    original = error.orig
    return original.diag.constraint_name if isinstance(original, psycopg.Error) else None
