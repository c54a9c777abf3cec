"""Search over HTTP: topics and statistics. Missions and files are searched by their lists."""

from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.files import FileFilter, TopicRead
from kleinkram.contract.names import Term
from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.contract.stats import StatsRead
from kleinkram.server.dependencies import CurrentActor, Transaction
from kleinkram.server.pages import PageRequest
from kleinkram.server.search import service

router = APIRouter(prefix="/api/v1", tags=["search"])


class TopicListQuery(FileFilter):
    """The query of a list of topics; `topic` and `message_type` narrow the topics as well as the files."""

    limit: PageSize = 100
    cursor: Cursor | None = None
    count: bool = False


class StatsQuery(FileFilter):
    """The query of statistics: by `project`, `mission`, `topic`, `type`, `month`, `format` or `metadata.FIELD`."""

    by: Term = "project"


@router.get("/topics", operation_id="list_topics")
async def list_topics(
    query: Annotated[TopicListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[TopicRead]:
    """List the topics of the files that match, by name."""
    page = PageRequest(query.limit, query.cursor, query.count)
    return await service.list_topics(db, actor, matching=query, page=page)


@router.get("/stats", operation_id="get_stats")
async def get_stats(query: Annotated[StatsQuery, Query()], db: Transaction, actor: CurrentActor) -> StatsRead:
    """Return hours, bytes, files and messages of the files that match."""
    return await service.get_stats(db, actor, by=query.by, matching=query)
