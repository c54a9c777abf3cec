"""A chunk that is too large to be held: its content passes in small steps, once, and is kept nowhere.

Whether the chunk can be believed is known only at its end. So what is found in it goes into copies of what is known,
which are kept or thrown away then: a large chunk comes out as a small one would.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from kleinkram.recordings.compression import ReadUpTo, open_decompressed
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.streams import Decompressed, Lookahead, Undecompressed

_FLUSH_BYTES = 64 * 2**20


def pieces_of(stored: memoryview) -> ReadUpTo:
    """Return what gives stored data that are at hand, a piece at a time."""
    at = 0

    def take(most: int) -> bytes:
        nonlocal at
        piece = bytes(stored[at : at + most])
        at += len(piece)
        return piece

    return take


class LargeChunk:
    """The content of a chunk whose stored data are what `take` gives next.

    Attributes:
        inner: the content.
        walked: bytes of it in records that were followed.

    Raises:
        Malformed: it is compressed in a way that we do not read.
    """

    def __init__(
        self, take: ReadUpTo, compression: str, *, stored: int, uncompressed: int, with_crc: bool = True
    ) -> None:
        left = stored

        def read(most: int) -> bytes:
            nonlocal left
            piece = take(min(most, left))
            left -= len(piece)
            return piece

        self._content = Decompressed(open_decompressed(compression, read, uncompressed), uncompressed)
        self.inner = Lookahead(self._content, with_crc=with_crc)
        self.walked = 0

    def read(self, step: Callable[[], None], flush: Callable[[], None]) -> Malformed | None:
        """Follow the records; return why that ended before the content did.

        Args:
            step: passes over some records, of which a window is at hand.
            flush: is called now and then, and at the end.

        Raises:
            Undecompressed: the data are damaged, or end with the file.
        """
        flushed, damage = 0, None
        try:
            while self.inner.left:
                try:
                    self.inner.ahead(WINDOW)
                except Undecompressed as error:
                    damage = error  # what came out before it is read all the same
                step()
                self.walked = self.inner.position
                if self.walked - flushed > _FLUSH_BYTES:
                    flushed = self.walked
                    flush()
        except Malformed as fault:
            if damage is not None or isinstance(fault, Undecompressed):
                raise damage or fault from None
            return fault
        finally:
            flush()
        return None

    def finish(self) -> int:
        """Pass over the rest; return the CRC-32 of all, if one is kept.

        Raises:
            Undecompressed: the data are damaged, or do not end where the content does.
        """
        self.inner.advance(self.inner.left)
        self._content.finish()
        return self.inner.crc()


class LargeReading(Protocol):
    """Reads the records of one large chunk in its format, into copies of what is known."""

    chunk: LargeChunk

    def read(self) -> Malformed | None:
        """Follow the records; return why that ended."""

    def prove(self) -> None:
        """Pass over the rest.

        Raises:
            Malformed: nothing of the chunk can be believed.
        """

    def keep(self) -> None:
        """Believe what was found."""

    def forget(self) -> None:
        """Believe nothing."""


def read_whole(reading: LargeReading) -> Malformed | None:
    """Read a chunk and believe it; return why not all of it could be followed.

    Raises:
        Malformed: nothing of it can be believed.
    """
    try:
        fault = reading.read()
        reading.prove()
    except Malformed:
        reading.forget()
        raise
    reading.keep()
    return fault


def read_cut(reading: LargeReading, stored: int) -> int:
    """Read and believe what there is of a chunk whose end is missing; return how many of its `stored` bytes it is."""
    with suppress(Malformed):
        reading.read()
    reading.keep()
    seen = reading.chunk.inner.seen
    return stored * reading.chunk.walked // seen if seen else 0
