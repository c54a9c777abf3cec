"""Reading an MCAP from its first byte to its last, for files whose index is missing or cannot be believed.

Decompresses in small steps, so memory does not follow what chunks claim; checks the CRC of every chunk, attachment
and of the data section; keeps no message. A damaged chunk is left out and reading goes on behind it; where the records
themselves break off, reading ends.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field

from kleinkram.recordings.decompress import open_decompressed
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_NAME
from kleinkram.recordings.mcap import records
from kleinkram.recordings.mcap.records import McapFacts
from kleinkram.recordings.sources import Source
from kleinkram.recordings.stream import Cut, ForwardStream, open_range
from kleinkram.recordings.timeline import Timeline

_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_U64 = struct.Struct("<Q")
_U32 = struct.Struct("<I")
_HEAD_OF_DEFINITION = 3 * 4096 + 16
_FLUSH_AT = 1_000_000
_MOST_DAMAGE = 10_000
_NAMES = {records.MESSAGE: "a message", records.CHUNK: "a chunk", records.ATTACHMENT: "an attachment"}


@dataclass
class Scan:
    """What a scan found.

    Attributes:
        damage: what is wrong, in the order of the file; empty for a whole file.
        ended: the place and reason where reading could not go on; None if the data section was read to its end.
    """

    facts: McapFacts = field(default_factory=McapFacts)
    damage: list[Malformed] = field(default_factory=list)
    ended: Malformed | None = None


class _Batch:
    """Messages of some records, not yet in the timeline: a chunk's only count once its CRC is right."""

    def __init__(self) -> None:
        self.stamps: dict[int, array[int]] = {}
        self.sizes: dict[int, int] = {}
        self.count = 0

    def add(self, channel_id: int, log_time: int, size: int) -> None:
        stamps = self.stamps.get(channel_id)
        if stamps is None:
            stamps = self.stamps[channel_id] = array("Q")
            self.sizes[channel_id] = 0
        stamps.append(log_time)
        self.sizes[channel_id] += size
        self.count += 1


