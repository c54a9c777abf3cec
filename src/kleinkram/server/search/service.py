"""A search across missions, files and topics. Where very many files match, totals are estimates."""

from dataclasses import replace
from typing import Any, NamedTuple

from sqlalchemy import Integer, Select, bindparam, case, func, literal, select, true

from kleinkram.contract.base import Page
from kleinkram.contract.files import FileFilter, FileRead, FileSort, TopicRead
from kleinkram.contract.missions import MissionFilter, MissionRead, MissionSort
from kleinkram.contract.query import parse, render
from kleinkram.contract.search import SearchRead, TopicFound
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files
from kleinkram.server.db import ArrayText, Connection
from kleinkram.server.files import service as files
from kleinkram.server.files.queries import topic_listing, topic_rows
from kleinkram.server.filters.files import filter_files, filter_topics
from kleinkram.server.filters.plan import SearchPlan, prepare_statement, rounded, words_of
from kleinkram.server.filters.text import contains
from kleinkram.server.missions import service as missions
from kleinkram.server.pagination import PageRequest, read_listing
from kleinkram.server.search.planner import AVOID_SORTING, Sample, estimate_missions, find_matched, plan_search
from kleinkram.server.tables import file, topic

_LATEST = MissionSort.start_desc


class _SearchResults(NamedTuple):
    missions: Page[MissionRead]
    files: Page[FileRead]
    topics: Page[TopicFound]


async def search(db: Connection, actor: Actor, *, text: str, sort: FileSort, limit: int) -> SearchRead:
    """Return the first missions, files and topics that a query finds, and how many there are of each.

    Where very many files match, the numbers are estimates, and the topics are those of a sample of files.

    Raises:
        InvalidQuery: the query cannot be read; names the word and its column.
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
    total = await estimate_missions(db, actor, matching, plan)
    # A sort would need all rows that match, of which PostgreSQL expects too few.
    await db.execute(AVOID_SORTING)
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


class _TopicRow(NamedTuple):
    name: str
    message_type: str | None
    file_count: int
    message_count: int | None
    total: int


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
    stmt, values = prepare_statement(
        topics_found, actor, matching, plan=plan, by_blobs=blob_ids is not None, limit=limit
    )
    result = await db.execute(stmt, values | {"topic_blob_ids": blob_ids})
    rows = [_TopicRow._make(row) for row in result]

    def estimate(number: int) -> int:
        return number if files_per_row == 1 else rounded(round(float(number) * files_per_row))

    items = [
        TopicFound(
            name=row.name,
            message_type=row.message_type,
            file_count=estimate(row.file_count),
            message_count=None if row.message_count is None else estimate(row.message_count),
        )
        for row in rows
    ]
    return Page(items=items, total=rows[0].total if rows else 0)


def topics_found(actor: Actor, matching: FileFilter, *, plan: SearchPlan, by_blobs: bool, limit: int) -> Select[Any]:
    """Return the first topics of the files that match, each name and type once, as `_TopicRow`.

    With `by_blobs`, the files are given as `topic_blob_ids`, which this request has found before. Topics whose names
    contain the most words of the filter come first, then those of the most files.
    """
    if by_blobs:
        files = select(func.unnest(bindparam("topic_blob_ids", type_=ArrayText("UUID"))).label("blob_id"))
    else:
        files = filter_files(actor, visible_files(actor), matching, plan)
        files = files.with_only_columns(file.c.blob_id, maintain_column_froms=True)
    files_found = files.cte("found").prefix_with("MATERIALIZED")
    # A blob names each topic once, so that there is a row for each of its files. OFFSET 0 keeps PostgreSQL from
    # reading all topics there are instead of those of each blob.
    its_topics = filter_topics(select(topic).where(topic.c.blob_id == files_found.c.blob_id), matching)
    one_topic = its_topics.offset(0).lateral("file_topic")
    name, message_type, file_count = one_topic.c.name, one_topic.c.message_type, func.count()
    columns = (
        name,
        message_type,
        file_count.label("file_count"),
        func.sum(one_topic.c.count).label("message_count"),
        func.count().over().label("total"),
    )
    label = name.concat(func.coalesce(literal(" ").concat(message_type), ""))
    words = map(plan.word, words_of(matching.text))
    word_count = sum((case((contains(label, word), 1), else_=0) for word in words), literal(0, Integer))
    grouped = select(*columns).join_from(files_found, one_topic, true()).group_by(name, message_type)
    return grouped.order_by(word_count.desc(), file_count.desc(), name, message_type).limit(limit)


async def list_topics(db: Connection, actor: Actor, *, matching: FileFilter, page: PageRequest) -> Page[TopicRead]:
    """Return a page of the topics of files that match, by name; topic and type globs select the topics as well.

    Raises:
        InvalidQuery: a `where` cannot be used.
        InvalidCursor: the cursor is not of this list.
    """
    files_found = filter_files(actor, visible_files(actor), matching)
    return await read_listing(db, topic_listing(filter_topics(topic_rows(files_found), matching)), page)
