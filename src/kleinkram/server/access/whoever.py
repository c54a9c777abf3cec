"""Who asks, without saying who that is: people differ, and the statement is the same.

To put a statement together, and to look up how it was compiled, takes longer than PostgreSQL takes for most of them. So
what is often asked is put together once for all who ask alike, and executed with the id of this one.
"""

import uuid
from typing import Any, cast

from sqlalchemy import Uuid, bindparam

from kleinkram.server.access.actor import Actor

# So many statements are kept of each kind: one for each way in which people may be limited, and be asking.
KEPT = 64
# Without the value, a statement is not executed at all.
_ID: Any = bindparam("asking_person_id", type_=Uuid())


def whoever(actor: Actor) -> Actor:
    """Return what stands for all who may see by the same rules as `actor`; statements are executed with `asking`."""
    return Actor(
        person_id=actor.person_id and cast(uuid.UUID, _ID),
        name="",
        token_id=None,
        request_id=None,
        kind=actor.kind,
        is_admin=actor.is_admin,
        scopes=actor.scopes,
        limits=actor.limits,
        most=actor.most,
        few_mission_ids=actor.few_mission_ids,
        sees_many=actor.sees_many,
        looked=actor.looked,
    )


def asking(actor: Actor) -> dict[str, object]:
    """Return the value with which a statement of `whoever` is executed for `actor`."""
    return {"asking_person_id": actor.person_id}
