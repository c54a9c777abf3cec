"""Statistics, for programs."""

import uuid

from kleinkram.client._http import Api, query_of
from kleinkram.client.search import Wanted, as_filter
from kleinkram.contract.stats import Overview, StatsRead


class Stats:
    """`client.stats`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def get(self, by: str = "project", matching: Wanted = None) -> StatsRead:
        """Return hours, bytes, files and messages of the matching files.

        `by` is `project`, `mission`, `topic`, `type`, `month`, `format` or `metadata.FIELD`.

        Raises:
            InvalidQuery: `by` is none of these.
        """
        return self._api.get("/stats", StatsRead, query_of(as_filter(matching), by=by))

    def overview(self, by: str = "month", *, project_id: uuid.UUID | None = None, most: int = 20) -> Overview:
        """Return what a project amounts to, or all that one may see, in at most so many buckets.

        `by` is `month`, of recording, or the name of a metadata field.

        Raises:
            NotFound: there is no such project.
            InvalidQuery: no mission has such a field.
        """
        path = "/overview" if project_id is None else f"/projects/{project_id}/stats"
        return self._api.get(path, Overview, query_of(None, by=by, most=most))
