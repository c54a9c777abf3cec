"""Statistics, for programs."""

from kleinkram.client._http import Api, query_of
from kleinkram.client.search import Wanted, as_filter
from kleinkram.contract.stats import StatsRead


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
