"""Failed sign-ins and denials: noted in a transaction of their own, since the request that failed keeps none.

Anybody can have themselves refused, as often as they like. So a process notes at most `PER_MINUTE` refusals a minute of
each who is known, and as many of all strangers together: their noise hides nobody's denial. How many were left
out stands in one row at the minute's end, and the log of requests has every refusal. A token is never noted, nor
anything else that the request brought along beside its address.
"""

import asyncio
import logging
import time
import uuid
from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

from kleinkram.contract.errors import DatabaseUnavailable, ErrorCode
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import STRANGER, Actor, ActorKind
from kleinkram.server.audit.queries import Named, whereabouts
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection, Database

PER_MINUTE = 20
MINUTE_S = 60.0
# Refusals that have another status than 401 and 403: who asks too often, and codes that are not, or no longer, good.
ALSO_REFUSALS = {
    ErrorCode.rate_limited: "rate.limited",
    ErrorCode.code_gone: "auth.refused",
    ErrorCode.sign_in_expired: "auth.refused",
}
_log = logging.getLogger("kleinkram.audit")


@dataclass(frozen=True)
class Refusal:
    """A request that was refused: why, by the fields of its error; by whom, as far as that is known; and from where."""

    actor: Actor | None
    code: ErrorCode
    place: str
    why: Metadata
    address: str | None
    request_id: str | None
    about: Named | None = None

    @property
    def operation(self) -> str:
        """What the record calls it."""
        if self.code in ALSO_REFUSALS:
            return ALSO_REFUSALS[self.code]
        is_known = self.actor is not None and self.actor.kind is not ActorKind.stranger
        return "access.denied" if is_known else "auth.refused"

    @property
    def who(self) -> Actor:
        """Whoever it was; whatever power they have, it did not help."""
        if self.actor is not None:
            return self.actor.without_power()
        return STRANGER.asking("", request_id=self.request_id, address=self.address)


class Refusals:
    """How many were noted in the minute that runs: for each who is known, and for all strangers together."""

    def __init__(self) -> None:
        self._began_at = float("-inf")
        self._noted: Counter[uuid.UUID | None] = Counter()
        self._left_out = 0
        self._summing: asyncio.Task[None] | None = None

    def admits(self, whose: uuid.UUID | None, now: float) -> bool:
        """Say whether a refusal of somebody known, or with None of a stranger, may be noted at `now`, in seconds.

        It is counted either way.
        """
        if now - self._began_at >= MINUTE_S:
            self._began_at = now
            self._noted.clear()
        self._noted[whose] += 1
        return self._noted[whose] <= PER_MINUTE

    async def note(self, database: Database, refusal: Refusal) -> None:
        """Note a refusal; the answer is the same where that cannot be done."""
        who = refusal.who
        now = time.monotonic()
        if self.admits(who.person_id or who.share_id, now):
            try:
                await _note_one(database, refusal)
            except DatabaseUnavailable:
                _log.warning("refusal not noted", extra={"fields": {"request_id": refusal.request_id}})
            return
        self._left_out += 1
        if self._summing is None:
            self._summing = asyncio.create_task(self._sum_up(database, self._began_at + MINUTE_S - now))

    async def _sum_up(self, database: Database, after_s: float) -> None:
        """Write the one row of a minute for the refusals that were not noted one by one."""
        await asyncio.sleep(after_s)
        count, self._left_out, self._summing = self._left_out, 0, None
        after: Metadata = {"left_out": count, "within_s": MINUTE_S}
        event = Event("auth.refused", "request", None, "left out", None, after=after)
        try:
            async with database.begin() as db:
                await record(db, STRANGER, event)
        except DatabaseUnavailable:
            _log.warning("refusals not summed up", extra={"fields": {"left_out": count}})


async def _note_one(database: Database, refusal: Refusal) -> None:
    async with database.begin() as db:
        at = await _found(db, refusal)
        place = refusal.place
        event = Event(
            refusal.operation, "request", None, place, at.project_id, after=refusal.why, mission_id=at.mission_id
        )
        await record(db, refusal.who, event)


class _At(NamedTuple):
    project_id: uuid.UUID | None = None
    mission_id: uuid.UUID | None = None


async def _found(db: Connection, refusal: Refusal) -> _At:
    """Return where somebody was denied something, for the owners of that place; whoever is unknown was nowhere."""
    if refusal.actor is None or refusal.about is None:
        return _At()
    row = (await db.execute(whereabouts(refusal.about))).one_or_none()
    return _At() if row is None else _At(row.project_id, row.mission_id)
