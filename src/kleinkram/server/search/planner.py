"""Planning a search: a sample of files tells whether a filter is common or rare, and which of its words is rarest.

Ids are random, so the files with the lowest ids are a sample. For a common filter, lists are read in their order until
a page is full, and totals are estimates; for a rare one, all files are looked up once. Every statement checks rights.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace

from sqlalchemy import ARRAY, CTE, ColumnElement, Select, Text, and_, cast, func, select, text, true

from kleinkram.contract.files import FileFilter, FileSort
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files, visible_missions
from kleinkram.server.db import Connection
from kleinkram.server.files.queries import file_order, matching_files
from kleinkram.server.filters.files import file_conditions
from kleinkram.server.filters.missions import filter_missions_by_files
from kleinkram.server.filters.plan import (
    ID_COUNT,
    MatchedFiles,
    SearchPlan,
    find_visible_mission_ids,
    prepare_statement,
    rounded,
    words_of,
)
from kleinkram.server.filters.text import file_contains, has_index, look_up_words, occur_somewhere
from kleinkram.server.pagination import in_order
from kleinkram.server.tables import file, mission

# Files sampled, and how many of them make a filter common: with those, an estimate is off by a third.
SAMPLED_FILES, COMMON = 500, 10
SAMPLED_MISSIONS = 100
# Lower where each of several words is common by itself: no index leads to the files that contain all of them.
_COMMON_WITHOUT_INDEX = 3
# A word is common in paths if so many of the sampled paths contain it.
_COMMON_PATHS = 15
# The most files of a rare filter that are looked up.
_MAX_MATCHED = 50_000
# Until the transaction ends. PostgreSQL overestimates the cost of checking rights row by row, and would read all
# missions to join 500 files with them (two million files, somebody with many grants: 244 instead of 12 ms).
_AVOID_HASH_JOINS, _ALLOW_HASH_JOINS = (
    text(f"SELECT set_config('enable_hashjoin', '{value}', true), set_config('enable_mergejoin', '{value}', true)")
    for value in ("off", "on")
)


# Until the transaction ends: enough memory to count many topics; lists are read in the order of an index.
ENLARGE_WORK_MEMORY = text("SELECT set_config('work_mem', '32MB', true)")
AVOID_SORTING = text("SELECT set_config('enable_sort', 'off', true)")


@dataclass(frozen=True)
class Sample:
    """Number of sampled files that match each filter.

    Attributes:
        hits: of each filter, in order.
        size: files in the sample; fewer than `SAMPLED_FILES` where these are all there are.
        file_count: about how many files there are in all.
        blob_ids: the blobs of the files that the first filter finds, as PostgreSQL writes arrays.
        common: the number of hits from which a filter is common.
    """

    hits: Sequence[int]
    size: int
    file_count: int
    blob_ids: str
    common: int

    def is_common(self, number: int = 0) -> bool:
        """Return whether a filter finds too many files to look all of them up."""
        return self.size == SAMPLED_FILES and self.hits[number] >= self.common

    def estimate(self) -> int:
        """Return an estimate of the files that the first filter finds, in two digits."""
        return rounded(self.hits[0] * self.file_count // max(self.size, 1))


def sampled_files() -> CTE:
    """Return the ids of the sampled files, the same each time."""
    return select(file.c.id).order_by(file.c.id).limit(SAMPLED_FILES).cte("sample").prefix_with("MATERIALIZED")


async def plan_search(
    db: Connection, actor: Actor, *filters: FileFilter, sort: FileSort | None = None
) -> tuple[SearchPlan, Sample]:
    """Return the plan for the first filter, and the result of a sample for all filters, whose words are the same.

    Raises:
        InvalidQuery: a `where` cannot be used, or there are too many words.
    """
    words = [*dict.fromkeys(words_of(filters[0].text))]
    plan = SearchPlan(await look_up_words(db, words))
    no_sample = Sample([0] * len(filters), 0, 0, "{}", COMMON)
    sampled = prepare_statement(_sampled, actor, *filters, plan=plan)
    if not await occur_somewhere(db, plan.words.values()):
        return replace(plan, finds_nothing=True), no_sample
    visible_ids = await find_visible_mission_ids(db, actor)
    if visible_ids is not None:
        return replace(plan, mission_ids=visible_ids), no_sample
    if not actor.is_admin:
        await db.execute(_AVOID_HASH_JOINS)
    row = (await db.execute(*sampled)).one()
    hits = row[: len(filters)]
    # The hits of a single word are at least those of the filter.
    word_hits = dict(zip(words, row[len(filters) :] if len(words) > 1 else hits, strict=False))
    file_count = row.size if row.size < SAMPLED_FILES else row.size * ID_COUNT // max(row.last_id.int, 1)
    rarest = min(filter(has_index, words), key=lambda word: word_hits[word], default=None)
    has_selective_word = rarest is None or word_hits[rarest] < COMMON
    sample = Sample(
        hits, row.size, file_count, row.blob_ids or "{}", COMMON if has_selective_word else _COMMON_WITHOUT_INDEX
    )
    if sample.is_common() and sort is FileSort.start_desc and row.timed < _COMMON_WITHOUT_INDEX:
        # Files without a time come last, so that reading in order would pass nearly all others first: only those
        # without are read where an index tells that no other matches (two words at two million files: 1.8 s otherwise).
        timed = replace(plan, leading_word=rarest, has_time=True)
        one_match = prepare_statement(_one_match, actor, filters[0], plan=timed)
        if rarest is not None and (await db.execute(*one_match)).first() is None:
            plan = replace(plan, has_time=False)
        else:
            sample = replace(sample, common=SAMPLED_FILES + 1)
    if sample.is_common():
        return replace(plan, is_common=True), sample
    if not actor.is_admin:
        if rarest is not None and plan.word(rarest).sampled_paths >= _COMMON_PATHS and has_selective_word:
            rarest = None  # common, but not in what the actor sees: its index leads to everybody's files
        # Without a word whose index leads to few files, those of few visible missions are joined one by one.
        if rarest is not None or row.visible >= COMMON:
            await db.execute(_ALLOW_HASH_JOINS)
    return replace(plan, leading_word=rarest), sample


def _one_match(actor: Actor, matching: FileFilter, *, plan: SearchPlan) -> Select[tuple[uuid.UUID]]:
    ids = matching_files(actor, matching, plan).with_only_columns(file.c.id, maintain_column_froms=True)
    every = ids.cte("timed").prefix_with("MATERIALIZED")
    return select(every.c.id).limit(1)


def _sampled(actor: Actor, *filters: FileFilter, plan: SearchPlan) -> Select[tuple[object, ...]]:
    """Return the number of sampled files that match each filter, and each word of the first where it has several.

    Then the attributes of `Sample`; `visible`: the sampled files that the actor sees; and `timed`: the files that match
    the first filter and have a time.
    """
    conditions = [and_(true(), *file_conditions(actor, matching, plan)) for matching in filters]
    words = [*dict.fromkeys(words_of(filters[0].text))]
    conditions += [file_contains(actor, plan, word) for word in words] if len(words) > 1 else []
    sample = sampled_files()
    columns = [condition.label(f"holds_{number}") for number, condition in enumerate(conditions)]
    visible = visible_files(actor).where(file.c.id.in_(select(sample.c.id)))
    # With a limit, each condition is evaluated once a file, and not again for each aggregate.
    tried = visible.with_only_columns(*columns, file.c.blob_id, file.c.start_ns, maintain_column_froms=True).limit(
        SAMPLED_FILES
    )
    evaluated = tried.subquery()
    return select(
        *(func.count().filter(evaluated.c[column.name]) for column in columns),
        select(func.count()).select_from(sample).scalar_subquery().label("size"),
        select(sample.c.id).order_by(sample.c.id.desc()).limit(1).scalar_subquery().label("last_id"),
        func.count().label("visible"),
        func.count().filter(evaluated.c.holds_0, evaluated.c.start_ns.is_not(None)).label("timed"),
        cast(func.array_agg(evaluated.c.blob_id, type_=ARRAY(Text)).filter(evaluated.c.holds_0), Text).label(
            "blob_ids"
        ),
    )


async def find_matched(
    db: Connection, actor: Actor, matching: FileFilter, plan: SearchPlan, *, sort: FileSort, limit: int
) -> SearchPlan:
    """Return the plan with all files that a filter finds, unless these are too many, and the first ones in order."""
    row = (await db.execute(*prepare_statement(_matched, actor, matching, plan=plan, sort=sort, limit=limit + 1))).one()
    return plan if row.file_count > _MAX_MATCHED else replace(plan, matched=MatchedFiles(**row._mapping))


def _matched(
    actor: Actor, matching: FileFilter, *, plan: SearchPlan, sort: FileSort, limit: int
) -> Select[tuple[object, ...]]:
    order = file_order(sort, by_index=False)
    keys = [column.label(f"key_{number}") for number, column in enumerate(order.columns)]
    matched = matching_files(actor, matching, plan)
    matched = matched.with_only_columns(file.c.mission_id, file.c.blob_id, *keys, maintain_column_froms=True)
    every = matched.cte("matched").prefix_with("MATERIALIZED")
    # The limit is outside: inside, PostgreSQL would expect to reach it soon.
    some = select(every).limit(_MAX_MATCHED + 1).cte("some").prefix_with("MATERIALIZED")
    file_id = some.c[keys[-1].name]
    first = in_order(select(file_id), [some.c[key.name] for key in keys], order).limit(limit)
    return select(
        select(func.count()).select_from(some).scalar_subquery().label("file_count"),
        _array(select(file_id)).label("file_ids"),
        _array(select(some.c.mission_id).distinct()).label("mission_ids"),
        _array(select(some.c.blob_id)).label("blob_ids"),
        func.array(first.scalar_subquery()).label("first_ids"),
    )


def _array(rows: Select[tuple[object]]) -> ColumnElement[str]:
    return cast(func.array(rows.scalar_subquery(), type_=ARRAY(Text)), Text)


async def estimate_missions(db: Connection, actor: Actor, by_files: FileFilter, plan: SearchPlan) -> int | None:
    """Estimate from a sample how many missions a filter of files finds; exact where the sample holds all missions.

    None where no sampled mission matches, and others may.
    """
    statement = prepare_statement(_sampled_missions, actor, by_files, plan=plan, size=SAMPLED_MISSIONS)
    row = (await db.execute(*statement)).one()
    if row.sampled < SAMPLED_MISSIONS:
        return int(row.hits)
    return rounded(row.hits * ID_COUNT // max(row.last_id.int, 1)) or None


def _sampled_missions(actor: Actor, by_files: FileFilter, *, plan: SearchPlan, size: int) -> Select[tuple[object, ...]]:
    sample = select(mission.c.id).order_by(mission.c.id).limit(size).cte("sample").prefix_with("MATERIALIZED")
    sampled = visible_missions(actor).where(mission.c.id.in_(select(sample.c.id)))
    matched = filter_missions_by_files(actor, sampled, by_files, plan)
    hits = matched.with_only_columns(mission.c.id, maintain_column_froms=True).subquery()
    return select(
        select(func.count()).select_from(hits).scalar_subquery().label("hits"),
        select(func.count()).select_from(sample).scalar_subquery().label("sampled"),
        select(sample.c.id).order_by(sample.c.id.desc()).limit(1).scalar_subquery().label("last_id"),
    )
