"""Routes of the search: missions, files and topics of a query, its facets and statistics."""

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict

from kleinkram.contract.base import Cursor, Page, PageSize
from kleinkram.contract.files import FileSort, TopicRead
from kleinkram.contract.names import Term
from kleinkram.contract.query import combined_filter
from kleinkram.contract.search import FacetsRead, FileQuery, QueryText, SearchRead, StatsRead
from kleinkram.server.http.dependencies import CurrentActor, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.pagination import PageRequest
from kleinkram.server.search import facets, service, statistics

router = APIRouter(prefix="/api/v1", tags=["search"], responses=FAILURE_RESPONSES)


class SearchQuery(BaseModel):
    """Parameters of a search: the query, the number of results of each kind, and the order of files."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    query: QueryText = ""
    sort: FileSort = FileSort.start_desc
    limit: PageSize = 20


class TopicListQuery(FileQuery):
    """Query parameters of a list of topics; `topic` and `message_type` select topics as well as files."""

    limit: PageSize = 100
    cursor: Cursor | None = None
    count: bool = False


class StatsQuery(FileQuery):
    """Query parameters of statistics. `by` is project, mission, topic, type, month, format or metadata.FIELD.

    Files that runs made count only with `derived`.
    """

    by: Term = "project"
    derived: bool = False


@router.get("/search", operation_id="search")
async def search(query: Annotated[SearchQuery, Query()], db: Transaction, actor: CurrentActor) -> SearchRead:
    """Return the first missions, files and topics that a query finds, and the number of each."""
    return await service.search(db, actor, text=query.query, sort=query.sort, limit=query.limit)


@router.get("/search/facets", operation_id="get_facets")
async def get_facets(db: Transaction, actor: CurrentActor, query: Annotated[QueryText, Query()] = "") -> FacetsRead:
    """Return the facets of the files that a query finds, and the query with each value selected."""
    return await facets.get_facets(db, actor, query=query)


@router.get("/topics", operation_id="list_topics")
async def list_topics(
    query: Annotated[TopicListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[TopicRead]:
    """List the topics of the files that match, by name."""
    page = PageRequest(query.limit, query.cursor, query.count)
    return await service.list_topics(db, actor, matching=combined_filter(query), page=page)


@router.get("/stats", operation_id="get_stats")
async def get_stats(query: Annotated[StatsQuery, Query()], db: Transaction, actor: CurrentActor) -> StatsRead:
    """Return hours, bytes, files and messages of the files that match."""
    matching = combined_filter(query)
    return await statistics.get_stats(db, actor, by=query.by, matching=matching, with_derived=query.derived)
