"""What each metadata.yaml of a mission says. Reads the store, never the database.

A mission is derived again with every file that was read, and parsing such a file takes a tenth of a second and more:
a worker remembers what it understood, by the object's key, since objects never change.
"""

import asyncio
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row

from kleinkram.contract.names import file_name
from kleinkram.recordings import Rosbag2Metadata, parse_rosbag2_metadata
from kleinkram.recordings.grouping import METADATA_NAME
from kleinkram.server.storage import Storage

# About 1400 topics. Untrusted YAML takes 18 s a megabyte; what is larger is not looked at.
_LIMIT_BYTES = 256 * 1024
# Of text; understood it takes some five times as much.
_REMEMBERED_BYTES = 8 * 1024 * 1024


class Understanding:
    """Understands metadata.yaml files, and remembers them up to a bound. One a worker."""

    def __init__(self) -> None:
        self._known: dict[str, Rosbag2Metadata | None] = {}
        self._size_bytes = 0

    async def of(self, storage: Storage, rows: Sequence[Row[Any]]) -> dict[str, Rosbag2Metadata | None]:
        """Return by path what the metadata.yaml files among these say; None for one that is no such thing.

        Those that are too large, or gone from the store, are left out.
        """
        stated: dict[str, Rosbag2Metadata | None] = {}
        for row in rows:
            if file_name(row.path) != METADATA_NAME or row.size_bytes > _LIMIT_BYTES:
                continue
            if row.key not in self._known:
                try:
                    await self._learn(storage, row)
                except FileNotFoundError:
                    continue
            stated[row.path] = self._known[row.key]
        return stated

    async def _learn(self, storage: Storage, row: Row[Any]) -> None:
        body = b"".join([piece async for piece in storage.read(row.key)])
        # In a thread: the worker's heartbeat goes on meanwhile.
        said = await asyncio.to_thread(parse_rosbag2_metadata, body.decode("utf-8", "replace"))
        if self._size_bytes + len(body) > _REMEMBERED_BYTES:
            self._known, self._size_bytes = {}, 0
        self._known[row.key] = said
        self._size_bytes += len(body)
