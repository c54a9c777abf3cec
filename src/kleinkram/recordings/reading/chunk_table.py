"""What is kept of every chunk of a file while it is read: where it stands, its span of time, and who is in it.

64 bytes a chunk, whatever the file says; sets of channels that many chunks share are kept once.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from kleinkram.recordings.index_claims import ANY_CHANNEL, ChannelSets
from kleinkram.recordings.listening import Stretches
from kleinkram.recordings.packed import PackedTable
from kleinkram.recordings.reading.model import Selection


class ChunkHead(NamedTuple):
    """What a chunk says of itself; its stored bytes follow. `crc`: of the uncompressed bytes; 0: it has none."""

    compression: str
    uncompressed_bytes: int
    crc: int
    stored_bytes: int


class Row(NamedTuple):
    """A piece of a file: [start, start + length). Times are inclusive; `uncompressed_bytes` may be a guess.

    `end`: behind what belongs to it, such as its message indexes. `kind`: as in `listening.Place`.
    """

    start: int
    length: int
    end: int
    first_ns: int
    last_ns: int
    kind: int
    channels: int
    uncompressed_bytes: int


@dataclass
class ChunkTable:
    """The chunks of one file, in the order of the file.

    Attributes:
        stretches: of the content of damaged chunks, by their start: what can be followed; see `listening.Place`.
    """

    rows: PackedTable[Row] = field(default_factory=lambda: PackedTable(Row, len(Row._fields)))
    stretches: dict[int, Stretches] = field(default_factory=dict)
    sets: ChannelSets = field(default_factory=ChannelSets)

    def known_channels(self) -> frozenset[int]:
        """Return all channels that some chunk is known to hold."""
        return frozenset().union(*self.sets.members)

    def select(self, selection: Selection, wanted: frozenset[int]) -> array[int]:
        """Return the numbers of the rows that may hold what is wanted, by their first time, then by place."""
        hits = [number == ANY_CHANNEL or bool(members & wanted) for number, members in enumerate(self.sets.members)]
        columns = (self.rows.column(Row._fields.index(name)) for name in ("first_ns", "last_ns", "channels"))
        start_ns, end_ns = selection.start_ns, selection.end_ns
        firsts, lasts, sets = columns
        found = array(
            "Q",
            (
                number
                for number, (first_ns, last_ns, members) in enumerate(zip(firsts, lasts, sets, strict=True))
                if first_ns < end_ns and last_ns >= start_ns and hits[members]
            ),
        )
        if any(firsts[after] < firsts[before] for before, after in pairwise(found)):
            found = array("Q", sorted(found, key=firsts.__getitem__))
        return found
