"""What is asked across missions and files."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Row

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import FileFilter, FileRead, FileSort, TopicRead
from kleinkram.contract.missions import MissionRead, MissionSort
from kleinkram.contract.paging import Page
from kleinkram.contract.query import parse, render
from kleinkram.contract.searching import SearchRead, TopicFound
from kleinkram.contract.stats import StatsRead
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import Connection
from kleinkram.server.files import service as files
from kleinkram.server.files.topics import TOPIC_ORDER, to_topics
from kleinkram.server.filters.asked import asked_alike, values
from kleinkram.server.filters.looking import Outlook, look_ahead
from kleinkram.server.missions import service as missions
from kleinkram.server.paging import PageRequest, fetch_page
from kleinkram.server.search import queries
from kleinkram.server.search.few import find_few

# More rows than anybody reads, and few enough to answer with at once.
MAX_GROUPS = 10_000
_LATEST = MissionSort.start_desc
_Found = tuple[Page[MissionRead], Page[FileRead], Page[TopicFound]]


async def search(db: Connection, actor: Actor, *, text: str, sort: FileSort, limit: int) -> SearchRead:
    """Return the first missions, files and topics that a query finds, and how many there are of each.

    Of very many files they are estimates, and the topics are those of files drawn by lot.

    Raises:
        InvalidQuery: the query cannot be read; says which word, at which column.
    """
    matching = parse(text)
    actor, outlook = await look_ahead(db, actor, matching, lists=sort is FileSort.start_desc)
    if actor.looked.finds_nothing:
        empty: Page[Any] = Page(items=[], total=0)
        return SearchRead(
            query=render(matching), filter=matching, missions=empty, files=empty, topics=empty, is_whole=True
        )
    is_whole = outlook is None or not outlook.finds_many()
    if outlook is None or is_whole:
        found = await _counted(db, actor, matching, sort, limit)
    else:
        found = await _estimated(db, actor, matching, sort, limit, outlook)
    missions_found, files_found, topics_found = found
    return SearchRead(
        query=render(matching),
        filter=matching,
        missions=missions_found,
        files=files_found,
        topics=topics_found,
        is_whole=is_whole,
    )


async def _counted(db: Connection, actor: Actor, matching: FileFilter, sort: FileSort, limit: int) -> _Found:
    """Look for all that there is. Where it is little, it is looked for once, and then read by its ids."""
    await db.execute(queries.room_to_count())
    if matching != FileFilter():
        actor = await find_few(db, actor, matching, sort=sort, limit=limit)
    known = actor.looked.found
    missions_found = await missions.list_found(db, actor, found=matching, sort=_LATEST, limit=limit, count=True)
    if known is None:
        files_found = await files.list_files(
            db, actor, matching=matching, sort=sort, page=PageRequest(limit, count=True)
        )
    else:
        files_found = await files.list_found(db, actor, found=matching, sort=sort, limit=limit)
        files_found = files_found.model_copy(update={"total": known.file_count})
    topics = queries.topics_found(asked_alike(actor, matching), limit=limit, of_blobs=known is not None)
    rows = (await db.execute(topics, values(actor, matching))).all()
    return missions_found, files_found, _topics_of(rows)


async def _estimated(
    db: Connection, actor: Actor, matching: FileFilter, sort: FileSort, limit: int, outlook: Outlook
) -> _Found:
    """Look for the first of very many; how many there are, and their topics, as seen from what was drawn by lot."""
    topics = queries.topics_found(asked_alike(actor, matching), limit=limit, of_blobs=True)
    given = values(actor, matching) | {"found_blob_ids": outlook.blob_ids}
    rows = (await db.execute(topics, given)).all()
    total = await missions.estimate_found(db, actor, matching)
    # Where so few missions hold them that none was met by lot, these are found by their files: one by one, the database
    # would look into nearly all others first.
    looked = replace(actor.looked, finds_many=total is not None)
    missions_found = await missions.list_found(
        db, replace(actor, looked=looked), found=matching, sort=_LATEST, limit=limit, count=total is None
    )
    files_found = await files.list_found(db, actor, found=matching, sort=sort, limit=limit)
    return (
        missions_found if total is None else missions_found.model_copy(update={"total": total}),
        files_found.model_copy(update={"total": outlook.estimate()}),
        _topics_of(rows, times=outlook.files / outlook.drawn),
    )


def _topics_of(rows: Sequence[Row[Any]], times: float = 1) -> Page[TopicFound]:
    return Page(items=[queries.to_topic_found(row, times) for row in rows], total=rows[0].total if rows else 0)


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
        raise InvalidQuery(expression=by, reason="what you came with does not show metadata of missions")
    if by.startswith("metadata.") and not (await db.execute(queries.has_field(actor, by))).scalar_one():
        names = ", ".join((await db.execute(queries.field_names(actor))).scalars()) or "none"
        reason = f"no mission has such a field; say project, mission, topic, type, month, format or a field: {names}"
        raise InvalidQuery(expression=by.removeprefix("metadata."), reason=reason)
    by_topic = by in {"topic", "type"}
    await db.execute(queries.room_to_count())
    grouped = queries.statistics(actor, matching, group=group, by_topic=by_topic, whole=False)
    rows = [queries.to_stats(row) for row in await db.execute(grouped.limit(MAX_GROUPS + 1))]
    if len(rows) > MAX_GROUPS:
        reason = f"these files make more than {MAX_GROUPS} groups; narrow the filter, or group by something coarser"
        raise InvalidQuery(expression=by, reason=reason)
    if queries.shares_no_mission(by):
        return StatsRead(by=by, rows=rows, total=queries.add_up(rows))
    whole = queries.statistics(actor, matching, group=group, by_topic=by_topic, whole=True)
    return StatsRead(by=by, rows=rows, total=queries.to_stats((await db.execute(whole)).one_or_none()))
