"""The record of who did what, for programs."""

from collections.abc import Iterator

from kleinkram.client._http import Api, query_of
from kleinkram.client._paging import Listing, pages
from kleinkram.contract.audit import AuditFilter, AuditRead


class Audit:
    """`client.audit`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(self, matching: AuditFilter | None = None, *, limit: int | None = None) -> Listing[AuditRead]:
        """Yield the events that match, latest first."""
        return pages(self._api, "/audit", AuditRead, query_of(matching), limit=limit)

    def export(self, matching: AuditFilter | None = None) -> Iterator[AuditRead]:
        """Yield all events that match, oldest first, as the server sends them: of any number, few in memory.

        Raises:
            ServerUnreachable: the connection broke; what was yielded is not all.
        """
        return self._api.stream("/audit/export", AuditRead, query_of(matching))
