"""How much a search will find, seen from a few files: many are met by walking, few are looked up by their words.

Ids are random, so the first of them are files drawn by lot, and an index reads them at once. What is seen of these
says where to begin and, where very many are found, about how many; nothing of rights: every statement asks for those.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

from sqlalchemy import ARRAY, CTE, BigInteger, ColumnElement, Select, Text, and_, cast, func, select, true
from sqlalchemy.dialects.postgresql import array

from kleinkram.contract.files import FileFilter
from kleinkram.contract.query.keys import is_glob
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.looked import NONE_AT_ALL, Looked
from kleinkram.server.access.visible import visible_files
from kleinkram.server.access.whoever import KEPT
from kleinkram.server.db import Connection, among_given
from kleinkram.server.filters.asked import Asked, asked_alike, values
from kleinkram.server.filters.files import file_conditions
from kleinkram.server.filters.text import file_holds, has_index, is_known_untimed, look_up, words_of
from kleinkram.server.tables import file, mission, topic

# Files drawn, and how many of them must be found for there to be many: with those, an estimate is off by a third.
DRAWN, MANY = 500, 10
# Where each word by itself is in many, no index leads to the files that hold them all: these are then many sooner.
_MANY_TOGETHER = 3
_MISSIONS_DRAWN = 100
_MANY_TOPICS = 5_000
_IDS = 2**128


@dataclass(frozen=True)
class Outlook:
    """What was seen of the files drawn: how many of them each filter finds, of how many there are about in all.

    Attributes:
        blob_ids: the blobs of those that the first filter finds, and that are seen by who asks.
    """

    hits: Sequence[int]
    drawn: int
    files: int
    many: int = MANY
    blob_ids: str = NONE_AT_ALL

    def finds_many(self, number: int = 0) -> bool:
        """Say whether a filter finds so many files that they are not all looked at."""
        return self.drawn == DRAWN and self.hits[number] >= self.many

    def estimate(self) -> int:
        """Return about how many files the first filter finds, in two digits."""
        return rounded(self.hits[0] * self.files // max(self.drawn, 1))


@cache  # one and the same within a statement
def drawn_files() -> CTE:
    """Return the ids of files drawn by lot, the same each time; all of them where there are not so many."""
    return select(file.c.id).order_by(file.c.id).limit(DRAWN).cte("drawn").prefix_with("MATERIALIZED")


async def look_ahead(
    db: Connection, actor: Actor, *filters: FileFilter, lists: bool = False
) -> tuple[Actor, Outlook | None]:
    """Return who asks, knowing where to begin with the first filter, and what was seen; None for who sees little.

    The words are those of the first filter, which the others share. Where many are found, joins are left row by row.
    Who `lists` what is found can do with files that all have no time.

    Raises:
        InvalidQuery: a `where` cannot be used, or there are too many words.
    """
    if actor.few_mission_ids is not None:
        return actor, None
    words = words_of(filters[0].text)
    actor = replace(actor, looked=Looked(await look_up(db, actor, words)))
    tried = _tried(tuple(asked_alike(actor, each) for each in filters), drawn_files())
    if actor.looked.finds_nothing:
        return actor, Outlook([0] * len(filters), 0, 0)
    await let_join(db, actor, freely=False)
    row = (await db.execute(tried, values(actor, filters[0]))).one()
    hits, held, timed = (
        list(row[: len(filters)]),
        *(dict(zip(words, each, strict=True)) for each in (row.held, row.timed)),
    )
    files = row.drawn if row.drawn < DRAWN else row.drawn * _IDS // max(row.last.int, 1)
    rarest = min(filter(has_index, words), key=lambda word: held[word], default=None)
    is_led = rarest is None or held[rarest] < MANY
    outlook = Outlook(hits, row.drawn, files, MANY if is_led else _MANY_TOGETHER, row.blob_ids or NONE_AT_ALL)
    # Files without a time come last: where nearly all are such, a walk would meet all others first.
    if outlook.finds_many() and row.found_timed < _MANY_TOGETHER:
        seldom = [each for each in actor.looked.words if has_index(each.word) and not timed[each.word]]
        is_untimed = lists and await is_known_untimed(db, seldom)
        actor = replace(actor, looked=replace(actor.looked, is_untimed=is_untimed))
        outlook = outlook if is_untimed else replace(outlook, many=DRAWN + 1)
    if outlook.finds_many():
        return replace(actor, looked=replace(actor.looked, finds_many=True)), outlook
    await let_join(db, actor, freely=True)
    return replace(actor, looked=replace(actor.looked, led_by=rarest)), outlook


async def let_join(db: Connection, actor: Actor, *, freely: bool) -> None:
    """Have the database join as it likes, or row by row with what was drawn, until the transaction ends.

    By its reckoning somebody's rights are gathered anew for each row, so that it would rather read all missions.
    """
    if not actor.is_admin:
        how = "on" if freely else "off"
        kinds = (func.set_config(kind, how, True) for kind in ("enable_hashjoin", "enable_mergejoin"))
        await db.execute(select(*kinds))


@lru_cache(maxsize=KEPT)
def _tried(asked: Sequence[Asked[FileFilter]], drawn: CTE) -> Select[Any]:
    """Return how many files drawn each filter finds; and what was drawn.

    Of the first also the blobs, and how many of its files have a time; of its words how many files hold them (`held`),
    and how many of these have a time (`timed`).
    """
    actor = asked[0].actor
    conditions = [and_(true(), *file_conditions(actor, each.matching)) for each in asked]
    first, words = asked[0].matching, words_of(asked[0].matching.text)
    # A filter that is one word is not tried twice.
    is_word = len(words) == 1 and first == FileFilter(text=first.text)
    conditions += [] if is_word else [file_holds(actor, word) for word in words]
    holding = [condition.label(f"holds_{number}") for number, condition in enumerate(conditions)]
    seen = visible_files(actor).where(file.c.id.in_(select(drawn.c.id)))
    tried = seen.with_only_columns(*holding, file.c.start_ns, file.c.blob_id, maintain_column_froms=True)
    # With a limit the database tries each once, and not for each of the numbers anew.
    each = tried.limit(DRAWN).subquery()
    found = [each.c[condition.name] for condition in holding]
    held, has_time = (found[:1] if is_word else found[len(asked) :]), each.c.start_ns.is_not(None)
    return select(
        *(func.count().filter(condition) for condition in found[: len(asked)]),
        func.count().filter(found[0], has_time).label("found_timed"),
        cast(func.array_agg(each.c.blob_id, type_=ARRAY(Text)).filter(found[0]), Text).label("blob_ids"),
        _numbers([func.count().filter(condition) for condition in held]).label("held"),
        _numbers([func.count().filter(condition, has_time) for condition in held]).label("timed"),
        select(func.count()).select_from(drawn).scalar_subquery().label("drawn"),
        select(drawn.c.id).order_by(drawn.c.id.desc()).limit(1).scalar_subquery().label("last"),
    )


def _numbers(numbers: Sequence[ColumnElement[int]]) -> ColumnElement[Any]:
    return cast(array(numbers, type_=BigInteger), ARRAY(BigInteger))


def walking() -> ColumnElement[str]:
    """Return the column that has lists walked in their order from then on, until the transaction ends.

    Of very many that match, the first are soon met so; of words together the database expects too few for that.
    """
    return func.set_config("enable_sort", "off", True).label("walking")


async def meets_many(db: Connection, matching: FileFilter) -> bool:
    """Say whether a list of files with certain topics is best walked: so many have them that it soon meets some."""
    asked = {"topics": matching.topic, "types": matching.message_type}
    given: dict[str, object] = {kind: names for kind, names in asked.items() if names}
    if not given or any(is_glob(name) for names in asked.values() for name in names):
        return False
    return set((await db.execute(_counted_topics(tuple(given), _MANY_TOPICS), given)).one()) == {_MANY_TOPICS}


@lru_cache(maxsize=KEPT)
def _counted_topics(kinds: Sequence[str], most: int) -> Select[Any]:
    columns = {"topics": topic.c.name, "types": topic.c.message_type}
    named = (select(topic.c.blob_id).where(among_given(columns[kind], kind)) for kind in kinds)
    some = (each.limit(most).subquery() for each in named)
    return select(*(select(func.count()).select_from(each).scalar_subquery() for each in some))


def drawn_missions() -> CTE:
    """Return the ids of missions drawn by lot."""
    return select(mission.c.id).order_by(mission.c.id).limit(_MISSIONS_DRAWN).cte("drawn").prefix_with("MATERIALIZED")


def estimate_missions(hits: int, drawn: int, last_id: int) -> int | None:
    """Return about how many missions are found where so many of those drawn are; exactly where all were drawn.

    Null where none of those drawn is found, and others may be.
    """
    if drawn < _MISSIONS_DRAWN:
        return hits
    return rounded(hits * _IDS // max(last_id, 1)) or None


def rounded(number: int) -> int:
    """Return a number in its first two digits: more is not known of it."""
    digits = max(len(str(number)) - 2, 0)
    return round(number, -digits)
