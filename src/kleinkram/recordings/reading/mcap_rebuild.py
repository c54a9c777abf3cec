"""The index of an MCAP that has none, or none to be believed: built by reading the file once from end to end.

Checks the CRC of every chunk and leaves out those that fail; keeps no message. Of a chunk at which the file ends, what
can be decompressed counts.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

from kleinkram.recordings.decompress import open_decompressed
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.forward import SourceForward
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.mcap import records
from kleinkram.recordings.reading.chunk_table import CHUNK, CUT, ChunkHead, Row
from kleinkram.recordings.reading.mcap_chunks import MESSAGE_HEAD, RunBuilder, read_chunk_head, walk
from kleinkram.recordings.reading.mcap_index import McapIndex
from kleinkram.recordings.reading.noticing import Noticed
from kleinkram.recordings.reading.unpacking import limited
from kleinkram.recordings.sources import Source
from kleinkram.recordings.stream import Cut, ForwardStream


@dataclass
class _Tally:
    """The messages of one chunk."""

    counts: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    first_ns: int = 2**64 - 1
    last_ns: int = 0

    def add(self, channel_id: int, log_ns: int) -> None:
        self.counts[channel_id] += 1
        self.first_ns, self.last_ns = min(self.first_ns, log_ns), max(self.last_ns, log_ns)


def rebuild_index(source: Source, noticed: Noticed) -> McapIndex:
    """Return the index of what can be read of an MCAP; what cannot is noted.

    Raises:
        SourceError: as `Source.read`.
    """
    return _Rebuilding(source, noticed).run()


class _Rebuilding:
    def __init__(self, source: Source, noticed: Noticed) -> None:
        self._size = source.size_bytes
        self._noticed = noticed
        self._index = McapIndex()
        self._total = _Tally()
        self._loose = RunBuilder(self._index.table)
        forward = SourceForward(source)
        self._stream = ForwardStream(lambda: forward.read(WINDOW))

    def run(self) -> McapIndex:
        try:
            self._stream.skip(len(records.MAGIC))
            self._read_records()
        except Malformed as error:
            self._noticed.add("damaged", error.where, f"reading ends here: {error.message}")
        self._loose.close()
        index, total = self._index, self._total
        index.counts = dict(total.counts)
        index.message_count = sum(total.counts.values())
        if index.message_count:
            index.start_ns, index.end_ns = total.first_ns, total.last_ns
        return index

    def _read_records(self) -> None:
        stream = self._stream
        for record in walk(stream):
            end = record.start + records.RECORD_HEAD.size + record.length
            if record.opcode == records.FOOTER:
                return
            if record.opcode == records.CHUNK:
                self._loose.close()
                self._read_chunk(record.start, record.length)
            elif record.opcode == records.MESSAGE:
                channel_id, _, log_ns, _ = MESSAGE_HEAD.unpack(record.head)
                stream.skip(end - stream.position)
                self._loose.add(record.start, end, channel_id, log_ns)
                self._total.add(channel_id, log_ns)
            elif record.opcode in (records.SCHEMA, records.CHANNEL):
                self._define(record.opcode, record.head, record.start)
            else:
                self._loose.close()
        raise Cut(f"byte {self._size}", "the file ends without a footer, so it was cut or never closed")

    def _read_chunk(self, start: int, length: int) -> None:
        stream, tally = self._stream, _Tally()
        end = stream.position + length
        kind, uncompressed = CHUNK, 0
        try:
            head = read_chunk_head(stream, length)
            uncompressed = head.uncompressed_bytes
            inner = open_decompressed(head.compression, limited(stream, head.stored_bytes), uncompressed)
            inner.start_crc()
            self._read_content(inner, tally)
            _check_end(inner, head, start)
        except Malformed as error:
            if end <= self._size:
                self._noticed.add("damaged", f"chunk at byte {start}", f"left out: {error.message}")
                return
            kind, length = CUT, self._size - start
        self._add_row(start, end, kind, tally, uncompressed)

    def _add_row(self, start: int, end: int, kind: int, tally: _Tally, uncompressed: int) -> None:
        if not tally.counts:
            return
        end = min(end, self._size)
        members = self._index.table.set_number(tally.counts)
        row = Row(start, end - start, end, tally.first_ns, tally.last_ns, kind, members, uncompressed)
        self._index.table.rows.append(row)
        total = self._total
        for channel_id, count in tally.counts.items():
            total.counts[channel_id] += count
        total.first_ns, total.last_ns = min(total.first_ns, tally.first_ns), max(total.last_ns, tally.last_ns)

    def _read_content(self, inner: ForwardStream, tally: _Tally) -> None:
        for record in walk(inner):
            if record.opcode == records.MESSAGE:
                channel_id, _, log_ns, _ = MESSAGE_HEAD.unpack(record.head)
                inner.skip(record.length - MESSAGE_HEAD.size)
                tally.add(channel_id, log_ns)
            elif record.opcode in (records.SCHEMA, records.CHANNEL):
                self._define(record.opcode, record.head, record.start)

    def _define(self, opcode: int, body: bytes, start: int) -> None:
        definitions = self._index.definitions
        define = definitions.read_schema if opcode == records.SCHEMA else definitions.read_channel
        define(body, f"byte {start}")


def _check_end(content: ForwardStream, head: ChunkHead, start: int) -> None:
    if content.position != head.uncompressed_bytes:
        claimed = head.uncompressed_bytes
        raise Malformed(f"byte {start}", f"{claimed} bytes are claimed, {content.position} came out")
    if head.crc and content.crc != head.crc:
        raise Malformed(f"byte {start}", "its checksum is wrong")
