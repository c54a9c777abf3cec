"""What a scan tells, while it runs, to whoever wants to find the messages again that it counts. Keeps nothing."""

from __future__ import annotations

from typing import Generic, NamedTuple, Protocol, TypeVar

from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_AT_ONCE
from kleinkram.recordings.tally import Batch

CHUNK, RECORDS, CUT = range(3)
"""What a place is: a chunk; records that stand in no chunk; a chunk to be read as far as it goes, whose checksum is
missing or is known only behind its messages."""

Head = TypeVar("Head", contravariant=True)
Stretches = tuple[tuple[int, int], ...]


class Place(NamedTuple):
    """Bytes of a file that hold messages: [start, start + length).

    Attributes:
        kind: `CHUNK`, `RECORDS` or `CUT`.
        uncompressed: bytes of the content.
        stretches: the parts [start, end) of the content that can be followed; None: all of it.
    """

    kind: int
    start: int
    length: int
    uncompressed: int
    stretches: Stretches | None = None


class Listener(Protocol):
    """Is told of messages in the order in which the scan finds them."""

    def hear(self, place: Place, batch: Batch) -> None:
        """Take note of messages at a place, which may come in several calls."""

    def forget(self, place: Place) -> None:
        """Take back the messages at a place, if they were the last that were told of: nothing there can be believed."""


class Definer(Listener, Protocol[Head]):
    """Is told of definitions, too; `Head`: what stands before the data of one."""

    def define(self, head: Head, data: bytes, where: str, /) -> None:
        """Take note of a definition."""


class Held(Generic[Head]):
    """Tells a listener of messages at once, and keeps definitions back until the chunk that they stand in is proven.

    Keeps at most `MAX_AT_ONCE` bytes of them.
    """

    def __init__(self, listener: Definer[Head]) -> None:
        self._listener = listener
        self._definitions: list[tuple[Head, bytes, str]] = []
        self._bytes = 0

    def hear(self, place: Place, batch: Batch) -> None:
        """Pass it on."""
        self._listener.hear(place, batch)

    def forget(self, place: Place) -> None:
        """Pass it on."""
        self._listener.forget(place)

    def define(self, head: Head, data: bytes, where: str, /) -> None:
        """Keep it back.

        Raises:
            Malformed: there are too many.
        """
        self._bytes += len(data)
        if self._bytes > MAX_AT_ONCE:
            raise Malformed(where, f"more than {MAX_AT_ONCE} bytes of definitions in a chunk", certain=False)
        self._definitions.append((head, data, where))

    def release(self) -> None:
        """Tell of what was kept back."""
        for definition in self._definitions:
            self._listener.define(*definition)
