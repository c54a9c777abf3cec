"""Merges the messages of several chunks, databases and files by log time, in bounded memory.

The inputs are pieces (chunks, databases), each with the earliest time that it may contain. A piece is opened when the
merge reaches that time. Pieces that overlap in time are buffered; beyond `MAX_BUFFERED_BYTES`, only a share of each is,
and a piece is read again for its next share. Equal times keep the order of the files.

If a piece contains earlier messages than it claims, those that come too late are left out.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from operator import attrgetter
from typing import NamedTuple

from kleinkram.recordings.errors import TooDisordered
from kleinkram.recordings.messages import END_OF_TIME_NS, Block

MAX_BUFFERED_BYTES = 48 * 2**20  # bytes of messages that may wait for their time before pieces are held in shares
OVERHEAD_BYTES = 250  # what a message costs beside its data

_log_time = attrgetter("log_time_ns")
_data = attrgetter("data")


class MessageRun:
    """Messages of one piece by time; `more` yields later ones. `buffered_bytes`: about their memory."""

    def __init__(self, messages: Block, buffered_bytes: int, more: Iterator[Block] | None = None) -> None:
        self._messages = messages
        self._more = more
        self.buffered_bytes = buffered_bytes

    @property
    def ready_ns(self) -> int:
        """All messages before this time are in memory."""
        if self._more is None:
            return END_OF_TIME_NS
        return self._messages[-1].log_time_ns if self._messages else 0

    @property
    def is_complete(self) -> bool:
        """Return whether all remaining messages are in memory."""
        return self._more is None

    @property
    def ended(self) -> bool:
        """Return whether no message remains."""
        return self._more is None and not self._messages

    def refill(self) -> None:
        """Read more messages."""
        block = None if self._more is None else next(self._more, None)
        if block is None:
            self._more = None
        else:
            self._messages = self._messages + block
            self.buffered_bytes += sum(map(len, map(_data, block))) + OVERHEAD_BYTES * len(block)

    def take(self, before_ns: int) -> Block:
        """Return and drop the messages before a time."""
        messages = self._messages
        if not messages or messages[0].log_time_ns >= before_ns:
            return []
        if messages[-1].log_time_ns < before_ns:
            self._messages, self.buffered_bytes = [], 0
            return messages
        cut = bisect_left(messages, before_ns, key=_log_time)
        self._messages = messages[cut:]
        self.buffered_bytes = self.buffered_bytes * len(self._messages) // len(messages)
        return messages[:cut]

    def keep_share(self, share_bytes: int, read_again: Callable[[], Block]) -> None:
        """Keep only a share in memory; read the rest again later."""
        left = len(self._messages)
        self._messages, self.buffered_bytes = [], 0
        self._more = _shares(left, share_bytes, read_again)
        self.refill()


class MessagePiece(NamedTuple):
    """A source of messages from `first_ns` on; `order` of the files decides between equal times.

    `read_again` reads the same messages once more; None for a piece that never holds much at a time.
    """

    first_ns: int
    order: tuple[int, ...]
    open: Callable[[], MessageRun]
    read_again: Callable[[], Block] | None = None


def merge(pieces: Iterable[MessagePiece], on_late_messages: Callable[[int], None] | None = None) -> Iterator[Block]:
    """Yield the messages of pieces, sorted by `first_ns`, as blocks that follow each other in time.

    Messages that are earlier than the `first_ns` of their piece and come too late are left out: `on_late_messages`
    receives their number so far. `TooDisordered` if more pieces overlap than even shares of them can be held.
    """
    merging = _Merging(on_late_messages)
    waiting = iter(pieces)
    upcoming = next(waiting, None)
    while upcoming is not None:
        current, upcoming = upcoming, next(waiting, None)
        merging.add(current)
        yield from merging.blocks(END_OF_TIME_NS if upcoming is None else upcoming.first_ns)


class _Merging:
    def __init__(self, on_late_messages: Callable[[int], None] | None) -> None:
        self._on_late_messages = on_late_messages
        self._late_count = 0
        self._runs: list[tuple[MessagePiece, MessageRun]] = []
        self._latest_ns = 0

    def add(self, piece: MessagePiece) -> None:
        run = piece.open()
        self._drop_late_messages(run)
        self._runs.append((piece, run))
        if len(self._runs) > 1:
            self._runs.sort(key=lambda pair: pair[0].order)
            self._limit_memory()

    def blocks(self, before_ns: int) -> Iterator[Block]:
        while True:
            alone = len(self._runs) == 1
            cut = before_ns if alone else min([before_ns, *(run.ready_ns for _, run in self._runs)])
            parts = [part for _, run in self._runs if (part := run.take(cut))]
            if parts:
                self._latest_ns = max(part[-1].log_time_ns for part in parts)
            if len(parts) == 1:
                yield parts[0]
            elif parts:
                yield sorted((message for part in parts for message in part), key=_log_time)
            del parts
            self._runs = [pair for pair in self._runs if not pair[1].ended]
            waiting = [run for _, run in self._runs if run.ready_ns < before_ns]
            if not waiting:
                return
            for run in waiting:
                if alone or run.ready_ns <= cut:
                    run.refill()
                    self._drop_late_messages(run)
            self._check_size()

    def _drop_late_messages(self, run: MessageRun) -> None:
        late = run.take(self._latest_ns)
        if late:
            self._late_count += len(late)
            if self._on_late_messages is not None:
                self._on_late_messages(self._late_count)

    def _limit_memory(self) -> None:
        if sum(run.buffered_bytes for _, run in self._runs) <= MAX_BUFFERED_BYTES:
            return
        share = MAX_BUFFERED_BYTES // (2 * len(self._runs))
        for piece, run in self._runs:
            if piece.read_again is not None and run.is_complete and run.buffered_bytes > share:
                run.keep_share(share, piece.read_again)
        self._check_size()

    def _check_size(self) -> None:
        if len(self._runs) > 1 and sum(run.buffered_bytes for _, run in self._runs) > 2 * MAX_BUFFERED_BYTES:
            raise TooDisordered(
                f"{len(self._runs)} parts of the recording overlap in time, more than can be put in order; "
                "read one topic, or a shorter time, at once"
            )


def _shares(left: int, share_bytes: int, read_again: Callable[[], Block]) -> Iterator[Block]:
    """Yield the last `left` messages of a piece in blocks of a share, reading it again for each."""
    while left:
        messages = read_again()
        start = max(0, len(messages) - left)
        stop, size = start, 0
        while stop < len(messages) and (stop == start or size < share_bytes):
            size += len(messages[stop].data) + OVERHEAD_BYTES
            stop += 1
        block = messages[start:stop]
        left = len(messages) - stop
        del messages
        yield block
