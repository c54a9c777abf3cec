"""What is asked across missions and files."""

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import FileFilter, FileSort, TopicRead
from kleinkram.contract.missions import MissionFilter, MissionSort
from kleinkram.contract.paging import Page
from kleinkram.contract.query import parse, render
from kleinkram.contract.searching import SearchRead, TopicFound
from kleinkram.contract.stats import StatsRead
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import Connection
from kleinkram.server.files import service as files
from kleinkram.server.missions import service as missions
from kleinkram.server.pages import PageRequest, fetch_page
from kleinkram.server.search import queries
from kleinkram.server.search.looking import Outlook, look_ahead
from kleinkram.server.search.topics import TOPIC_ORDER, to_topic

# More rows than anybody reads, and few enough to answer with at once.
MAX_GROUPS = 10_000


async def search(db: Connection, actor: Actor, *, text: str, sort: FileSort, limit: int) -> SearchRead:
    """Return the first missions, files and topics that a query finds, and how many there are of each.

    Of very many files they are estimates, and the topics are those of files drawn by lot.

    Raises:
        InvalidQuery: the query cannot be read; says which word, at which column.
    """
    matching = parse(text)
    actor, outlook = await look_ahead(db, actor, matching)
    estimate = outlook.estimate() if outlook is not None and outlook.finds_many() else None
    page = PageRequest(limit, count=estimate is None)
    if estimate is not None:
        await db.execute(queries.walking(True))
    found_missions = await missions.list_missions(
        db, actor, matching=MissionFilter(), found=matching, sort=MissionSort.start_desc, page=page
    )
    found_files = await files.list_files(db, actor, matching=matching, sort=sort, page=page)
    if estimate is not None:
        await db.execute(queries.walking(False))
        found_missions = found_missions.model_copy(update={"total": await missions.estimate_found(db, actor, matching)})
        found_files = found_files.model_copy(update={"total": estimate})
    return SearchRead(
        query=render(matching),
        filter=matching,
        missions=found_missions,
        files=found_files,
        topics=await _topics_found(db, actor, matching, limit, outlook if estimate is not None else None),
        is_whole=estimate is None,
    )


async def _topics_found(
    db: Connection, actor: Actor, matching: FileFilter, limit: int, outlook: Outlook | None
) -> Page[TopicFound]:
    await db.execute(queries.room_to_count())
    rows = (await db.execute(queries.topics_found(actor, matching, limit=limit, drawn=outlook is not None))).all()
    times = outlook.files / outlook.drawn if outlook is not None else 1
    return Page(items=[queries.to_topic_found(row, times) for row in rows], total=rows[0].total if rows else 0)


async def list_topics(db: Connection, actor: Actor, *, matching: FileFilter, page: PageRequest) -> Page[TopicRead]:
    """Return a page of the topics of files that match, by name.

    Raises:
        InvalidQuery: a `where` cannot be used.
        InvalidCursor: the cursor is not of this list.
    """
    rows = await fetch_page(db, queries.matching_topics(actor, matching), TOPIC_ORDER, page)
    return Page(items=[to_topic(row) for row in rows.items], next=rows.next, total=rows.total)


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
    by_topic = by in {"topic", "type"}
    await db.execute(queries.room_to_count())
    grouped = queries.statistics(actor, matching, group=group, by_topic=by_topic, whole=False)
    rows = [queries.to_stats(row) for row in await db.execute(grouped.limit(MAX_GROUPS + 1))]
    if len(rows) > MAX_GROUPS:
        reason = f"these files make more than {MAX_GROUPS} groups; narrow the filter, or group by something coarser"
        raise InvalidQuery(expression=by, reason=reason)
    whole = queries.statistics(actor, matching, group=group, by_topic=by_topic, whole=True)
    return StatsRead(by=by, rows=rows, total=queries.to_stats((await db.execute(whole)).one_or_none()))
