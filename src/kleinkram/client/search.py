"""One search over missions, files and topics, for programs. A query is a text; see the page on searching."""

from kleinkram.client._http import Api, query_of
from kleinkram.contract.files import FileFilter, FileSort
from kleinkram.contract.query import parse
from kleinkram.contract.searching import FacetsRead, SearchRead

# What lists of files take: a filter, the text of a query, or None for everything.
Wanted = FileFilter | str | None


class Search:
    """`client.search`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def find(self, query: str = "", *, sort: FileSort | None = None, limit: int | None = None) -> SearchRead:
        """Return the first missions, files (latest first) and topics that a query finds, and how many there are.

        `client.files.list(query)` and `client.missions.list(query=query)` yield all of them.

        Raises:
            InvalidQuery: the query cannot be read; says which word, at which column, and what is possible.
        """
        asked = query_of(None, query=query, sort=sort.value if sort else None, limit=limit)
        return self._api.get("/search", SearchRead, asked)

    def facets(self, query: str = "") -> FacetsRead:
        """Return how the files that a query finds divide, and the query with each value chosen.

        Raises:
            InvalidQuery: as in `find`.
        """
        return self._api.get("/search/facets", FacetsRead, query_of(None, query=query))


def as_filter(wanted: Wanted) -> FileFilter | None:
    """Return the filter that is wanted, read from the text of a query where it is one.

    Raises:
        InvalidQuery: the query cannot be read.
    """
    return parse(wanted) if isinstance(wanted, str) else wanted
