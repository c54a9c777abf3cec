"""The record of who did what, for programs."""

import uuid
from collections.abc import Iterator

from kleinkram.client._http import Api, query_of
from kleinkram.client._paging import pages
from kleinkram.contract.audit import AuditRead


class Audit:
    """`client.audit`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(
        self,
        *,
        noun: str | None = None,
        noun_id: uuid.UUID | None = None,
        project_id: uuid.UUID | None = None,
        limit: int | None = None,
    ) -> Iterator[AuditRead]:
        """Yield what happened, latest first."""
        query = query_of(None, noun=noun, noun_id=noun_id, project_id=project_id)
        return pages(self._api, "/audit", AuditRead, query, limit=limit)
