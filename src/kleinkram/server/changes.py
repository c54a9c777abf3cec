"""Telling that something changed, inside the transaction that changes it: PostgreSQL tells it on once that is through.

One statement for any number of changes. Says what changed and where, never what it says now: who may know even that is
for `events` to decide, when it passes it on.
"""

import json
import uuid
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, replace

from sqlalchemy import text

from kleinkram.contract.events import ChangeKind
from kleinkram.server.db import Connection

CHANNEL = "kleinkram_changes"
# Told instead of more places than these at once: look at everything again.
EVERYTHING = "*"
_MOST_PLACES = 100
_TELL = text("SELECT pg_notify(:channel, said) FROM unnest(CAST(:said AS text[])) AS said")


@dataclass(frozen=True)
class Notice:
    """One change. Without an id: of several of the noun. `by_id` is the person who did it, where it was one."""

    noun: str
    change: ChangeKind
    id: uuid.UUID | None = None
    project_id: uuid.UUID | None = None
    mission_id: uuid.UUID | None = None
    by_id: uuid.UUID | None = None


async def tell(db: Connection, notices: Iterable[Notice]) -> None:
    """Tell what changed, as part of the caller's transaction; several of one noun in one place are told as one."""
    said = [_written(each) for each in gathered(notices, most=1)]
    if said:
        said = said if len(said) <= _MOST_PLACES else [EVERYTHING]
        await db.execute(_TELL, {"channel": CHANNEL, "said": said})


def gathered(notices: Iterable[Notice], *, most: int) -> list[Notice]:
    """Return notices in their order; where more than `most` differ by their id alone, one without an id for them."""
    alike: dict[Notice, list[Notice]] = defaultdict(list)
    for each in dict.fromkeys(notices):
        alike[replace(each, id=None)].append(each)
    return [each for place, those in alike.items() for each in _at_most(place, those, most)]


def read_notice(said: str) -> Notice:
    """Return what was told."""
    noun, change, *ids = json.loads(said)
    return Notice(noun, ChangeKind(change), *(None if each is None else uuid.UUID(each) for each in ids))


def _at_most(place: Notice, those: Sequence[Notice], most: int) -> Sequence[Notice]:
    return those if len(those) <= most and place not in those else [place]


def _written(notice: Notice) -> str:
    return json.dumps(astuple(notice), default=str)
