"""How often something may be asked: counted in the database, so that all processes count together.

A count begins anew every `WINDOW_S`, so at a boundary twice as much may pass in a moment. Who asks is kept as a hash.
Fails closed: where the database cannot count, the request is not answered, as it could not have been anyway. The table
is not written ahead: after a crash of the database all counts begin anew.
"""

import datetime
import hashlib
import ipaddress
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, delete, func, text
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.errors import RateLimited
from kleinkram.server.access.actor import Actor
from kleinkram.server.db import Connection, Database
from kleinkram.server.settings import Settings
from kleinkram.server.tables import rate_count

WINDOW_S = 60
# Beyond its free tries a minute an account is tried once in so long, each try in its turn, so many turns ahead.
_TURN = datetime.timedelta(seconds=2)
_TURNS_AHEAD = 15
# Behind one address may be a whole lab.
_PER_ADDRESS = 10
_WINDOW = datetime.timedelta(seconds=WINDOW_S)
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
_IPV6_SUBNET = 64
# In the order of their keys, so that two who count the same never wait for each other. As text, since SQLAlchemy puts
# what updates on a conflict together anew each time.
_COUNT = text("""
INSERT INTO rate_count (key, window_start, count)
  SELECT key, date_bin(CAST(:window AS interval), now(), CAST(:epoch AS timestamptz)), 1
    FROM unnest(CAST(:keys AS text[])) AS key ORDER BY key COLLATE "C"
  ON CONFLICT (key, window_start) DO UPDATE SET count = rate_count.count + 1
  RETURNING key, count AS asked, ceil(extract(epoch FROM window_start + CAST(:window AS interval) - now())) AS left_s
""")
_EXPENSIVE = {
    "search": "searches",
    "get_facets": "searches",
    "get_stats": "searches",
    "get_project_stats": "searches",
    "get_overview": "searches",
    "list_topics": "searches",
    "download_files": "downloads",
    "begin_uploads": "uploads",
    "prove_file": "proofs",
    "export_audit_events": "exports",
}
_LISTS = frozenset({"list_projects", "list_missions", "list_files"})
_MOST: Mapping[str, Callable[[Settings], int]] = {
    "searches": lambda settings: settings.searches_per_minute,
    "downloads": lambda settings: settings.downloads_per_minute,
    "uploads": lambda settings: settings.uploads_per_minute,
    "proofs": lambda settings: settings.proofs_per_minute,
    "exports": lambda settings: settings.exports_per_minute,
}


@dataclass(frozen=True)
class Count:
    """One more of `what` (in words, such as "sign-ins") by `who`, of which there may be `most` in a window."""

    what: str
    who: str
    most: int

    @property
    def key(self) -> str:
        """Under which it is counted; says nothing of who it is."""
        return f"{self.what}:{hashlib.sha256(self.who.encode()).hexdigest()[:32]}"


async def limit(database: Database, *counts: Count) -> None:
    """Count one more of each, in a transaction of its own: what is refused or fails counts too. `most` 0 is no limit.

    Raises:
        RateLimited: there were more than `most` of one of them; says when it may be tried again.
    """
    held = {each.key: each for each in counts if each.most > 0}
    for row in await _counted(database, held):
        most = held[row.key].most
        if row.asked > most:
            raise RateLimited(
                what=held[row.key].what, limit=most, window_s=WINDOW_S, retry_after_s=max(1, int(row.left_s))
            )


async def turn_of(database: Database, count: Count) -> float:
    """Count one more, and return for how many seconds it has to wait: none for the first `most` in a window.

    The others take turns, whoever asks, so that many who ask at once are held up and none of them is sent away before
    the turns of the next half minute are taken.

    Raises:
        RateLimited: they are.
    """
    held = {count.key: count} if count.most > 0 else {}
    if all(row.asked <= count.most for row in await _counted(database, held)):
        return 0.0
    waits_s = func.extract("epoch", rate_count.c.window_start - func.now())
    async with database.begin() as db:
        for ahead in range(1, _TURNS_AHEAD + 1):
            begins = func.date_bin(_TURN, func.now(), _EPOCH) + ahead * _TURN
            turn = upsert(rate_count).values(key=f"turn of {count.key}", window_start=begins, count=1)
            taken = await db.execute(turn.on_conflict_do_nothing().returning(waits_s))
            if (row := taken.one_or_none()) is not None:
                return max(0.0, float(row[0]))
    retry_after_s = int(_TURNS_AHEAD * _TURN.total_seconds())
    raise RateLimited(what=count.what, limit=count.most, window_s=WINDOW_S, retry_after_s=retry_after_s)


async def _counted(database: Database, held: Mapping[str, Count]) -> Sequence[Row[Any]]:
    if not held:
        return []
    async with database.begin() as db:
        return (await db.execute(_COUNT, {"keys": [*held], "window": _WINDOW, "epoch": _EPOCH})).all()


def counts_of(actor: Actor, what: str, most: int) -> list[Count]:
    """Return what one more request of an actor counts for: their token, session or link, and their address."""
    credential = actor.token_id or actor.session_id or actor.share_id
    by_address = most if credential is None else most * _PER_ADDRESS
    counts = [] if credential is None else [Count(what, str(credential), most)]
    return counts if actor.address is None else [*counts, Count(what, neighbourhood(actor.address), by_address)]


async def limit_expensive(database: Database, settings: Settings, actor: Actor, *, has_text: bool) -> None:
    """Count a request that is expensive; lists are where they look into texts (`has_text`).

    Raises:
        RateLimited: the same asked for too many of its kind.
    """
    what = _EXPENSIVE.get(actor.operation or "")
    if what is None and has_text and actor.operation in _LISTS:
        what = "searches"
    if what is not None:
        await limit(database, *counts_of(actor, what, _MOST[what](settings)))


def neighbourhood(address: str) -> str:
    """Return the part of an address that one subscriber holds: all of IPv4, the first 64 bits of IPv6."""
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    if parsed.version == 4:
        return str(parsed)
    return str(ipaddress.ip_network((parsed, _IPV6_SUBNET), strict=False))


async def forget_counts(db: Connection) -> None:
    """Drop the counts of windows that are over."""
    await db.execute(delete(rate_count).where(rate_count.c.window_start < func.now() - 2 * _WINDOW))
