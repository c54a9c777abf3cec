"""Holding back the site's sweep while a backup copies what its snapshot names (see `blobs.holding`)."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import psycopg

from kleinkram.server.backup.failing import Unreachable
from kleinkram.server.blobs.garbage_collection import DELETION_LOCK

_ASK_EVERY_S = 30.0
_SILENT_MS = 300_000


class Hold:
    """That the sweep is held back, for as long as this says so."""

    def __init__(self, connection: psycopg.AsyncConnection[tuple[object, ...]]) -> None:
        self._connection = connection
        self._lost: str | None = None

    def check(self) -> None:
        """See that nothing was let go meanwhile.

        Raises:
            Unreachable: the database ended the connection: what the snapshot names may be gone by now.
        """
        if self._lost is not None:
            raise Unreachable(
                f"The database ended the connection that held back the sweep ({self._lost}), so this backup may lack "
                "what was deleted since: run it again, what was copied stays."
            )

    async def confirm(self) -> None:
        """Ask the database now, and see the same: `check` may not know yet of what happened half a minute ago."""
        await self._ask()
        self.check()

    async def keep(self) -> None:
        """Ask again and again, until it is no longer so."""
        while self._lost is None:
            await asyncio.sleep(_ASK_EVERY_S)
            await self._ask()

    async def _ask(self) -> None:
        try:
            await self._connection.execute("SELECT 1")
        except psycopg.Error as error:
            self._lost = self._lost or str(error).strip().partition("\n")[0]


@asynccontextmanager
async def holding_back(dsn: str) -> AsyncGenerator[Hold, None]:
    """Hold the sweep back until the end of the block, or of this process.

    Raises:
        psycopg.OperationalError: the database does not answer.
    """
    connection = await psycopg.AsyncConnection.connect(dsn, autocommit=True, application_name="kleinkram backup")
    async with connection:
        await connection.execute(f"SET idle_session_timeout = {_SILENT_MS}")
        await connection.execute("SELECT pg_advisory_lock_shared(%s)", (DELETION_LOCK,))
        hold = Hold(connection)
        keeping = asyncio.create_task(hold.keep())
        try:
            yield hold
        finally:
            keeping.cancel()
            await asyncio.gather(keeping, return_exceptions=True)
