"""Chunks of a bag that are too large to be held: nothing of one is believed before all of it came out."""

from __future__ import annotations

from kleinkram.recordings.compression import ReadUpTo
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.rosbag1 import chunks, records
from kleinkram.recordings.formats.rosbag1.chunks import BagFacts, Record, learn_layout, parse_record, walk_known
from kleinkram.recordings.index_check import FoundMessages
from kleinkram.recordings.large_chunk import LargeChunk, read_cut, read_whole
from kleinkram.recordings.limits import MAX_TAKE
from kleinkram.recordings.message_counts import Batch, Place, Tally


class _Reading:
    def __init__(self, take: ReadUpTo, record: Record, facts: BagFacts, tally: Tally, place: Place) -> None:
        self.found = FoundMessages()
        self._place, self._stored = place, record.data_bytes
        self._kept_facts, self._kept_tally = facts, tally
        self._facts, self._tally = facts.fork(), tally.fork()
        self._batch = Batch(self._facts.connections)
        compression, size = record.fields.text("compression"), place.uncompressed
        self.chunk = LargeChunk(take, compression, stored=self._stored, uncompressed=size, with_crc=False)

    def read(self) -> Malformed | None:
        """Follow the records; return why that ended."""
        return self.chunk.read(self._step, self._flush)

    def prove(self) -> None:
        """Pass over the rest.

        Raises:
            Malformed: the data are damaged.
        """
        self.chunk.finish()

    def keep(self) -> None:
        """Believe what was found."""
        self._kept_facts.adopt(self._facts)
        self._kept_tally.adopt(self._tally)

    def forget(self) -> None:
        """Believe nothing."""
        if self._kept_facts.listener is not None:
            self._kept_facts.listener.forget(self._place)

    def _flush(self) -> None:
        self._tally.learn(self._facts.connections)
        if self._facts.listener is not None:
            self._facts.listener.hear(self._place, self._batch)
        self.found.add(self._batch)
        self._tally.add(self._batch, stored=self._stored, uncompressed=self._place.uncompressed)
        self._batch = Batch(self._facts.connections)

    def _step(self) -> None:
        inner = self.chunk.inner
        after, _ = walk_known(inner.window, inner.at, len(inner.window), self._facts, self._batch)
        if after > inner.at:
            inner.advance(after - inner.at)
            return
        where = f"byte {inner.position} of its contents"
        record = parse_record(inner.window, inner.at, where)
        total = record.end - record.start
        if total > inner.left:
            raise Malformed(where, "a record reaches beyond the end")
        if record.opcode == records.CONNECTION:
            inner.ahead(min(total, MAX_TAKE))
            data_at = inner.at + record.data_start - record.start
            data = bytes(inner.window[data_at : data_at + record.data_bytes])
            chunks.define(record, data, self._facts, where)
        elif record.opcode == records.MESSAGE and self._facts.layout is None:
            self._facts.layout = learn_layout(inner.window, inner.at)
        inner.advance(total)
        if record.opcode == records.MESSAGE:  # not before: it may be cut
            chunks.add_message(record, self._batch)


def read_large_chunk(
    take: ReadUpTo, record: Record, facts: BagFacts, tally: Tally, place: Place
) -> tuple[FoundMessages, Malformed | None]:
    """Add the messages of a chunk whose data `take` gives; return what was found, and why not all of it could be
    followed.

    `place`: of the chunk, for the listener.

    Raises:
        Malformed: its data are damaged, so that nothing of it can be believed; nothing was added.
    """
    reading = _Reading(take, record, facts, tally, place)
    fault = read_whole(reading)
    return reading.found, fault


def read_large_beginning(
    take: ReadUpTo, stored: int, record: Record, facts: BagFacts, tally: Tally, place: Place
) -> int:
    """Add the messages of a chunk whose end is missing, so that `take` gives less of its data; return how many of those
    `stored` bytes they stand in.
    """
    try:
        reading = _Reading(take, record, facts, tally, place)
    except Malformed:
        return 0
    return read_cut(reading, stored)
