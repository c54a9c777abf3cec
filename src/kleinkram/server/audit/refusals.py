"""Failed sign-ins and denials: noted in a transaction of their own, since the request that failed keeps none.

Anybody can have themselves refused, as often as they like. So a process notes at most `PER_MINUTE` refusals a minute;
the first note after that says how many were left out, and the log of requests has every one. A token is never noted,
nor anything else that the request brought along beside its address.
"""

import logging
import time
import uuid
from dataclasses import dataclass
from typing import NamedTuple

from kleinkram.contract.errors import DatabaseUnavailable, ErrorCode
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import STRANGER, Actor, ActorKind
from kleinkram.server.audit.places import Named, whereabouts
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection, Database

PER_MINUTE = 20
_MINUTE_S = 60
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
    """How many were noted in the minute that runs, and how many were not since the last note."""

    def __init__(self) -> None:
        self._began_at = float("-inf")
        self._noted = 0
        self._left_out = 0

    def admits(self, now: float) -> bool:
        """Say whether a refusal at `now`, in seconds, may be noted, and count it either way."""
        if now - self._began_at >= _MINUTE_S:
            self._began_at, self._noted = now, 0
        if self._noted >= PER_MINUTE:
            self._left_out += 1
            return False
        self._noted += 1
        return True

    def left_out(self) -> int:
        """Return how many were left out since this was asked last."""
        count, self._left_out = self._left_out, 0
        return count

    async def note(self, database: Database, refusal: Refusal) -> None:
        """Note a refusal; the answer is the same where that cannot be done."""
        if not self.admits(time.monotonic()):
            return
        left_out = self.left_out()
        after: Metadata = {**refusal.why}
        if left_out:
            after["left_out_before"] = left_out
        try:
            async with database.begin() as db:
                at = await _found(db, refusal)
                event = Event(
                    refusal.operation,
                    "request",
                    None,
                    refusal.place,
                    at.project_id,
                    after=after,
                    mission_id=at.mission_id,
                )
                await record(db, refusal.who, event)
        except DatabaseUnavailable:
            _log.warning("refusal not noted", extra={"fields": {"request_id": refusal.request_id}})


class _At(NamedTuple):
    project_id: uuid.UUID | None = None
    mission_id: uuid.UUID | None = None


async def _found(db: Connection, refusal: Refusal) -> _At:
    """Return where somebody was denied something, for the owners of that place; whoever is unknown was nowhere."""
    if refusal.actor is None or refusal.about is None:
        return _At()
    row = (await db.execute(whereabouts(refusal.about))).one_or_none()
    return _At() if row is None else _At(row.project_id, row.mission_id)
