"""Checks the chunk index of a recording against its messages, and corrects it for reading.

A reader selects chunks by the times and channels in the index; where these are wrong, it would miss messages. A summary
compares the chunk index with the message indexes behind the chunks, a scan with the messages themselves.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from operator import gt
from typing import NamedTuple

from kleinkram.recordings.chunk_table import ANY_CHANNEL, UNKNOWN, ChannelSets, ChunkTable, Int64Table, Row
from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.file_summary import merge_similar
from kleinkram.recordings.model import Problem, counted
from kleinkram.recordings.scanned_messages import BATCH_STRIDE, Batch, LocationKind
from kleinkram.recordings.sources import FileSource, ReadAheadTask, Source, read_ahead

_MAX_FAULTS = 10_000


class ChunkClaim(NamedTuple):
    """A chunk at [start, end), by the index or by a scan: inclusive times, channels, messages.

    `channels`: number of a set; `end`, `messages`: `UNKNOWN` where the index does not state them.
    """

    start: int
    end: int
    first_ns: int
    last_ns: int
    channels: int
    messages: int


@dataclass
class ChunkMessages:
    """Times and channels of the messages of one chunk."""

    first_ns: int = UNKNOWN
    last_ns: int = 0
    messages: int = 0
    channels: set[int] = field(default_factory=set)

    def add(self, batch: Batch) -> None:
        """Add the messages of a batch."""
        for rows in batch.arrays.values():
            self._add_stamps(rows[0::BATCH_STRIDE])
        self.channels.update(batch)

    def add_index(self, channel_id: int, stamps: Sequence[int]) -> None:
        """Add the messages that a message index lists of one channel."""
        if stamps:
            self._add_stamps(stamps)
            self.channels.add(channel_id)

    def _add_stamps(self, stamps: Sequence[int]) -> None:
        if stamps:
            first_ns, last_ns = min(stamps), max(stamps)
            if first_ns < self.first_ns:
                self.first_ns = first_ns
            if last_ns > self.last_ns:
                self.last_ns = last_ns
            self.messages += len(stamps)


@dataclass
class IndexFaults:
    """Faults of the index: one for each chunk, up to a limit."""

    _by_chunk: dict[int, Problem] = field(default_factory=dict)

    def note(self, start: int, message: str) -> None:
        """Note a fault; the first one of a chunk counts."""
        self._add(start, _fault(start, message))

    def _add(self, start: int, problem: Problem | None) -> None:
        if problem is not None and len(self._by_chunk) < _MAX_FAULTS:
            self._by_chunk.setdefault(start, problem)

    def compare(self, claim: ChunkClaim, listed: frozenset[int] | None, messages: ChunkMessages) -> None:
        """Compare the claim of a chunk with its messages. `listed`: its channels; None: unknown."""
        self._add(claim.start, fault_of_claim(claim, listed, messages))

    def problems(self) -> list[Problem]:
        """Return the faults as problems; similar ones are merged."""
        by_code: dict[str, list[Problem]] = defaultdict(list)
        for _, problem in sorted(self._by_chunk.items()):
            by_code[problem.code].append(problem)
        return [problem for code in sorted(by_code) for problem in merge_similar(by_code[code], "chunks")]


def fault_of_claim(claim: ChunkClaim, listed: frozenset[int] | None, messages: ChunkMessages) -> Problem | None:
    """Return what is wrong with the claim of a chunk; None: nothing."""
    if messages.messages and (
        wrong := wrong_times((claim.first_ns, claim.last_ns), (messages.first_ns, messages.last_ns))
    ):
        return _fault(claim.start, f"the index is wrong: it says that its messages {wrong}")
    if listed is not None and not messages.channels <= listed:
        missing = ", ".join(map(str, sorted(messages.channels - listed)[:5]))
        message = f"the index is wrong: it omits messages of channel {missing}"
        return _fault(claim.start, message)
    if claim.messages in (messages.messages, UNKNOWN):
        return None
    message = f"the index says that it holds {counted(claim.messages, 'message')}, it holds {messages.messages}"
    return Problem("counts-disagree", f"chunk at byte {claim.start}", message)


def _fault(start: int, message: str) -> Problem:
    return Problem("index-damaged", f"chunk at byte {start}", message)


def wrong_compression(named: str) -> str:
    """Describe an index entry with a wrong compression."""
    return f"the index is wrong: it says that the chunk is compressed by '{named}'"


def wrong_times(claimed: tuple[int, int], actual: tuple[int, int]) -> str | None:
    """Describe how claimed times, earliest and latest, differ from the actual ones; None: they are equal."""
    if claimed == actual:
        return None
    parts = [
        f"{what} {abs(claim - true) / 1e9:.9g} s {'later' if claim > true else 'earlier'}"
        for what, claim, true in zip(("begin", "end"), claimed, actual, strict=True)
        if claim != true
    ]
    return f"{' and '.join(parts)} than they do"


def compare_with_scan(
    claims: Int64Table[ChunkClaim],
    actual: Int64Table[ChunkClaim],
    sets: ChannelSets,
    faults: IndexFaults,
    *,
    is_damaged: bool,
) -> None:
    """Compare an index with the chunks of a scan; sorts both tables.

    A chunk that could not be read whole has `UNKNOWN` messages. In a damaged file, a chunk in only one of the tables is
    no fault of the index.
    """
    claims.sort()
    actual.sort()
    at, unlisted = 0, array("Q")
    for claim in claims:
        while at < len(actual) and actual[at].start < claim.start:
            unlisted.append(actual[at].start)
            at += 1
        if at == len(actual) or actual[at].start != claim.start:
            if not is_damaged:
                faults.note(claim.start, "the index is wrong: it lists a chunk that is not here")
            continue
        chunk = actual[at]
        at += 1
        if UNKNOWN not in (claim.end, chunk.end) and claim.end != chunk.end:
            faults.note(claim.start, f"the index is wrong: it says that the chunk ends at byte {claim.end}")
        if chunk.messages != UNKNOWN:
            channels = set(sets.members[chunk.channels])
            here = ChunkMessages(chunk.first_ns, chunk.last_ns, chunk.messages, channels)
            faults.compare(claim, sets.listed(claim.channels), here)
    unlisted.extend(actual[number].start for number in range(at, len(actual)))
    for start in () if is_damaged else unlisted:
        faults.note(start, "the index is wrong: it does not list this chunk")


MAX_COMPARED_LOCAL = 4096
"""Maximum number of chunks that are compared in a local file, at even distances, before an index is wrong."""

MAX_COMPARED_REMOTE = 16  # chunks that are compared over a network, if none seems to match a selection

_JOB_BYTES = 64 * 2**10
_MAX_BYTES_AHEAD = 2**20

ReadMessageIndex = Callable[[Source, Row], ChunkMessages | None]
"""Returns the messages in the message index behind a chunk; None if there is no readable index."""


@dataclass
class IndexCheck:
    """The comparison of a file's chunk index with its message indexes.

    `is_done`: all of it was compared. `is_wrong`: something in it is wrong. `span`: earliest and latest log time of
    all chunks, once all of a wrong index was compared.
    """

    source: Source
    table: ChunkTable
    problem_log: ProblemLog
    read_message_index: ReadMessageIndex
    is_done: bool = False
    is_wrong: bool = False
    span: tuple[int, int] | None = None
    _is_sampled: bool = False

    def mark_wrong(self) -> None:
        """Note that the index is wrong somewhere."""
        self.is_wrong = True

    def check_before_selection(self) -> None:
        """Compare what is cheap to compare, before chunks are selected."""
        if isinstance(self.source, FileSource) and self.source.parallel_reads == 1:
            self._compare_some(MAX_COMPARED_LOCAL)
        self.complete()

    def check_after_empty_selection(self) -> None:
        """Compare some chunks, because none seems to fit a selection."""
        self._compare_some(MAX_COMPARED_REMOTE)
        self.complete()

    def complete(self) -> None:
        """Compare all chunks, if the index is wrong and was not compared yet."""
        if self.is_wrong and not self.is_done:
            self._compare(range(len(self.table.rows)), is_all=True)

    def _compare_some(self, max_chunks: int) -> None:
        count = len(self.table.rows)
        if self.is_done or self.is_wrong or self._is_sampled or not count:
            return
        step = max(1, count // max_chunks)
        self._compare([*range(0, count, step), count - 1] if step > 1 else range(count), is_all=step == 1)
        self._is_sampled = True

    def _compare(self, numbers: Iterable[int], *, is_all: bool) -> None:
        rows, first_ns, last_ns = self.table.rows, UNKNOWN, 0
        for number, messages in self._read_message_indexes(numbers):
            row = rows[number]
            corrected = self._corrected(row, messages)
            if corrected != row:
                rows.replace(number, corrected)
                self.is_wrong = True
            is_listed = messages is not None and messages.messages
            times = (messages.first_ns, messages.last_ns) if messages and is_listed else (row.first_ns, row.last_ns)
            if row.uncompressed_bytes and times[0] <= times[1]:
                first_ns, last_ns = min(first_ns, times[0]), max(last_ns, times[1])
        if is_all:
            self.is_done = True
            self.span = (first_ns, last_ns) if self.is_wrong and first_ns <= last_ns else None

    def _read_message_indexes(self, numbers: Iterable[int]) -> Iterator[tuple[int, ChunkMessages | None]]:
        def task_of(number: int) -> ReadAheadTask[tuple[int, ChunkMessages | None]]:
            row = self.table.rows[number]
            return ReadAheadTask(_JOB_BYTES, lambda: (number, self.read_message_index(self.source, row)))

        tasks = (task_of(number) for number in numbers)
        workers: int = getattr(self.source, "parallel_reads", 1)
        if workers == 1:
            return (task.run() for task in tasks)
        return read_ahead(tasks, workers=workers, max_bytes=_MAX_BYTES_AHEAD)

    def _corrected(self, row: Row, messages: ChunkMessages | None) -> Row:
        """Return a row extended by the times and channels of its message index; report a difference."""
        if row.kind != LocationKind.chunk:
            return row
        is_contradiction = row.first_ns > row.last_ns
        if messages is None or not messages.messages:
            return row._replace(first_ns=0, last_ns=UNKNOWN, channels=ANY_CHANNEL) if is_contradiction else row
        sets = self.table.sets
        listed = sets.listed(row.channels)
        claim = ChunkClaim(row.start, UNKNOWN, row.first_ns, row.last_ns, row.channels, UNKNOWN)
        fault = fault_of_claim(claim, listed, messages)
        if fault is None:
            return row
        self.problem_log.add(fault.code, fault.where, fault.message)
        first_ns, last_ns = messages.first_ns, messages.last_ns
        if not is_contradiction:
            first_ns, last_ns = min(first_ns, row.first_ns), max(last_ns, row.last_ns)
        channels = ANY_CHANNEL if listed is None else sets.number(listed | messages.channels)
        return row._replace(first_ns=first_ns, last_ns=last_ns, channels=channels)


def contradicts_itself(table: ChunkTable, span: tuple[int | None, int | None]) -> bool:
    """Return whether the times of chunks cannot be true. `span`: of all messages, by the statistics."""
    firsts, lasts = map(table.rows.column, ("first_ns", "last_ns"))
    if any(map(gt, firsts, lasts)):
        return True
    if None in span or not firsts:
        return False
    sizes = table.rows.column("uncompressed_bytes")
    filled = [first for first, size in zip(firsts, sizes, strict=True) if size]
    return span != (min(filled, default=span[0]), max(lasts))
