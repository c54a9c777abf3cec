"""Scans a ROS 1 bag from the first byte to the last, with or without its index.

The chunk infos at the end of the file and the index data behind each chunk list how many messages there should be.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

from kleinkram.recordings.chunk_scanner import LOOK, ChunkContents, ChunkScan, ChunkScanner, search_width
from kleinkram.recordings.chunk_table import UNKNOWN, ChunkHead, ChunkTableBuilder, Int64Table
from kleinkram.recordings.errors import Cut, Malformed
from kleinkram.recordings.formats.rosbag1 import chunks, records
from kleinkram.recordings.formats.rosbag1.chunks import BagFacts, BagRecord, find_record, opcode_at, parse_record
from kleinkram.recordings.formats.rosbag1.records import Op
from kleinkram.recordings.index_check import ChunkClaim, compare_with_scan
from kleinkram.recordings.limits import LOOK_AHEAD, MAX_CHUNK_INDEX, MAX_HEADER, MAX_TAKE
from kleinkram.recordings.model import counted
from kleinkram.recordings.scanned_messages import Batch, LocationKind, MessageCounter, MessageLocation
from kleinkram.recordings.sources import SequentialReader
from kleinkram.recordings.streams import LookaheadStream

_MIN_CHUNK_HEAD = 40
_NAMES: dict[int, str] = {Op.MESSAGE_DATA: "a message", Op.CHUNK: "a chunk", Op.CONNECTION: "a connection"}


@dataclass
class BagScan(ChunkScan[BagFacts]):
    """The result of a scan.

    Attributes:
        index_start: by the bag's header; 0: it was never closed; None: no header.
        listed: messages of the bag by its chunk infos; None: not all chunk infos were found.
        refused: why nothing of the bag can be read though it may be whole.
    """

    facts: BagFacts = field(default_factory=BagFacts)
    counter: MessageCounter = field(default_factory=lambda: MessageCounter(with_publish_times=False))
    index_start: int | None = None
    listed: int | None = None
    refused: Malformed | None = None


class _BagScanner(ChunkScanner[BagFacts]):
    _scan: BagScan

    def __init__(self, reader: SequentialReader, builder: ChunkTableBuilder | None) -> None:
        super().__init__(BagScan(), LookaheadStream(reader, with_crc=False), builder)
        self._claims = Int64Table(ChunkClaim)
        self._claimed_messages = self._claimed_connections = self._claimed_chunks = 0

    def run(self) -> BagScan:
        scan, stream, facts, losses = self._scan, self._stream, self._scan.facts, self._scan.losses
        stream.advance(len(records.MAGIC))
        while stream.left and scan.refused is None:
            self._step()
        self._end_chunk()
        scan.counter.learn(facts.channels)
        self._drop_undefined("connections", "of connections that are not defined")
        if scan.refused is None:
            self._compare_counts()
        if len(self._claims) and len(self._claims) >= self._claimed_chunks:
            is_damaged = bool(losses.damage)
            sets = facts.table.sets
            compare_with_scan(self._claims, self._actual_chunks, sets, facts.index_faults, is_damaged=is_damaged)
        losses.messages_are_known &= scan.refused is None
        return scan

    def _compare_counts(self) -> None:
        """Compare bag header and chunk infos with what was read, and report what is missing."""
        scan, losses, infos, size_bytes = self._scan, self._scan.losses, len(self._claims), self._stream.size_bytes
        if not scan.index_start:
            losses.messages_are_known = False
            return
        if infos < self._claimed_chunks or len(scan.facts.channels) < self._claimed_connections:
            message = "the file is cut within its index"
            if scan.index_start >= size_bytes:
                message = f"the file is cut: its index should begin at byte {scan.index_start}, where it has ended"
            losses.note(Malformed(f"byte {size_bytes}", message))
            losses.messages_are_known = False
        elif (missing := infos - scan.chunks - losses.chunks) > 0:
            losses.note(Malformed("index", f"it lists {counted(missing, 'chunk')} more than the file holds"))
            losses.chunks += missing
        scan.listed = self._claimed_messages if infos and infos >= self._claimed_chunks else None

    def _step(self) -> None:
        """Read one top-level record, or skip damage."""
        stream = self._stream
        stream.ahead(LOOK)
        where = f"byte {stream.position}"
        try:
            header_bytes = int.from_bytes(stream.window[stream.at : stream.at + 4], "little")
            if header_bytes <= MAX_HEADER:
                stream.ahead(header_bytes + 8)
            record = parse_record(stream.window, stream.at, where)
            left = stream.left - (record.data_start - record.start)
            if record.data_bytes > left:
                name = _NAMES.get(record.opcode, "a record")
                raise Cut(where, f"{name} of {record.data_bytes} bytes begins, but only {left} bytes follow")
            self._pass_record(record, where)
        except Cut as cut:
            if record.opcode == Op.CHUNK and not self._goes_on():
                try:
                    head = _chunk_head(record)
                except Malformed as damage:
                    self._resync(damage)
                else:
                    self._read_cut_chunk(head, cut)
            else:
                self._resync(cut)
        except Malformed as damage:
            self._resync(damage)

    def _goes_on(self) -> bool:
        """Return whether a record follows a chunk that claims to reach beyond the end of the file."""
        stream = self._stream
        stream.ahead(LOOK_AHEAD)
        return find_record(stream.window, stream.at + 1, len(stream.window), outside=True) is not None

    def _pass_record(self, record: BagRecord, where: str) -> None:
        """Read a whole record; where it cannot be one, nothing is skipped."""
        stream, scan, total = self._stream, self._scan, record.end - record.start
        if record.opcode == Op.INDEX_DATA:
            points_at_messages = partial(self._points_at_messages, record)
            messages, fault = record.fields.u32("count"), "its index data have wrong offsets"
            self._note_index_record(messages, points_at_messages, fault)
        else:
            self._end_chunk()
        if record.opcode == Op.CHUNK:
            self._pass_chunk(_chunk_head(record))
            return
        if record.opcode == Op.BAG_HEADER:
            self._note_header(record, where)
        elif record.opcode == Op.MESSAGE_DATA:
            batch = Batch(scan.facts.channels)
            chunks.add_message(record, batch)
            self._count(batch, MessageLocation(LocationKind.records, stream.position, total, total), stored=total)
        elif record.opcode in (Op.CONNECTION, Op.CHUNK_INFO):
            self._note_index_section(record, where)
        after = stream.at + total
        is_at_hand = stream.left > total and after + min(LOOK, stream.left - total) <= len(stream.window)
        if is_at_hand and opcode_at(stream.window, after) is None:
            scan.losses.wasted_bytes += total
            if record.opcode == Op.CHUNK_INFO:  # bytes of it are missing
                self._claimed_messages -= self._claims[len(self._claims) - 1].messages
                self._claims.pop()
            damage = Malformed(f"byte {stream.position + total}", "no record where one should begin")
            self._resync(damage, valid_bytes=total)
        else:
            stream.advance(total)

    def _note_header(self, record: BagRecord, where: str) -> None:
        stream, scan, fields = self._stream, self._scan, record.fields
        if fields.text("encryptor", ""):
            scan.refused = Malformed(where, "the bag is encrypted", certain=False)
        if scan.index_start is None:
            scan.index_start = fields.u64("index_pos")
            self._claimed_connections, self._claimed_chunks = fields.u32("conn_count"), fields.u32("chunk_count")
        if record.data_bytes > LOOK:
            raise Malformed(where, f"a bag header of {record.data_bytes} bytes")
        stream.ahead(record.end - record.start)
        padding_at = stream.at + record.data_start - record.start
        if bytes(stream.window[padding_at : stream.at + record.end - record.start]).strip(b" \0"):
            raise Malformed(where, "the bag header reaches into something else")

    def _note_index_section(self, record: BagRecord, where: str) -> None:
        stream, scan, losses = self._stream, self._scan, self._scan.losses
        if record.data_bytes > MAX_TAKE:
            raise Malformed(where, f"an index record of {record.data_bytes} bytes", certain=False)
        stream.ahead(record.end - record.start)
        if record.data_bytes > LOOK and losses.is_search_budget_spent(stream.position):
            raise Malformed(where, "an unverified index record, after too many bytes were searched without result")
        data = self._data_of(record)
        if record.opcode == Op.CONNECTION:
            losses.wasted_bytes += record.data_bytes
            chunks.define(record, data, scan.facts, where)
            losses.wasted_bytes -= record.data_bytes
            return
        info = records.read_chunk_info(record.fields, data, where)
        members, messages = scan.facts.table.sets.number(info.counts), sum(info.counts.values())
        self._claims.append(ChunkClaim(info.position, UNKNOWN, info.first_ns, info.last_ns, members, messages))
        self._claimed_messages += messages

    def _data_of(self, record: BagRecord) -> bytes:
        start = self._stream.at + record.data_start - record.start
        return bytes(self._stream.window[start : start + record.data_bytes])

    def _points_at_messages(self, record: BagRecord) -> bool:
        total = record.end - record.start
        if total > MAX_CHUNK_INDEX:
            return True
        self._stream.ahead(total)
        number, entries = record.fields.u32("conn"), records.array_u32(self._data_of(record))
        return chunks.points_at_messages(self._content, number, entries, self._scan.facts.layout)

    def _walk(self, raw: bytes, batch: Batch, *, may_end_early: bool = False) -> ChunkContents:
        return chunks.walk_contents(raw, self._scan.facts, batch, may_end_early=may_end_early)

    def _note_holes(self, start: int, head: ChunkHead, contents: ChunkContents, size_bytes: int) -> None:
        losses = self._scan.losses
        for hole in contents.holes:
            message = f"{hole.fault.message} ({hole.start} bytes into it)"
            losses.note(Malformed(f"chunk at byte {start}", message))
            losses.bytes += (hole.end - hole.start) * head.stored_bytes // size_bytes
        if contents.end < size_bytes:
            losses.messages_are_known = False
            losses.wasted_bytes += size_bytes

    def _reaches_over_chunk(self, after: int) -> bool:
        stream = self._stream
        return find_record(stream.window, stream.at + _MIN_CHUNK_HEAD, after, outside=True) is not None

    def _is_followed(self, total: int) -> bool:
        stream = self._stream
        return opcode_at(stream.window, stream.at + total) not in (None, Op.MESSAGE_DATA)

    def _is_verified(self, head: ChunkHead) -> bool:
        return bool(head.compression) and super()._is_verified(head)

    def _search(self) -> None:
        stream = self._stream
        stream.advance(1)
        while stream.left:
            width = search_width(stream)
            record_at = find_record(stream.window, stream.at, stream.at + width)
            stream.advance(width if record_at is None else record_at - stream.at)
            if record_at is not None:
                return


def _chunk_head(record: BagRecord) -> ChunkHead:
    return records.chunk_head(record.fields, record.data_start - record.start, record.data_bytes)


def scan_bag_records(reader: SequentialReader, builder: ChunkTableBuilder | None = None) -> BagScan:
    """Scan a whole bag. Its content never raises. `builder` receives the messages that are counted."""
    return _BagScanner(reader, builder).run()
