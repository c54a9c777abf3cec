"""Statistics, for programs."""

from typing_extensions import Unpack

from kleinkram.client._http import Api, query_of
from kleinkram.client.projects import Projects
from kleinkram.client.references import Ref
from kleinkram.client.search import FileFields, Wanted, as_filter
from kleinkram.contract.stats import Overview, StatsRead


class Stats:
    """`client.stats`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def get(self, by: str = "project", matching: Wanted = None, **fields: Unpack[FileFields]) -> StatsRead:
        """Return hours, bytes, files and messages of the matching files.

        `by` is `project`, `mission`, `topic`, `type`, `month`, `format` or `metadata.FIELD`.

        Raises:
            InvalidQuery: `by` is none of these.
        """
        return self._api.get("/stats", StatsRead, query_of(as_filter(matching, fields), by=by))

    def overview(
        self, by: str = "month", *, project: Ref | None = None, project_id: Ref | None = None, most: int = 20
    ) -> Overview:
        """Return what a project amounts to, or all that one may see, in at most so many buckets.

        `by` is `month`, of recording, or the name of a metadata field.

        Raises:
            NotFound: there is no such project.
            InvalidQuery: no mission has such a field.
        """
        where = project if project is not None else project_id
        path = "/overview" if where is None else f"/projects/{Projects(self._api).id_of(where)}/stats"
        return self._api.get(path, Overview, query_of(None, by=by, most=most))
