"""What each metadata.yaml of a mission says. Reads the store, never the database; a child process does the parsing.

A mission is derived again with every file that was read, and parsing such a file takes a tenth of a second and more:
a worker remembers what it understood, by the object's key, since objects never change.
"""

import math
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row

from kleinkram.contract.names import file_name
from kleinkram.recordings import Rosbag2Metadata, SummaryFailed, metadata_request_bytes
from kleinkram.recordings.formats.rosbag2.metadata import METADATA_NAME
from kleinkram.server.blobs.reader_processes import ReaderProcesses
from kleinkram.server.context import AppContext

# About 1400 topics. Untrusted YAML takes 18 s a megabyte; what is larger is not looked at.
_LIMIT_BYTES = 256 * 1024
_LIMIT_S = 60.0
# Of text; understood it takes some five times as much.
_REMEMBERED_BYTES = 8 * 1024 * 1024


class Understanding:
    """Understands metadata.yaml files, and remembers them up to a bound. One a worker."""

    def __init__(self, readers: ReaderProcesses) -> None:
        self._readers = readers
        self._known: dict[str, Rosbag2Metadata | SummaryFailed | None] = {}
        self._size_bytes = 0

    async def of(self, context: AppContext, rows: Sequence[Row[Any]]) -> dict[str, Rosbag2Metadata | None]:
        """Return by path what the metadata.yaml files among these say; None for one that is no such thing.

        Those that are too large, cost too much to read, or are gone from the store, are left out.
        """
        stated: dict[str, Rosbag2Metadata | None] = {}
        for row in rows:
            if file_name(row.path) != METADATA_NAME or row.size_bytes > _LIMIT_BYTES:
                continue
            if row.key not in self._known:
                try:
                    await self._learn(context, row)
                except FileNotFoundError:
                    continue
            said = self._known[row.key]
            if not isinstance(said, SummaryFailed):
                stated[row.path] = said
        return stated

    async def _learn(self, context: AppContext, row: Row[Any]) -> None:
        body = b"".join([piece async for piece in context.storage.read(row.key)])
        timeout_s = min(_LIMIT_S, context.settings.summary_timeout_s)
        request = metadata_request_bytes(
            body.decode("utf-8", "replace"),
            memory_bytes=context.settings.summary_memory_bytes,
            timeout_s=math.ceil(timeout_s),
        )
        said: Rosbag2Metadata | SummaryFailed | None
        try:
            said = await self._readers.metadata(request, owner=row.uploaded_by_id, timeout_s=timeout_s)
        except SummaryFailed as failure:  # it would cost as much the next time
            said = failure
        if self._size_bytes + len(body) > _REMEMBERED_BYTES:
            self._known, self._size_bytes = {}, 0
        self._known[row.key] = said
        self._size_bytes += len(body)
