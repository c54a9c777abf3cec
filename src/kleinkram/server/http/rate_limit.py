"""Rate limits, counted in the database for all processes together.

Windows are fixed, so twice as many requests may pass around a boundary. Clients are stored as hashes. If the database
cannot count, the request fails. The table is unlogged: after a crash of the database, counts start at zero.
"""

import datetime
import hashlib
import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from sqlalchemy import delete, func, text
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.errors import RateLimited
from kleinkram.server import metrics
from kleinkram.server.access.actor import Actor
from kleinkram.server.db import Connection, Database
from kleinkram.server.settings import Settings
from kleinkram.server.tables import rate_count

WINDOW_S = 60
# Once its attempts per minute are used up, an account gets one slot every so long, at most so many slots ahead.
_SLOT = datetime.timedelta(seconds=2)
_MAX_SLOTS_AHEAD = 15
# A whole lab may share one address.
_CLIENTS_PER_ADDRESS = 10
_WINDOW = datetime.timedelta(seconds=WINDOW_S)
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
_IPV6_SUBNET = 64
# Ordered by key, so that concurrent statements do not deadlock. As text, because SQLAlchemy does not cache upserts.
_COUNT = text("""
INSERT INTO rate_count (key, window_start, count)
  SELECT key, date_bin(CAST(:window AS interval), now(), CAST(:epoch AS timestamptz)), 1
    FROM unnest(CAST(:keys AS text[])) AS key ORDER BY key COLLATE "C"
  ON CONFLICT (key, window_start) DO UPDATE SET count = rate_count.count + 1
  RETURNING key, count, ceil(extract(epoch FROM window_start + CAST(:window AS interval) - now())) AS seconds_left
""")
# The kind of an expensive operation; `<kind>_per_minute` is the setting of its limit.
_OPERATION_KINDS = {
    "search": "searches",
    "get_facets": "searches",
    "list_mission_positions": "searches",
    "get_stats": "searches",
    "get_project_stats": "searches",
    "get_overview": "searches",
    "list_topics": "searches",
    "list_metrics": "searches",
    "get_metric_table": "searches",
    "download_files": "downloads",
    "slice_file": "downloads",
    "get_recording_preview": "downloads",
    "get_file_thumbnails": "downloads",
    "begin_uploads": "uploads",
    "verify_file": "verifications",
    "make_recording_preview": "verifications",
    "export_audit_events": "exports",
    "export_person": "exports",
}
_LIST_OPERATIONS = frozenset({"list_projects", "list_missions", "list_files"})


class _Counted(NamedTuple):
    key: str
    requests: int
    seconds_left: int


@dataclass(frozen=True)
class Count:
    """One more request of a kind (`what`, such as "sign-ins") by a client; `limit` 0 is no limit."""

    what: str
    client: str
    limit: int

    @property
    def key(self) -> str:
        """The key of the counter: the client as a hash."""
        return f"{self.what}:{hashlib.sha256(self.client.encode()).hexdigest()[:32]}"


async def enforce_limits(database: Database, *counts: Count) -> None:
    """Add one to each count in a transaction of its own, so that refused and failed requests count too.

    Raises RateLimited.
    """
    by_key = {count.key: count for count in counts if count.limit > 0}
    for counted in await _increment(database, list(by_key)):
        count = by_key[counted.key]
        if counted.requests > count.limit:
            retry_after_s = max(1, counted.seconds_left)
            metrics.RATE_LIMITED.labels(count.what).inc()
            raise RateLimited(what=count.what, limit=count.limit, window_s=WINDOW_S, retry_after_s=retry_after_s)


async def reserve_slot(database: Database, count: Count) -> float:
    """Add one to a count and return how many seconds the request must wait: 0 up to the limit.

    Beyond the limit, all requests reserve slots: an attacker delays the owner of an account, but cannot lock them out.
    Raises RateLimited.
    """
    counted = await _increment(database, [count.key] if count.limit > 0 else [])
    if all(row.requests <= count.limit for row in counted):
        return 0.0
    wait_s = func.extract("epoch", rate_count.c.window_start - func.now())
    async with database.begin() as db:
        for ahead in range(1, _MAX_SLOTS_AHEAD + 1):
            start = func.date_bin(_SLOT, func.now(), _EPOCH) + ahead * _SLOT
            slot = upsert(rate_count).values(key=f"slot of {count.key}", window_start=start, count=1)
            reserved = await db.execute(slot.on_conflict_do_nothing().returning(wait_s))
            if (row := reserved.one_or_none()) is not None:
                return max(0.0, float(row[0]))
    retry_after_s = int(_MAX_SLOTS_AHEAD * _SLOT.total_seconds())
    metrics.RATE_LIMITED.labels(count.what).inc()
    raise RateLimited(what=count.what, limit=count.limit, window_s=WINDOW_S, retry_after_s=retry_after_s)


async def _increment(database: Database, keys: Sequence[str]) -> Sequence[_Counted]:
    if not keys:
        return []
    async with database.begin() as db:
        rows = await db.execute(_COUNT, {"keys": keys, "window": _WINDOW, "epoch": _EPOCH})
        return [_Counted(key, count, int(seconds_left)) for key, count, seconds_left in rows]


def account_of(actor: Actor) -> str:
    """Return who has an allowance of their own: a person, a link, or the network of somebody without an account."""
    known = actor.person_id or actor.share_id
    return str(known) if known is not None else subscriber_network(actor.address or "")


def counts_of(actor: Actor, what: str, limit: int) -> list[Count]:
    """Return what one more request of an actor counts for: their token, session or link, and their address."""
    credential = actor.token_id or actor.session_id or actor.share_id
    per_address = limit if credential is None else limit * _CLIENTS_PER_ADDRESS
    counts = [] if credential is None else [Count(what, str(credential), limit)]
    return counts if actor.address is None else [*counts, Count(what, subscriber_network(actor.address), per_address)]


async def limit_expensive(database: Database, settings: Settings, actor: Actor, *, has_text: bool) -> None:
    """Count an expensive request; lists are expensive if they search texts (`has_text`). Raises RateLimited."""
    kind = _OPERATION_KINDS.get(actor.operation or "")
    if kind is None and has_text and actor.operation in _LIST_OPERATIONS:
        kind = "searches"
    if kind is not None:
        limit: int = getattr(settings, f"{kind}_per_minute")
        await enforce_limits(database, *counts_of(actor, kind, limit))


def subscriber_network(address: str) -> str:
    """Return the part of an address that one subscriber controls: all of IPv4, the first 64 bits of IPv6."""
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    if parsed.version == 4:
        return str(parsed)
    return str(ipaddress.ip_network((parsed, _IPV6_SUBNET), strict=False))


async def delete_expired_counts(db: Connection) -> None:
    """Delete the counts of past windows."""
    await db.execute(delete(rate_count).where(rate_count.c.window_start < func.now() - 2 * _WINDOW))
