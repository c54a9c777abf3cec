"""What a bag says of itself, in its header and in the chunk infos of its index, compared with what came."""

from __future__ import annotations

from dataclasses import dataclass, field

from kleinkram.recordings.bag import records
from kleinkram.recordings.bag.records import Fields
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.index_claims import UNKNOWN, ChannelSets, ChunkClaim, new_table
from kleinkram.recordings.losses import Losses
from kleinkram.recordings.model import counted
from kleinkram.recordings.packed import PackedTable


@dataclass
class Claims:
    """What was announced so far.

    Attributes:
        index_start: where the bag's header says that the index begins; 0: nowhere; None: no header.
        messages: that the chunk infos say the bag has.
        listed: what the chunk infos say of each chunk; its connections are a set of `sets`.
    """

    index_start: int | None = None
    connections: int = 0
    chunks: int = 0
    infos: int = 0
    messages: int = 0
    sets: ChannelSets = field(default_factory=ChannelSets)
    listed: PackedTable[ChunkClaim] = field(default_factory=new_table)
    _latest: int = 0

    def note_header(self, fields: Fields) -> None:
        """Note what a bag's header announces; the first one counts."""
        if self.index_start is None:
            self.index_start = fields.u64("index_pos")
            self.connections = fields.u32("conn_count")
            self.chunks = fields.u32("chunk_count")

    def note_chunk_info(self, fields: Fields, data: bytes, where: str) -> None:
        """Note what a chunk info says.

        Raises:
            Malformed: it is damaged.
        """
        info = records.read_chunk_info(fields, data, where, self.sets)
        times = info.first_ns, info.last_ns
        self.listed.append(ChunkClaim(info.position, UNKNOWN, *times, info.channels, info.messages))
        self._latest = info.messages
        self.infos += 1
        self.messages += self._latest

    def forget_chunk_info(self) -> None:
        """Take back the latest one: bytes of it are missing."""
        self.listed.pop()
        self.infos -= 1
        self.messages -= self._latest

    def settle(self, losses: Losses, *, connections: int, chunks: int, size_bytes: int) -> int | None:
        """Compare with the connections and the readable chunks that came; note what is missing as lost.

        Returns:
            Messages that the chunk infos say the bag has; None: not all chunk infos were found.
        """
        if not self.index_start:
            losses.messages_are_known = False
            return None
        if self.infos < self.chunks or connections < self.connections:
            message = "the file is cut within its index"
            if self.index_start >= size_bytes:
                message = f"the file is cut: its index should begin at byte {self.index_start}, where it has ended"
            losses.note(Malformed(f"byte {size_bytes}", message))
            losses.messages_are_known = False
        elif self.infos > chunks + losses.chunks:
            missing = self.infos - chunks - losses.chunks
            losses.note(Malformed("index", f"it lists {counted(missing, 'chunk')} more than the file holds"))
            losses.chunks += missing
        return self.messages if self.infos and self.infos >= self.chunks else None
