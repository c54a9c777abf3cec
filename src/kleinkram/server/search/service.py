"""What is asked across missions and files."""

from dataclasses import replace
from typing import NamedTuple

from kleinkram.contract.base import Page
from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import FileFilter, FileRead, FileSort, TopicRead
from kleinkram.contract.missions import MissionFilter, MissionRead, MissionSort
from kleinkram.contract.query import parse, render
from kleinkram.contract.search import SearchRead, StatsRead, TopicFound
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import Connection
from kleinkram.server.files import service as files
from kleinkram.server.files.queries import TOPIC_ORDER, to_topics
from kleinkram.server.filters.plan import SearchPlan
from kleinkram.server.filters.prepared import prepare
from kleinkram.server.missions import service as missions
from kleinkram.server.pagination import PageRequest, fetch_page
from kleinkram.server.search import queries
from kleinkram.server.search.planner import Sample, find_matched, plan_search

# More rows than anybody reads, and few enough to answer with at once.
MAX_GROUPS = 10_000
_LATEST = MissionSort.start_desc


class _SearchResults(NamedTuple):
    missions: Page[MissionRead]
    files: Page[FileRead]
    topics: Page[TopicFound]


async def search(db: Connection, actor: Actor, *, text: str, sort: FileSort, limit: int) -> SearchRead:
    """Return the first missions, files and topics that a query finds, and how many there are of each.

    Where very many files match, the numbers are estimates, and the topics are those of a sample of files.

    Raises:
        InvalidQuery: the query cannot be read; says which word, at which column.
    """
    matching = parse(text)
    plan, sample = await plan_search(db, actor, matching, sort=sort)
    if plan.finds_nothing:
        results = _SearchResults(Page(items=[], total=0), Page(items=[], total=0), Page(items=[], total=0))
    elif plan.is_common:
        results = await _search_common(db, actor, matching, sort, limit, plan, sample)
    else:
        results = await _search_rare(db, actor, matching, sort, limit, plan)
    return SearchRead(
        query=render(matching),
        filter=matching,
        missions=results.missions,
        files=results.files,
        topics=results.topics,
        is_exact=not plan.is_common,
    )


async def _search_rare(
    db: Connection, actor: Actor, matching: FileFilter, sort: FileSort, limit: int, plan: SearchPlan
) -> _SearchResults:
    """Look all matching files up once, where these are few, and read the rest by their ids."""
    if matching != FileFilter():
        plan = await find_matched(db, actor, matching, plan, sort=sort, limit=limit)
    known, page = plan.matched, PageRequest(limit, count=True)
    missions_found = await missions.list_missions(
        db, actor, matching=MissionFilter(), by_files=matching, sort=_LATEST, page=page, plan=plan
    )
    if known is not None and not known.file_count:
        return _SearchResults(missions_found, Page(items=[], total=0), Page(items=[], total=0))
    if known is not None:
        page = PageRequest(limit)
    files_found = await files.list_files(db, actor, matching=matching, sort=sort, page=page, plan=plan)
    if known is not None:
        files_found = files_found.model_copy(update={"total": known.file_count})
    topics = await _topics(db, actor, matching, plan, known.blob_ids if known else None, limit=limit)
    return _SearchResults(missions_found, files_found, topics)


async def _search_common(
    db: Connection, actor: Actor, matching: FileFilter, sort: FileSort, limit: int, plan: SearchPlan, sample: Sample
) -> _SearchResults:
    """Read the first of very many from lists in their order; totals and topics come from the sample."""
    files_per_sampled = sample.file_count / sample.size
    topics = await _topics(db, actor, matching, plan, sample.blob_ids, limit=limit, files_per_row=files_per_sampled)
    total = await missions.estimate_matching(db, actor, matching, plan)
    # A sort would need all rows that match, of which PostgreSQL expects too few.
    await db.execute(queries.AVOID_SORTING)
    # Where no sampled mission matches, missions are found by their files: one by one, nearly all would be looked into.
    missions_found = await missions.list_missions(
        db,
        actor,
        matching=MissionFilter(),
        by_files=matching,
        sort=_LATEST,
        page=PageRequest(limit, count=total is None),
        plan=replace(plan, is_common=total is not None),
    )
    if total is not None:
        missions_found = missions_found.model_copy(update={"total": total})
    files_found = await files.list_files(db, actor, matching=matching, sort=sort, page=PageRequest(limit), plan=plan)
    files_found = files_found.model_copy(update={"total": sample.estimate()})
    return _SearchResults(missions_found, files_found, topics)


async def _topics(
    db: Connection,
    actor: Actor,
    matching: FileFilter,
    plan: SearchPlan,
    blob_ids: str | None,
    *,
    limit: int,
    files_per_row: float = 1,
) -> Page[TopicFound]:
    by_blobs = blob_ids is not None
    stmt, values = prepare(queries.topics_found, actor, matching, plan=plan, by_blobs=by_blobs, limit=limit)
    rows = (await db.execute(stmt, values | {"topic_blob_ids": blob_ids})).all()
    items = [queries.to_topic_found(row, files_per_row) for row in rows]
    return Page(items=items, total=rows[0].total if rows else 0)


async def list_topics(db: Connection, actor: Actor, *, matching: FileFilter, page: PageRequest) -> Page[TopicRead]:
    """Return a page of the topics of files that match, by name.

    Raises:
        InvalidQuery: a `where` cannot be used.
        InvalidCursor: the cursor is not of this list.
    """
    rows = await fetch_page(db, queries.matching_topics(actor, matching), TOPIC_ORDER, page)
    return Page(items=to_topics(rows.items), next=rows.next, total=rows.total)


async def get_stats(db: Connection, actor: Actor, *, by: str, matching: FileFilter) -> StatsRead:
    """Return statistics of the files that match, grouped by `by`, and in all.

    Raises:
        InvalidQuery: there is no such grouping, it has more than `MAX_GROUPS` groups, or a `where` cannot be used.
    """
    group = queries.group_column(by)
    if group is None:
        reason = "statistics go by project, mission, topic, type, month, format or metadata.FIELD"
        raise InvalidQuery(expression=by, reason=reason)
    if by.startswith("metadata.") and not sees_whole_missions(actor):
        raise InvalidQuery(expression=by, reason="your token or link does not include the metadata of missions")
    if by.startswith("metadata.") and not (await db.execute(queries.has_field(actor, by))).scalar_one():
        names = ", ".join((await db.execute(queries.field_names(actor))).scalars()) or "none"
        reason = f"no mission has such a field; say project, mission, topic, type, month, format or a field: {names}"
        raise InvalidQuery(expression=by.removeprefix("metadata."), reason=reason)
    by_topic = by in {"topic", "type"}
    await db.execute(queries.ENLARGE_WORK_MEMORY)
    grouped = queries.statistics(actor, matching, group=group, by_topic=by_topic, whole=False)
    rows = [queries.to_stats(row) for row in await db.execute(grouped.limit(MAX_GROUPS + 1))]
    if len(rows) > MAX_GROUPS:
        reason = f"these files make more than {MAX_GROUPS} groups; narrow the filter, or group by something coarser"
        raise InvalidQuery(expression=by, reason=reason)
    if queries.shares_no_mission(by):
        return StatsRead(by=by, rows=rows, total=queries.add_up(rows))
    whole = queries.statistics(actor, matching, group=group, by_topic=by_topic, whole=True)
    return StatsRead(by=by, rows=rows, total=queries.to_stats((await db.execute(whole)).one_or_none()))