class _Scanner:
    def __init__(self, source: Source, timeline: Timeline) -> None:
        self.scan = Scan()
        self._source = source
        self._timeline = timeline
        self._loose = _Batch()
        self._data_ended = False

    def run(self) -> Scan:
        stream = open_range(self._source, 0, self._source.size_bytes)
        stream.start_crc()
        try:
            stream.skip(len(records.MAGIC))
            while self._read_record(stream):
                pass
        except Malformed as error:
            self.scan.ended = error
        self._flush(self._loose, 1, 1)
        self._timeline.settle(None)
        return self.scan

    def _read_record(self, stream: ForwardStream) -> bool:
        """Read one record at the top level; False at the footer."""
        start, crc = stream.position, stream.crc
        if stream.at_end():
            raise Cut(f"byte {start}", "the file ends without a footer")
        opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
        left = self._source.size_bytes - stream.position
        if length > left:
            name = _NAMES.get(opcode, "a record")
            raise Cut(f"byte {start}", f"{name} of {length} bytes begins, but only {left} bytes follow")
        if opcode == records.FOOTER:
            return False
        if opcode == records.DATA_END:
            self._check_data_end(stream, length, crc, start)
            self._data_ended = True
        elif opcode == records.CHUNK:
            self._read_chunk(stream, start, length)
        elif opcode == records.ATTACHMENT:
            self._read_attachment(stream, start, length)
        else:
            self._read_common(stream, opcode, length, self._loose)
        if self._loose.count >= _FLUSH_AT:
            self._flush(self._loose, 1, 1)
            self._loose = _Batch()
        return True

    def _read_common(self, stream: ForwardStream, opcode: int, length: int, batch: _Batch) -> None:
        """Read a record that may stand in a chunk or outside of one."""
        facts, where, end = (
            self.scan.facts,
            f"byte {stream.position - records.RECORD_HEAD.size}",
            stream.position + length,
        )
        if opcode == 0:
            raise Malformed(where, "only zeros or rubbish where a record should begin")
        if opcode == records.MESSAGE:
            channel_id, _sequence, log_time, _publish_time = _unpack(_MESSAGE_HEAD, stream, length)
            if channel_id not in facts.channels:
                raise Malformed(where, f"a message on channel {channel_id}, which the file does not define")
            batch.add(channel_id, log_time, records.RECORD_HEAD.size + length)
        elif opcode == records.SCHEMA:
            records.read_schema(facts, stream.take(min(length, _HEAD_OF_DEFINITION)), where)
        elif opcode == records.CHANNEL:
            records.read_channel(facts, stream.take(min(length, _HEAD_OF_DEFINITION)), where)
        elif opcode == records.HEADER:
            records.read_header(facts, stream.take(min(length, _HEAD_OF_DEFINITION)), where)
        elif opcode == records.STATISTICS:
            records.read_statistics(facts, stream.take(length), where)
        elif opcode == records.METADATA:
            facts.metadata_records += 1
        stream.skip(end - stream.position)

    def _read_chunk(self, stream: ForwardStream, start: int, length: int) -> None:
        end = stream.position + length
        try:
            self._read_chunk_body(stream, start, length)
        except Malformed as error:
            self._note(Malformed(f"chunk at byte {start}", error.message, certain=error.certain))
        stream.skip(end - stream.position)

    def _read_chunk_body(self, stream: ForwardStream, start: int, length: int) -> None:
        end = stream.position + length
        _first, _last, uncompressed, crc, name_length = _unpack(_CHUNK_HEAD, stream, length)
        name = stream.take(min(name_length, MAX_NAME)).decode("utf-8", "replace")
        (stored,) = _unpack(_U64, stream, length)
        if stored != end - stream.position:
            raise Malformed(f"byte {start}", f"{stored} bytes are claimed, {end - stream.position} are there")
        self.scan.facts.compression.add(name or "none")
        inner = open_decompressed(name, _limited(stream, stored), uncompressed)
        inner.start_crc()
        batch = _Batch()
        while not inner.at_end():
            opcode, inner_length = records.RECORD_HEAD.unpack(inner.take(records.RECORD_HEAD.size))
            self._read_common(inner, opcode, inner_length, batch)
            if batch.count >= _FLUSH_AT:
                self._flush(batch, stored, uncompressed)
                batch = _Batch()
        if inner.position != uncompressed:
            raise Malformed(f"byte {start}", f"{uncompressed} bytes are claimed, {inner.position} came out")
        if crc and inner.crc != crc:
            raise Malformed(f"byte {start}", "its checksum is wrong")
        self._flush(batch, stored, uncompressed)

    def _read_attachment(self, stream: ForwardStream, start: int, length: int) -> None:
        self.scan.facts.attachments += 1
        if length < _U32.size:
            raise Malformed(f"byte {start}", "an attachment too short to be one")
        stream.start_crc()
        stream.skip(length - _U32.size)
        crc = stream.stop_crc()
        (claimed,) = _unpack(_U32, stream, _U32.size)
        if claimed and claimed != crc:
            self._note(Malformed(f"attachment at byte {start}", "its checksum is wrong"))

    def _check_data_end(self, stream: ForwardStream, length: int, crc: int, start: int) -> None:
        (claimed,) = _unpack(_U32, stream, length)
        stream.skip(length - _U32.size)
        if claimed and claimed != crc and not self._data_ended:
            self._note(Malformed(f"data section (bytes 0 to {start})", "its checksum is wrong"))

    def _note(self, fault: Malformed) -> None:
        if len(self.scan.damage) < _MOST_DAMAGE:
            self.scan.damage.append(fault)

    def _flush(self, batch: _Batch, stored: int, uncompressed: int) -> None:
        for channel_id, stamps in batch.stamps.items():
            share = batch.sizes[channel_id] * stored // uncompressed if uncompressed else 0
            self._timeline.add(self.scan.facts.channels[channel_id].topic, stamps, share)
        self._timeline.settle(0)


def scan_mcap(source: Source, timeline: Timeline) -> Scan:
    """Read the whole file into the timeline. The content of the file never raises.

    Raises:
        SourceError: as `Source.read`.
    """
    return _Scanner(source, timeline).run()


def _unpack(layout: struct.Struct, stream: ForwardStream, length: int) -> tuple[int, ...]:
    """Read fixed fields of a record that claims `length` bytes."""
    if length < layout.size:
        raise Malformed(f"byte {stream.position}", f"a record of {length} bytes, too short for its type")
    return layout.unpack(stream.take(layout.size))


def _limited(stream: ForwardStream, length: int) -> Callable[[int], bytes]:
    """Read up to n of the next `length` bytes of a stream; empty behind them."""
    left = length

    def read(most: int) -> bytes:
        nonlocal left
        data = stream.take(min(most, left))
        left -= len(data)
        return data

    return read
