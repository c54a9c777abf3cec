"""The index of an MCAP that has none, or none to be believed: built by scanning the file once from end to end.

What the scan counts is what can be read then; keeps no message.
"""

from __future__ import annotations

from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.forward import SourceForward
from kleinkram.recordings.mcap import records
from kleinkram.recordings.mcap.summary import scan_mcap
from kleinkram.recordings.model import RecordingSummary
from kleinkram.recordings.reading.chunk_table import Row
from kleinkram.recordings.reading.gathering import Gathering
from kleinkram.recordings.reading.mcap_index import McapIndex
from kleinkram.recordings.reading.noticing import Noticed
from kleinkram.recordings.sources import Source


class _Gathering(Gathering):
    def __init__(self, index: McapIndex, noticed: Noticed) -> None:
        super().__init__(index.table, noticed)
        self._definitions = index.definitions

    def define(self, opcode: int, body: bytes, where: str) -> None:
        """Take note of a schema or a channel."""
        read = self._definitions.read_schema if opcode == records.SCHEMA else self._definitions.read_channel
        try:
            read(body, where)
        except Malformed as error:
            self.noticed.add("damaged", error.where, error.message)


def rebuild_index(source: Source, noticed: Noticed) -> tuple[McapIndex, RecordingSummary]:
    """Return the index of what can be read of an MCAP, and its summary; what cannot be read is noted.

    Raises:
        SourceError: as `Source.read`.
    """
    index = McapIndex()
    gathering = _Gathering(index, noticed)
    summary = scan_mcap(SourceForward(source), listener=gathering)
    gathering.close()
    known, rows = index.definitions.channels, index.table.rows
    index.counts = {number: count for number, count in gathering.counts.items() if number in known}
    index.message_count = sum(index.counts.values())
    if index.message_count:
        index.start_ns = min(rows.column(Row._fields.index("first_ns")))
        index.end_ns = max(rows.column(Row._fields.index("last_ns")))
    return index, summary
