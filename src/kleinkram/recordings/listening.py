"""What a scan tells, while it runs, to whoever wants to find the messages again that it counts. Keeps nothing."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from kleinkram.recordings.tally import Batch

CHUNK, RECORDS, CUT = range(3)
"""What a place is: a chunk; records that stand in no chunk; a chunk to be read as far as it goes, whose checksum is
missing or is known only behind its messages."""

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
