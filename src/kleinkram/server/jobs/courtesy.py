"""Background work lets uploads go first: on a small machine reading back what came in would slow down what comes in.

Nothing is put off for good: each piece of work waits a stated time at most, counted from when its cause was there, so
a stream of uploads that never ends delays it by that much and no more.
"""

import asyncio
import contextlib
import datetime

from sqlalchemy import exists, func, select

from kleinkram.contract.uploads import UploadState
from kleinkram.server.db import Database
from kleinkram.server.settings import Settings
from kleinkram.server.tables import upload

# What a person looks for soon, and what only has to happen.
SUMMARY_PATIENCE_S = 10.0
PROOF_PATIENCE_S = 30.0
# A client that sends small files asks for addresses several times a second; one whose line is slow asks rarely, and
# leaves this machine time enough.
_RECENT_S = 2.0
_LOOK_S = 0.5


class Courtesy:
    """Waits while uploads are coming in. One a worker."""

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database = database
        self._ended = asyncio.Event()
        recent = func.now() + datetime.timedelta(seconds=settings.upload_expires_s - _RECENT_S)
        active = (upload.c.state == UploadState.open.value) & (upload.c.expires_at > recent)
        self._look = select(func.now().label("now"), exists().where(active).label("is_busy"))

    async def give_way(self, patience_s: float, *, since: datetime.datetime | None = None) -> None:
        """Wait until no upload is being sent, or until `patience_s` after `since` (by default: after now)."""
        while not self._ended.is_set():
            async with self._database.begin() as db:
                seen = (await db.execute(self._look)).one()
            since = since or seen.now
            left_s = patience_s - (seen.now - since).total_seconds()
            if left_s <= 0 or not seen.is_busy:
                return
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._ended.wait(), min(left_s, _LOOK_S))

    def end(self) -> None:
        """Let all that waits go on, and nothing wait any more."""
        self._ended.set()
