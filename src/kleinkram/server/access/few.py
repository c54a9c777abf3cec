"""Which missions somebody sees, where these are few: told to the database, which takes everybody to see most of them.

It says where to begin and is no right: `visible` asks for rights with every statement, whatever was found before.
"""

import time
from collections.abc import Hashable
from dataclasses import replace
from functools import lru_cache
from typing import Any

from sqlalchemy import Select

from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_missions
from kleinkram.server.access.whoever import KEPT, asking, whoever
from kleinkram.server.db import Connection
from kleinkram.server.tables import mission

# Of more, the files are so many that beginning with each mission's own is no shorter way.
MOST = 32
# A process remembers for so long who saw many: whoever sees few by then is only told so late.
_ASKED_EVERY_S = 60
_REMEMBERED = 10_000
_saw_many: dict[Hashable, float] = {}


async def knowing_few(db: Connection, actor: Actor) -> Actor:
    """Return the same somebody, with the ids of the missions they see where there are no more than `MOST`."""
    if actor.is_admin or actor.sees_many or actor.few_mission_ids is not None:
        return actor
    now, key = time.monotonic(), (actor.person_id, actor.kind, actor.limits, actor.most, MOST)
    if now - _saw_many.get(key, float("-inf")) < _ASKED_EVERY_S:
        return replace(actor, sees_many=True)
    mission_ids = (await db.execute(_first(whoever(actor), MOST + 1), asking(actor))).scalars().all()
    if len(mission_ids) <= MOST:
        return replace(actor, few_mission_ids=frozenset(mission_ids))
    if len(_saw_many) >= _REMEMBERED:
        _saw_many.clear()
    _saw_many[key] = now
    return replace(actor, sees_many=True)


@lru_cache(maxsize=KEPT)
def _first(asker: Actor, count: int) -> Select[Any]:
    return visible_missions(asker).with_only_columns(mission.c.id, maintain_column_froms=True).limit(count)
