"""What can be saved of a chunk that the index lists and that turns out to be damaged: that part is scanned.

Reads the chunk and what belongs to it, and nothing else; keeps no message.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from kleinkram.recordings.bag.records import MAGIC as BAG_MAGIC
from kleinkram.recordings.bag.scan import scan_bag_records
from kleinkram.recordings.forward import SourceForward
from kleinkram.recordings.mcap.records import MAGIC as MCAP_MAGIC
from kleinkram.recordings.mcap.records import Channel as McapChannel
from kleinkram.recordings.mcap.scan import scan_records
from kleinkram.recordings.reading.chunk_table import ChunkTable, Row
from kleinkram.recordings.reading.gathering import Gathering
from kleinkram.recordings.reading.model import Channel
from kleinkram.recordings.reading.noticing import Noticed
from kleinkram.recordings.sources import Source


class Part:
    """The bytes [start, end) of a source, behind the bytes with which a file of its format begins: a `Source`."""

    path: Path | None = None

    def __init__(self, source: Source, magic: bytes, start: int, end: int) -> None:
        self.name = source.name
        self._source = source
        self._magic = magic
        self._start = start - len(magic)
        self.size_bytes = len(magic) + min(end, source.size_bytes) - start

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes at a place of the part."""
        head = self._magic[offset : offset + length]
        if len(head) == length:
            return head
        return head + self._source.read(self._start + offset + len(head), length - len(head))


@dataclass(frozen=True)
class Saved:
    """Where messages stand in a part of a file."""

    part: Part
    table: ChunkTable


class _Gathering(Gathering):
    def define(self, *_definition: object) -> None:
        """Do nothing: the index has defined all."""


Salvage = Callable[[Source, Row, Mapping[int, Channel]], Saved]


def salvage_mcap(source: Source, row: Row, channels: Mapping[int, Channel]) -> Saved:
    """Scan a chunk and its message indexes.

    Raises:
        SourceError: as `Source.read`.
    """
    part, table = Part(source, MCAP_MAGIC, row.start, row.end), ChunkTable()
    gathering = _Gathering(table, Noticed())
    known = {number: McapChannel(0, channel.topic, channel.message_encoding) for number, channel in channels.items()}
    gathering.finish(scan_records(SourceForward(part), gathering, known).losses)
    return Saved(part, table)


def salvage_bag(source: Source, row: Row, channels: Mapping[int, Channel]) -> Saved:
    """Scan a chunk and its index data.

    Raises:
        SourceError: as `Source.read`.
    """
    part, table = Part(source, BAG_MAGIC, row.start, row.end), ChunkTable()
    gathering = _Gathering(table, Noticed())
    gathering.finish(scan_bag_records(SourceForward(part), gathering).losses)
    return Saved(part, table)
