"""Delays background work while uploads come in: on a small machine, reading new files would slow uploads down.

Each job is delayed for a limited time after its cause. Then jobs run one after another, a few per second, as long as
uploads come in.
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

SUMMARY_MAX_WAIT_S = 10.0
VERIFY_MAX_WAIT_S = 30.0
# Clients that send small files sign parts several times a second; slow clients leave this machine enough time.
_RECENT_S = 2.0
_POLL_S = 0.5
# The interval between jobs that have waited long enough: each of ten thousand small files is a job.
_TURN_INTERVAL_S = 0.2


class BackPressure:
    """Waits while uploads come in; one per worker."""

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database = database
        self._ended = asyncio.Event()
        self._next_turn_at = 0.0
        recent = func.now() + datetime.timedelta(seconds=settings.upload_expires_s - _RECENT_S)
        active = (upload.c.state == UploadState.open.value) & (upload.c.expires_at > recent)
        self._stmt = select(func.now().label("now"), exists().where(active).label("is_busy"))

    async def wait_for_uploads(self, max_wait_s: float, *, since: datetime.datetime | None = None) -> bool:
        """Wait until no upload is active, or until `max_wait_s` after `since` (default: now) and for a turn.

        Returns True if uploads are still active, so that the work should be short.
        """
        while not self._ended.is_set():
            async with self._database.autocommit() as db:
                row = (await db.execute(self._stmt)).one()
            since = since or row.now
            left_s = max_wait_s - (row.now - since).total_seconds()
            if not row.is_busy:
                return False
            if left_s <= 0:
                now = time.monotonic()
                turn_at = max(now, self._next_turn_at)
                self._next_turn_at = turn_at + _TURN_INTERVAL_S
                await self._wait(turn_at - now)
                return True
            await self._wait(min(left_s, _POLL_S))
        return False

    async def _wait(self, seconds: float) -> None:
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._ended.wait(), seconds)

    def end(self) -> None:
        """End all waiting."""
        self._ended.set()
