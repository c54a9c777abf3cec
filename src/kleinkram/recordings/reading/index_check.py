"""Whether a reader may select chunks by what the index of a file says of them.

The message index behind a chunk tells the times and channels of its messages. Of a local file it is compared with the
index before any chunk is read: the times also decide in which order chunks are opened. Over a network that would cost a
request a chunk, so there it is compared once something is seen to be wrong, and where nothing at all seems to fit a
selection. Where the two differ, the chunk counts as holding what either of them says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from kleinkram.recordings.index_claims import ANY_CHANNEL, UNKNOWN, ChunkClaim, FoundMessages, fault_of_claim
from kleinkram.recordings.listening import CHUNK
from kleinkram.recordings.reading.ahead import Job, do_ahead
from kleinkram.recordings.reading.chunk_table import ChunkTable, Row
from kleinkram.recordings.reading.noticing import Noticed
from kleinkram.recordings.sources import FileSource, Source

MAX_COMPARED_NEAR = 4096
"""Chunks of a local file that are all compared; of a file with more, so many at even distances are compared first."""

MAX_COMPARED_FAR = 16
"""Likewise over a network, where nothing seems to fit a selection."""

_JOB_BYTES = 64 * 2**10
_MOST_BYTES_AHEAD = 2**20

ReadMessageIndex = Callable[[Source, Row], FoundMessages | None]
"""Returns what the message index behind a chunk lists; None where there is none that can be read."""


@dataclass
class IndexCheck:
    """How far the index of one file was compared with its message indexes.

    Attributes:
        is_done: all of it was compared, or it does not come from the file.
        is_doubted: something in it was seen to be wrong.
        span: earliest and latest log time of all chunks; None while not all of a doubted index was compared.
    """

    source: Source
    table: ChunkTable
    noticed: Noticed
    read_message_index: ReadMessageIndex
    is_done: bool = False
    is_doubted: bool = False
    span: tuple[int, int] | None = None
    _is_sampled: bool = False

    def doubt(self) -> None:
        """State that something in the index was seen to be wrong."""
        self.is_doubted = True

    def before_selecting(self) -> None:
        """Compare what can be compared at little cost, before chunks are selected and put in order.

        Raises:
            SourceError: as `Source.read`.
        """
        if isinstance(self.source, FileSource) and self.source.parallel_reads == 1:
            self._compare_some(MAX_COMPARED_NEAR)
        self.settle()

    def when_nothing_fits(self) -> None:
        """Compare a few chunks, because nothing seems to fit a selection.

        Raises:
            SourceError: as `Source.read`.
        """
        self._compare_some(MAX_COMPARED_FAR)
        self.settle()

    def settle(self) -> None:
        """Compare all chunks, if the index is doubted and that was not done yet.

        Raises:
            SourceError: as `Source.read`.
        """
        if self.is_doubted and not self.is_done:
            self._compare(range(len(self.table.rows)), is_all=True)

    def _compare_some(self, most: int) -> None:
        count = len(self.table.rows)
        if self.is_done or self.is_doubted or self._is_sampled or not count:
            return
        step = max(1, count // most)
        self._compare([*range(0, count, step), count - 1] if step > 1 else range(count), is_all=step == 1)
        self._is_sampled = True

    def _compare(self, numbers: Iterable[int], *, is_all: bool) -> None:
        rows, first_ns, last_ns = self.table.rows, UNKNOWN, 0
        for number, found in self._read_message_indexes(numbers):
            row = rows[number]
            corrected = self._corrected(row, found)
            if corrected != row:
                rows.replace(number, corrected)
                self.is_doubted = True
            if row.uncompressed_bytes and (times := _times_of(row, found)):
                first_ns, last_ns = min(first_ns, times[0]), max(last_ns, times[1])
        if is_all:
            self.is_done = True
            self.span = (first_ns, last_ns) if self.is_doubted and first_ns <= last_ns else None

    def _read_message_indexes(self, numbers: Iterable[int]) -> Iterator[tuple[int, FoundMessages | None]]:
        def job_of(number: int) -> Job[tuple[int, FoundMessages | None]]:
            row = self.table.rows[number]
            return Job(_JOB_BYTES, lambda: (number, self.read_message_index(self.source, row)))

        jobs = (job_of(number) for number in numbers)
        workers: int = getattr(self.source, "parallel_reads", 1)
        if workers == 1:
            return (job.run() for job in jobs)
        return do_ahead(jobs, workers=workers, most_bytes=_MOST_BYTES_AHEAD)

    def _corrected(self, row: Row, found: FoundMessages | None) -> Row:
        """Return a chunk with the times and channels that its message index lists, too; note where they differ."""
        if row.kind != CHUNK:
            return row
        is_contradiction = row.first_ns > row.last_ns
        if found is None or not found.messages:
            return row._replace(first_ns=0, last_ns=UNKNOWN, channels=ANY_CHANNEL) if is_contradiction else row
        sets = self.table.sets
        listed = sets.listed(row.channels)
        claim = ChunkClaim(row.start, UNKNOWN, row.first_ns, row.last_ns, row.channels, UNKNOWN)
        fault = fault_of_claim(claim, listed, found)
        if fault is None:
            return row
        self.noticed.add(fault.code, fault.where, fault.message)
        first_ns, last_ns = found.first_ns, found.last_ns
        if not is_contradiction:
            first_ns, last_ns = min(first_ns, row.first_ns), max(last_ns, row.last_ns)
        channels = ANY_CHANNEL if listed is None else sets.number(listed | found.channels)
        return row._replace(first_ns=first_ns, last_ns=last_ns, channels=channels)


def _times_of(row: Row, found: FoundMessages | None) -> tuple[int, int] | None:
    """Return the times of a chunk by its message index, else as the index says; None where that contradicts itself."""
    if found is not None and found.messages:
        return found.first_ns, found.last_ns
    return (row.first_ns, row.last_ns) if row.first_ns <= row.last_ns else None
