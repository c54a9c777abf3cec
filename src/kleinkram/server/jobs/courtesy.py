"""Background work lets uploads go first: on a small machine reading back what came in would slow down what comes in.

Nothing is put off for good: each piece of work gives way for a stated time at most, counted from when its cause was
there. From then on it takes its turn, some pieces a second, as long as uploads come in.
"""

import asyncio
import contextlib
import datetime
import time

from sqlalchemy import exists, func, select

from kleinkram.contract.uploads import UploadState
from kleinkram.server.db import Database
from kleinkram.server.settings import Settings
from kleinkram.server.tables import upload

# What a person looks for soon, and what only has to happen.
SUMMARY_PATIENCE_S = 10.0
VERIFY_PATIENCE_S = 30.0
# A client that sends small files asks for addresses several times a second; one whose line is slow asks rarely, and
# leaves this machine time enough.
_RECENT_S = 2.0
_LOOK_S = 0.5
# How far apart pieces of work begin whose patience has ended: of ten thousand small files, each is one, and together
# they would take half of the machine from those that are still to come.
_APART_S = 0.2


class Courtesy:
    """Waits while uploads are coming in. One a worker."""

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database = database
        self._ended = asyncio.Event()
        self._next_turn_at = 0.0
        recent = func.now() + datetime.timedelta(seconds=settings.upload_expires_s - _RECENT_S)
        active = (upload.c.state == UploadState.open.value) & (upload.c.expires_at > recent)
        self._look = select(func.now().label("now"), exists().where(active).label("is_busy"))

    async def give_way(self, patience_s: float, *, since: datetime.datetime | None = None) -> bool:
        """Wait until no upload is sent, or until `patience_s` after `since` (by default: after now) and for a turn.

        Returns True for a turn: uploads still come in, so that it is to be short.
        """
        while not self._ended.is_set():
            async with self._database.autocommit() as db:
                seen = (await db.execute(self._look)).one()
            since = since or seen.now
            left_s = patience_s - (seen.now - since).total_seconds()
            if not seen.is_busy:
                return False
            if left_s <= 0:
                await self._wait(self._until_turn_s())
                return True
            await self._wait(min(left_s, _LOOK_S))
        return False

    def _until_turn_s(self) -> float:
        """Take the next turn, and return how far off it is."""
        now = time.monotonic()
        turn_at = max(now, self._next_turn_at)
        self._next_turn_at = turn_at + _APART_S
        return turn_at - now

    async def _wait(self, seconds: float) -> None:
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._ended.wait(), seconds)

    def end(self) -> None:
        """Let all that waits go on, and nothing wait any more."""
        self._ended.set()
