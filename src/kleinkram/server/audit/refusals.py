"""Audits failed sign-ins and denied requests, in a transaction of their own, since a failed request is rolled back.

Anybody can cause refusals at any rate, so each process audits at most `PER_MINUTE` refusals a minute per known actor,
and as many of all guests together; one entry at the end of the minute counts the rest. The request log has them all.
No token is ever recorded, nor anything else from the request except its address.
"""

import asyncio
import logging
import time
import uuid
from collections import Counter
from dataclasses import dataclass

from kleinkram.contract.errors import DatabaseUnavailable, ErrorCode
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import STRANGER, Actor, ActorKind
from kleinkram.server.audit.queries import RequestTarget, target_place
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Database

PER_MINUTE = 20
MINUTE_S = 60.0
# Refusals with a status other than 401 and 403.
ALSO_REFUSALS = {
    ErrorCode.rate_limited: "rate.limited",
    ErrorCode.code_gone: "auth.refused",
    ErrorCode.sign_in_expired: "auth.refused",
}
_log = logging.getLogger("kleinkram.audit")


@dataclass(frozen=True)
class Refusal:
    """A refused request: who sent it, if known, and the fields of the error."""

    actor: Actor | None
    code: ErrorCode
    place: str
    why: Metadata
    address: str | None
    request_id: str | None
    target: RequestTarget | None = None

    @property
    def operation(self) -> str:
        """The operation in the audit log."""
        if self.code in ALSO_REFUSALS:
            return ALSO_REFUSALS[self.code]
        is_known = self.actor is not None and self.actor.kind is not ActorKind.stranger
        return "access.denied" if is_known else "auth.refused"

    @property
    def who(self) -> Actor:
        """The actor in the audit log, without admin rights."""
        if self.actor is not None:
            return self.actor.without_power()
        return STRANGER.asking("", request_id=self.request_id, address=self.address)


class Refusals:
    """The numbers of refusals in the current minute: for each known actor, and for all guests together."""

    def __init__(self) -> None:
        self._started_at = float("-inf")
        self._counts: Counter[uuid.UUID | None] = Counter()
        self._left_out = 0
        self._summary: asyncio.Task[None] | None = None

    def admits(self, actor_id: uuid.UUID | None, now: float) -> bool:
        """Count a refusal of a known actor, or with None of a guest, and return whether it may be audited."""
        if now - self._started_at >= MINUTE_S:
            self._started_at = now
            self._counts.clear()
        self._counts[actor_id] += 1
        return self._counts[actor_id] <= PER_MINUTE

    async def audit(self, database: Database, refusal: Refusal) -> None:
        """Audit a refusal; if that fails, the response stays the same."""
        who = refusal.who
        now = time.monotonic()
        if self.admits(who.person_id or who.share_id, now):
            try:
                await _write(database, refusal)
            except DatabaseUnavailable:
                _log.warning("refusal not audited", extra={"fields": {"request_id": refusal.request_id}})
            return
        self._left_out += 1
        if self._summary is None:
            self._summary = asyncio.create_task(self._write_summary(database, self._started_at + MINUTE_S - now))

    async def _write_summary(self, database: Database, after_s: float) -> None:
        await asyncio.sleep(after_s)
        count, self._left_out, self._summary = self._left_out, 0, None
        after: Metadata = {"left_out": count, "within_s": MINUTE_S}
        try:
            async with database.begin() as db:
                await record(db, STRANGER, Event("auth.refused", "request", None, "left out", None, after=after))
        except DatabaseUnavailable:
            _log.warning("refusals not summed up", extra={"fields": {"left_out": count}})


async def _write(database: Database, refusal: Refusal) -> None:
    project_id = mission_id = None
    async with database.begin() as db:
        # The owners of the place see the entry; requests of guests have none.
        if refusal.actor is not None and refusal.target is not None:
            row = (await db.execute(target_place(refusal.target))).one_or_none()
            if row is not None:
                project_id, mission_id = row.project_id, row.mission_id
        event = Event(
            refusal.operation,
            "request",
            None,
            refusal.place,
            project_id,
            after=refusal.why,
            mission_id=mission_id,
        )
        await record(db, refusal.who, event)
