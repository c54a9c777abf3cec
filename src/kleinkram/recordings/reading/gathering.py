"""A listener of a scan: from what it is told to the table of chunks by which the messages are read."""

from __future__ import annotations

from kleinkram.recordings.limits import MAX_CHUNKS, WINDOW
from kleinkram.recordings.listening import RECORDS, Place
from kleinkram.recordings.reading.chunk_table import ChunkTable, Row
from kleinkram.recordings.reading.noticing import Noticed
from kleinkram.recordings.tally import ROW, Batch

_MOST_OF_RUN = 8192
_MOST_STRETCHES = 200_000
_NO_TIME = (2**64 - 1, 0)


class Gathering:
    """Gathers the places of messages into rows of a table.

    Attributes:
        counts: messages by channel; those of several channels of one topic count for one of them.
    """

    def __init__(self, table: ChunkTable, noticed: Noticed) -> None:
        self.counts: dict[int, int] = {}
        self.noticed = noticed
        self._table = table
        self._place: Place | None = None
        self._channels: set[int] = set()
        self._first_ns, self._last_ns = _NO_TIME
        self._messages = 0
        self._counts_here: dict[int, int] = {}
        self._stretches = 0

    def hear(self, place: Place, batch: Batch) -> None:
        """Take note of messages at a place, which may come in several calls."""
        if not any(batch.values()):
            return
        if self._place is None or not self._joins(place):
            self.close()
            self._place = place
        elif place.kind == RECORDS:
            length = self._place.length + place.length
            self._place = self._place._replace(length=length, uncompressed=length)
        seen: set[int] = set()
        for number, rows in batch.items():
            stamps = rows[0::ROW]
            if not stamps:
                continue
            self._channels.add(number)
            if id(rows) in seen:  # channels of one topic share it
                continue
            seen.add(id(rows))
            self._counts_here[number] = self._counts_here.get(number, 0) + len(stamps)
            self._messages += len(stamps)
            self._first_ns, self._last_ns = min(self._first_ns, min(stamps)), max(self._last_ns, max(stamps))

    def close(self) -> None:
        """End the row that was begun, if any."""
        place = self._place
        if place is not None and self._remembers(place):
            kind, start, length, uncompressed, stretches = place
            members = self._table.sets.number(self._channels)
            times = self._first_ns, self._last_ns
            self._table.rows.append(Row(start, length, start + length, *times, kind, members, uncompressed))
            if stretches is not None:
                self._table.stretches[start] = stretches
        for number, count in self._counts_here.items():
            self.counts[number] = self.counts.get(number, 0) + count
        self._begin()

    def forget(self, place: Place) -> None:
        """Take back the messages at a place, if they were the last that were told of."""
        if self._place is not None and self._place.start == place.start:
            self._begin()

    def _begin(self) -> None:
        self._place, self._messages = None, 0
        self._channels, self._counts_here = set(), {}
        self._first_ns, self._last_ns = _NO_TIME

    def _joins(self, place: Place) -> bool:
        known = self._place
        if known is None or known.kind != place.kind:
            return False
        if place.kind != RECORDS:
            return known.start == place.start
        fits = known.length + place.length <= WINDOW and self._messages < _MOST_OF_RUN
        return fits and known.start + known.length == place.start

    def _remembers(self, place: Place) -> bool:
        """Say whether there is room for a place; a file of nothing but damage is not remembered to its end."""
        self._stretches += len(place.stretches or ())
        if self._stretches <= _MOST_STRETCHES and len(self._table.rows) < MAX_CHUNKS:
            return True
        self.noticed.add("too-damaged", f"byte {place.start}", "left out: the file has too many places to remember")
        return False
