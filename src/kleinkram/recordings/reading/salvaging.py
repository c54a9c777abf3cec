"""What can be saved of a chunk that the index lists and that turns out to be damaged, or not to be there: that part of
the file, or what stands between the chunks that are there, is scanned.

Reads that and the heads of the chunks, and nothing else; keeps no message.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from kleinkram.recordings.bag.records import MAGIC as BAG_MAGIC
from kleinkram.recordings.bag.scan import scan_bag_records
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.forward import SourceForward
from kleinkram.recordings.mcap.records import MAGIC as MCAP_MAGIC
from kleinkram.recordings.mcap.records import Channel as McapChannel
from kleinkram.recordings.mcap.scan import scan_records
from kleinkram.recordings.packed import PackedTable
from kleinkram.recordings.reading.chunk_table import ChunkHead, ChunkTable, Row
from kleinkram.recordings.reading.gathering import Gathering
from kleinkram.recordings.reading.model import Channel
from kleinkram.recordings.reading.noticing import Noticed
from kleinkram.recordings.sources import Source
from kleinkram.recordings.stream import ForwardStream, open_range

_HEAD_WINDOW = 4096


class Gap(NamedTuple):
    """A part of a file: [start, end)."""

    start: int
    end: int


class Part:
    """Gaps of a source, one behind the other, behind the bytes with which a file of its format begins: a `Source`."""

    path: Path | None = None

    def __init__(self, source: Source, magic: bytes, gaps: Iterable[Gap]) -> None:
        self.name = source.name
        self._source = source
        self._magic = magic
        self._starts = array("Q")
        self._ends = array("Q", [len(magic)])
        for start, end in gaps:
            start, end = max(start, len(magic)), min(end, source.size_bytes)
            if start < end:
                self._starts.append(start)
                self._ends.append(self._ends[-1] + end - start)
        self.size_bytes = self._ends[-1]

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes at a place of the part."""
        data = self._magic[offset : offset + length]
        while len(data) < length:
            at = offset + len(data)
            number = bisect_right(self._ends, at)
            size = min(length - len(data), self._ends[number] - at)
            data += self._source.read(self._starts[number - 1] + at - self._ends[number - 1], size)
        return data


@dataclass(frozen=True)
class Saved:
    """Where messages stand in a part of a file."""

    part: Part
    table: ChunkTable


class _Gathering(Gathering):
    def define(self, *_definition: object) -> None:
        """Do nothing: the index has defined all."""


Salvage = Callable[[Source, Iterable[Gap], Mapping[int, Channel]], Saved]
OpenChunk = Callable[[ForwardStream], ChunkHead]


def salvage_mcap(source: Source, gaps: Iterable[Gap], channels: Mapping[int, Channel]) -> Saved:
    """Scan parts of an MCAP, such as a chunk and its message indexes.

    Raises:
        SourceError: as `Source.read`.
    """
    part, table = Part(source, MCAP_MAGIC, gaps), ChunkTable()
    gathering = _Gathering(table, Noticed())
    known = {number: McapChannel(0, channel.topic, channel.message_encoding) for number, channel in channels.items()}
    scan_records(SourceForward(part), gathering, known)
    gathering.close()
    return Saved(part, table)


def salvage_bag(source: Source, gaps: Iterable[Gap], channels: Mapping[int, Channel]) -> Saved:
    """Scan parts of a bag, such as a chunk and its index data.

    Raises:
        SourceError: as `Source.read`.
    """
    part, table = Part(source, BAG_MAGIC, gaps), ChunkTable()
    gathering = _Gathering(table, Noticed())
    scan_bag_records(SourceForward(part), gathering)
    gathering.close()
    return Saved(part, table)


def end_of_chunk(source: Source, row: Row, open_chunk: OpenChunk) -> int | None:
    """Return where the chunk of a row ends; None if none stands there, or one that does not fit into the row.

    Raises:
        SourceError: as `Source.read`.
    """
    stream = open_range(source, row.start, row.end, window=_HEAD_WINDOW)
    try:
        head = open_chunk(stream)
    except Malformed:
        return None
    end = stream.position + head.stored_bytes
    return end if end <= row.end else None


def unlisted(source: Source, rows: PackedTable[Row], open_chunk: OpenChunk) -> PackedTable[Gap]:
    """Return the parts of a file, in their order, that belong to no chunk which its index lists where one stands.

    `rows`: in the order of their places. Reads the head of each chunk.

    Raises:
        SourceError: as `Source.read`.
    """
    gaps, at = PackedTable(Gap, len(Gap._fields)), 0
    for row in rows:
        end = end_of_chunk(source, row, open_chunk) if row.start >= at else None
        if end is not None:
            gaps.append(Gap(at, row.start))
            at = end
    gaps.append(Gap(at, source.size_bytes))
    return gaps
