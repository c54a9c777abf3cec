"""Chunks of an MCAP that are too large to be held: nothing of one is believed before its CRC is known."""

from __future__ import annotations

from kleinkram.recordings.compression import ReadUpTo
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.chunks import ChunkHead, read_definition, read_large_message, tell, walk_messages
from kleinkram.recordings.formats.mcap.records import RECORD_HEAD, McapFacts
from kleinkram.recordings.index_check import FoundMessages
from kleinkram.recordings.large_chunk import LargeChunk, read_cut, read_whole
from kleinkram.recordings.message_counts import Batch, Place, Tally


class _Reading:
    def __init__(
        self,
        take: ReadUpTo,
        head: ChunkHead,
        facts: McapFacts,
        tally: Tally,
        place: Place,
    ) -> None:
        self.found = FoundMessages()
        self._head, self._place = head, place
        self._kept_facts, self._kept_tally = facts, tally
        self._facts, self._tally = facts.fork(), tally.fork()
        self._batch = Batch(self._facts.channels)
        self.chunk = LargeChunk(take, head.compression, stored=head.stored, uncompressed=head.uncompressed)

    def read(self) -> Malformed | None:
        """Follow the records; return why that ended."""
        return self.chunk.read(self._step, self._flush)

    def prove(self) -> None:
        """Pass over the rest.

        Raises:
            Malformed: the data are damaged, or their checksum is wrong.
        """
        crc = self.chunk.finish()
        if self._head.crc and crc != self._head.crc:
            raise Malformed("chunk", "its checksum is wrong")

    def keep(self) -> None:
        """Believe what was found."""
        self._kept_facts.adopt(self._facts)
        self._kept_tally.adopt(self._tally)

    def forget(self) -> None:
        """Believe nothing."""
        if self._kept_facts.listener is not None:
            self._kept_facts.listener.forget(self._place)

    def _flush(self) -> None:
        self._tally.learn(self._facts.channels)
        tell(self._facts, self._place, self._batch)
        self.found.add(self._batch)
        self._tally.add(self._batch, stored=self._head.stored, uncompressed=self._head.uncompressed)
        self._batch = Batch(self._facts.channels)

    def _step(self) -> None:
        inner = self.chunk.inner
        after, _ = walk_messages(inner.window, inner.at, len(inner.window), self._batch)
        if after > inner.at:
            inner.advance(after - inner.at)
            return
        if len(inner.window) - inner.at < RECORD_HEAD.size:
            raise Malformed(f"byte {inner.position}", "it ends within a record")
        opcode, length = RECORD_HEAD.unpack_from(inner.window, inner.at)
        if opcode == 0 or RECORD_HEAD.size + length > inner.left:
            raise Malformed(f"byte {inner.position}", "its records break off")
        if opcode == records.MESSAGE:
            channel_id, row = read_large_message(inner)
            inner.advance(RECORD_HEAD.size + length)  # before it counts: it may be cut
            self._batch[channel_id].extend(row)
            return
        read_definition(inner, self._facts, opcode, length)
        inner.advance(RECORD_HEAD.size + length)


def read_large_chunk(
    take: ReadUpTo, head: ChunkHead, facts: McapFacts, tally: Tally, place: Place
) -> tuple[FoundMessages, Malformed | None]:
    """Add the messages of a chunk whose data `take` gives; return what was found, and why not all of it could be
    followed.

    `place`: of the chunk, for the listener.

    Raises:
        Malformed: nothing of it can be believed; nothing was added.
    """
    reading = _Reading(take, head, facts, tally, place)
    fault = read_whole(reading)
    return reading.found, fault


def read_large_beginning(
    take: ReadUpTo, stored: int, head: ChunkHead, facts: McapFacts, tally: Tally, place: Place
) -> int:
    """Add the messages of a chunk whose end is missing, so that `take` gives less of its data; return how many of those
    `stored` bytes they stand in.
    """
    try:
        reading = _Reading(take, head, facts, tally, place)
    except Malformed:
        return 0
    return read_cut(reading, stored)
