"""Scans a ROS 1 bag from the first byte to the last, with or without its index.

Holds one chunk of at most `MAX_CHUNK_BYTES` (larger ones are left out), keeps no message, and
goes on behind damage: behind a chunk that cannot be decompressed, and, where the records themselves break off, at the
next place where one is. What is left out on the way is measured; the chunk infos at the end of the file and the
index data behind each chunk say how many messages there should be.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from kleinkram.recordings.chunk_table import ANY_CHANNEL, UNKNOWN, ChannelSets, Int64Table
from kleinkram.recordings.compression import decompress, decompress_beginning, unreadable_chunk, without_zero_tail
from kleinkram.recordings.damage_report import DamageReport, IndexedChunk
from kleinkram.recordings.errors import Cut, Malformed
from kleinkram.recordings.formats.rosbag1 import chunks, records
from kleinkram.recordings.formats.rosbag1.chunks import BagFacts, BagRecord, find_record, parse_record, read_contents
from kleinkram.recordings.formats.rosbag1.records import Fields, Op
from kleinkram.recordings.index_check import ChunkClaim, ChunkMessages, IndexFaults, compare_with_scan, new_table
from kleinkram.recordings.limits import LOOK_AHEAD, MAX_CHUNK_BYTES, MAX_CHUNK_INDEX, MAX_HEADER, MAX_TAKE
from kleinkram.recordings.message_counts import Batch, MessageCounter, MessageObserver, MessagePlace, PlaceKind
from kleinkram.recordings.model import counted
from kleinkram.recordings.sources import SequentialReader
from kleinkram.recordings.streams import LookaheadStream

_LOOK = 64 * 2**10
_SEARCH_BYTES = 4 * 2**20
_LEAST_CHUNK_HEAD = 40
_NAMES: dict[int, str] = {Op.MESSAGE_DATA: "a message", Op.CHUNK: "a chunk", Op.CONNECTION: "a connection"}


@dataclass
class BagScan:
    """The result of a scan.

    Attributes:
        chunks: that could be read from end to end.
        index_start: where the bag's header says that the index begins; 0: nowhere; None: no header.
        listed: messages that the chunk infos say the bag has; None: not all chunk infos were found.
        refused: why nothing of the bag can be read though it may be whole.
        index_faults: what the index says of chunks that is not so.
    """

    facts: BagFacts = field(default_factory=BagFacts)
    counter: MessageCounter = field(default_factory=lambda: MessageCounter(with_publish_times=False))
    losses: DamageReport = field(default_factory=DamageReport)
    compression: set[str] = field(default_factory=set)
    chunks: int = 0
    index_start: int | None = None
    listed: int | None = None
    refused: Malformed | None = None
    index_faults: IndexFaults = field(default_factory=IndexFaults)


class _BagScanner:
    def __init__(self, reader: SequentialReader, observer: MessageObserver | None) -> None:
        self.scan = BagScan()
        self.scan.facts.observer = observer
        self._stream = LookaheadStream(reader, with_crc=False)
        self._chunk: IndexedChunk | None = None
        self._claims = Claims()
        self._content = b""
        self._actual_chunks = new_table()

    def run(self) -> BagScan:
        scan, stream = self.scan, self._stream
        stream.advance(len(records.MAGIC))
        while stream.left and scan.refused is None:
            self._step()
        self._end_chunk()
        self._define()
        nameless = scan.counter.finish()
        if nameless:
            scan.losses.note(
                Malformed(
                    "connections",
                    f"{counted(nameless, 'message is', 'messages are')} of connections that are not defined",
                )
            )
            scan.losses.messages += nameless
        claims = self._claims
        if scan.refused is None:
            size, connections = stream.size_bytes, len(scan.facts.connections)
            scan.listed = claims.settle(scan.losses, connections=connections, chunks=scan.chunks, size_bytes=size)
        if len(claims.listed) and claims.infos >= claims.chunks:
            is_damaged = bool(scan.losses.damage)
            compare_with_scan(claims.listed, self._actual_chunks, claims.sets, scan.index_faults, is_damaged=is_damaged)
        scan.losses.messages_are_known &= scan.refused is None
        scan.index_start = self._claims.index_start
        return scan

    def _step(self) -> None:
        """Read one top-level record, or skip damage."""
        stream = self._stream
        stream.ahead(_LOOK)
        where = f"byte {stream.position}"
        try:
            record = self._parse(where)
            self._check_end(record, where)
            self._pass_record(record, where)
        except Cut as cut:
            if record.opcode == Op.CHUNK and not self._goes_on():
                self._read_cut_chunk(record, cut)
            else:
                self._resync(cut)
        except Malformed as damage:
            self._resync(damage)

    def _parse(self, where: str) -> BagRecord:
        stream = self._stream
        header_bytes = int.from_bytes(stream.window[stream.at : stream.at + 4], "little")
        if header_bytes <= MAX_HEADER:
            stream.ahead(header_bytes + 8)
        return parse_record(stream.window, stream.at, where)

    def _check_end(self, record: BagRecord, where: str) -> None:
        left = self._stream.left - (record.data_start - record.start)
        if record.data_bytes > left:
            name = _NAMES.get(record.opcode, "a record")
            raise Cut(where, f"{name} of {record.data_bytes} bytes begins, but only {left} bytes follow")

    def _goes_on(self) -> bool:
        """Return whether a record follows a chunk that claims to reach beyond the end of the file."""
        stream = self._stream
        stream.ahead(LOOK_AHEAD)
        return find_record(stream.window, stream.at + 1, len(stream.window), outside=True) is not None

    def _pass_record(self, record: BagRecord, where: str) -> None:
        """Read a whole record.

        Raises:
            Malformed: it cannot be one; nothing was passed over.
        """
        stream, total = self._stream, record.end - record.start
        if record.opcode == Op.INDEX_DATA:
            if self._chunk is not None:
                self._chunk.records += 1
                self._chunk.messages += record.fields.u32("count")
                if self._content and total <= MAX_CHUNK_INDEX:
                    self._check_index_data(self._chunk.start, record)
        else:
            self._end_chunk()
        if record.opcode == Op.CHUNK:
            self._pass_chunk(record)
            return
        if record.opcode == Op.BAG_HEADER:
            self._note_header(record, where)
        elif record.opcode == Op.MESSAGE_DATA:
            batch = Batch(self.scan.facts.connections)
            chunks.add_message(record, batch)
            self._notify_observer(MessagePlace(PlaceKind.records, stream.position, total, total), batch)
            self.scan.counter.add(batch)
        elif record.opcode in (Op.CONNECTION, Op.CHUNK_INFO):
            self._note_index_record(record, where)
        after = stream.at + total
        is_at_hand = stream.left > total and after + min(_LOOK, stream.left - total) <= len(stream.window)
        if is_at_hand and not chunks.is_record(stream.window, after):
            damage = Malformed(f"byte {stream.position + total}", "no record where one should begin")
            self.scan.losses.wasted_bytes += total
            if record.opcode == Op.CHUNK_INFO:
                self._claims.forget_chunk_info()
            self._resync(damage, believed=total)
        else:
            stream.advance(total)

    def _note_header(self, record: BagRecord, where: str) -> None:
        if record.fields.text("encryptor", ""):
            self.scan.refused = Malformed(where, "the bag is encrypted", certain=False)
        self._claims.note_header(record.fields)
        if record.data_bytes > _LOOK:
            raise Malformed(where, f"a bag header of {record.data_bytes} bytes")
        self._stream.ahead(record.end - record.start)
        padding_at = self._stream.at + record.data_start - record.start
        if bytes(self._stream.window[padding_at : self._stream.at + record.end - record.start]).strip(b" \0"):
            raise Malformed(where, "the bag header reaches into something else")

    def _note_index_record(self, record: BagRecord, where: str) -> None:
        if record.data_bytes > MAX_TAKE:
            raise Malformed(where, f"an index record of {record.data_bytes} bytes", certain=False)
        stream = self._stream
        data_at = record.data_start - record.start
        stream.ahead(data_at + record.data_bytes)
        if record.data_bytes > _LOOK and self.scan.losses.is_search_budget_spent(stream.position):
            raise Malformed(where, "an unverified index record, after too many bytes were searched without result")
        data = bytes(stream.window[stream.at + data_at : stream.at + data_at + record.data_bytes])
        if record.opcode == Op.CONNECTION:
            self.scan.losses.wasted_bytes += record.data_bytes
            chunks.define(record, data, self.scan.facts, where)
            self.scan.losses.wasted_bytes -= record.data_bytes
            return
        self._claims.note_chunk_info(record.fields, data, where)

    def _pass_chunk(self, record: BagRecord) -> None:
        stream, scan = self._stream, self.scan
        start, total, head_bytes = stream.position, record.end - record.start, record.data_start - record.start
        compression, uncompressed = record.fields.text("compression"), record.fields.u32("size")
        scan.compression.add(compression)
        before, damaged = scan.counter.messages, len(scan.losses.damage)
        try:
            if why := unreadable_chunk(compression, stored=total, uncompressed=uncompressed):
                raise why
            if compression != "none":
                scan.losses.unpack(uncompressed, end=start + total)
            stream.ahead(total + _LOOK)
            self._check_search_budget(total, compression)
            stored = stream.window[stream.at + head_bytes : stream.at + total]
            messages, length = self._read_chunk(record, stored)
            stream.advance(length)
        except Malformed as error:
            self._skip_damaged_chunk(
                start, record, Malformed(f"chunk at byte {start}", error.message, certain=error.certain)
            )
            return
        partly = len(scan.losses.damage) > damaged
        self._note_chunk(start, None if partly else messages)
        scan.losses.chunks += partly
        scan.chunks += not partly
        self._chunk = IndexedChunk(start, scan.counter.messages - before, damaged=partly)

    def _note_chunk(self, start: int, messages: ChunkMessages | None) -> None:
        """Note the messages of a chunk; None: not all of them."""
        if messages is None:
            self._actual_chunks.append(ChunkClaim(start, UNKNOWN, 0, 0, ANY_CHANNEL, UNKNOWN))
            return
        channels = self._claims.sets.number(messages.channels)
        known = UNKNOWN if channels == ANY_CHANNEL and messages.channels else messages.messages
        self._actual_chunks.append(ChunkClaim(start, UNKNOWN, messages.first_ns, messages.last_ns, channels, known))

    def _check_index_data(self, start: int, record: BagRecord) -> None:
        """Compare the next index data with the messages at their offsets."""
        stream, data_at = self._stream, record.data_start - record.start
        stream.ahead(record.end - record.start)
        data = stream.window[stream.at + data_at : stream.at + data_at + record.data_bytes]
        try:
            number, entries = record.fields.u32("conn"), records.array_u32(bytes(data))
            is_right = chunks.points_at_messages(self._content, number, entries, self.scan.facts.layout)
        except Malformed:
            is_right = False
        if not is_right:
            self.scan.index_faults.note(start, "its index data have wrong offsets")

    def _read_chunk(self, record: BagRecord, stored: memoryview) -> tuple[ChunkMessages, int]:
        """Read a chunk; return its messages, and its length in the file."""
        start, total, head_bytes = self._stream.position, record.end - record.start, record.data_start - record.start
        compression, uncompressed = record.fields.text("compression"), record.fields.u32("size")
        raw = decompress(compression, stored, uncompressed)
        place = MessagePlace(PlaceKind.chunk, start, total, uncompressed)
        messages, end = self._read_contents(raw, record.data_bytes, place, ends_early=compression == "none")
        self._content = raw
        return messages, total if end == len(raw) else head_bytes + end

    def _read_contents(
        self, raw: bytes, stored: int, place: MessagePlace, *, ends_early: bool
    ) -> tuple[ChunkMessages, int]:
        """Add the messages of a chunk; return them, and where the chunk ends in `raw`."""
        scan = self.scan
        batch = Batch(scan.facts.connections)
        holes, end, readable_ranges = read_contents(raw, scan.facts, batch, ends_early=ends_early)
        self._define()
        self._notify_observer(place._replace(readable_ranges=readable_ranges) if holes else place, batch)
        scan.counter.add(batch, stored=stored, uncompressed=len(raw))
        for hole in holes:
            message = f"{hole.fault.message} ({hole.start} bytes into it)"
            scan.losses.note(Malformed(f"chunk at byte {place.start}", message))
            scan.losses.bytes += (hole.end - hole.start) * stored // len(raw)
        if end < len(raw):
            scan.losses.messages_are_known = False
            scan.losses.wasted_bytes += len(raw)
        messages = ChunkMessages()
        messages.add(batch)
        return messages, end

    def _skip_damaged_chunk(self, start: int, record: BagRecord, damage: Malformed) -> None:
        """Skip a damaged chunk if a record follows it; else search for the next record."""
        stream, scan = self._stream, self.scan
        scan.losses.chunks += 1
        total, before, used = record.end - record.start, scan.counter.messages, 0
        if stream.position == start and (after := stream.at + total) <= len(stream.window):
            stored = bytes(stream.window[after - record.data_bytes : after])
            zeroed = without_zero_tail(record.fields.text("compression"), stored)
            # Bytes of it may be missing, so that its length reaches over the next one.
            is_short = (
                not scan.losses.is_search_budget_spent(start)
                and find_record(stream.window, stream.at + _LEAST_CHUNK_HEAD, after, outside=True) is not None
            )
            is_followed = zeroed is not None or chunks.stands_outside_chunks(stream.window, after)
            if stream.left > total and (is_short or not is_followed):
                scan.losses.wasted_bytes += total
                self._resync(damage)
                return
            if zeroed is not None:
                used = self._save_beginning(zeroed, record)
        scan.losses.note(damage)
        self._note_chunk(start, None)
        stream.advance(start + total - stream.position)
        scan.losses.bytes += total - used
        self._chunk = IndexedChunk(start, scan.counter.messages - before, damaged=True)

    def _check_search_budget(self, total: int, compression: str) -> None:
        """Refuse an unverified chunk once too many were read without result.

        Raises:
            Malformed: the patience is spent, and nothing vouches for the chunk.
        """
        stream = self._stream
        if self.scan.losses.is_search_budget_spent(stream.position) and (
            compression == "none" or not chunks.stands_outside_chunks(stream.window, stream.at + total)
        ):
            raise Malformed("chunk", "unverified, after too many bytes were searched without result")

    def _read_cut_chunk(self, record: BagRecord, cut: Cut) -> None:
        """Read what is left of a chunk that reaches beyond the end of the file."""
        stream, scan = self._stream, self.scan
        try:
            compression, _ = record.fields.text("compression"), record.fields.u32("size")
        except Malformed as damage:
            self._resync(damage)
            return
        self._end_chunk()
        scan.compression.add(compression)
        scan.losses.chunks += 1
        left, head_bytes = stream.left, record.data_start - record.start
        at_hand = stream.ahead(min(left, MAX_CHUNK_BYTES))
        stored = bytes(stream.window[stream.at + head_bytes : stream.at + at_hand])
        used = self._save_beginning(without_zero_tail(compression, stored) or stored, record)
        scan.losses.note(cut)
        scan.losses.bytes += left - used
        scan.losses.messages_are_known = False
        stream.advance(stream.left)

    def _save_beginning(self, stored: bytes, record: BagRecord) -> int:
        """Count the messages of a chunk whose end is missing; return how many of its bytes are used."""
        scan, head_bytes = self.scan, record.data_start - record.start
        compression, uncompressed = record.fields.text("compression"), record.fields.u32("size")
        uncompressed = min(uncompressed, MAX_CHUNK_BYTES)
        if compression != "none" and not scan.losses.may_unpack(uncompressed, end=self._stream.size_bytes):
            return 0
        raw = decompress_beginning(compression, stored, uncompressed)
        batch = Batch(scan.facts.connections)
        holes, _, readable_ranges = read_contents(raw, scan.facts, batch)
        self._define()
        self._notify_observer(
            MessagePlace(PlaceKind.cut, self._stream.position, head_bytes + len(stored), len(raw), readable_ranges),
            batch,
        )
        scan.losses.unverified += scan.counter.add(batch, stored=len(stored), uncompressed=len(raw))
        followed = len(raw) - sum(hole.end - hole.start for hole in holes)
        return head_bytes + len(stored) * followed // len(raw) if followed else 0

    def _resync(self, damage: Malformed, believed: int = 0) -> None:
        """Skip damage up to the next record; the first `believed` bytes are not lost."""
        stream, scan = self._stream, self.scan
        self._end_chunk()
        scan.losses.note(damage)
        scan.losses.messages_are_known = False
        start = stream.position + believed
        stream.advance(1)
        while stream.left:
            at_hand = stream.ahead(_SEARCH_BYTES)
            width = at_hand if at_hand == stream.left else at_hand - _LOOK
            record_at = find_record(stream.window, stream.at, stream.at + width)
            stream.advance(width if record_at is None else record_at - stream.at)
            if record_at is not None:
                break
        scan.losses.bytes += max(0, stream.position - start)

    def _end_chunk(self) -> None:
        """Compare the last chunk with its index data."""
        if self._chunk is not None:
            self._chunk.settle(self.scan.losses)
            self._chunk, self._content = None, b""

    def _notify_observer(self, place: MessagePlace, batch: Batch) -> None:
        if self.scan.facts.observer is not None:
            self.scan.facts.observer.on_messages(place, batch)

    def _define(self) -> None:
        self.scan.counter.learn(self.scan.facts.connections)


def scan_bag_records(reader: SequentialReader, observer: MessageObserver | None = None) -> BagScan:
    """Scan a whole bag. Its content never raises. The observer receives every message that is counted.

    Raises:
        SourceError: as `SequentialReader.read`.
    """
    return _BagScanner(reader, observer).run()


@dataclass
class Claims:
    """What the bag header and the chunk infos claim.

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
    listed: Int64Table[ChunkClaim] = field(default_factory=new_table)
    _latest: int = 0

    def note_header(self, fields: Fields) -> None:
        """Note the first bag header."""
        if self.index_start is None:
            self.index_start = fields.u64("index_pos")
            self.connections = fields.u32("conn_count")
            self.chunks = fields.u32("chunk_count")

    def note_chunk_info(self, fields: Fields, data: bytes, where: str) -> None:
        """Note a chunk info.

        Raises:
            Malformed: it is damaged.
        """
        info = records.read_chunk_info(fields, data, where)
        members, messages = self.sets.number(info.counts), sum(info.counts.values())
        self.listed.append(ChunkClaim(info.position, UNKNOWN, info.first_ns, info.last_ns, members, messages))
        self._latest = messages
        self.infos += 1
        self.messages += self._latest

    def forget_chunk_info(self) -> None:
        """Undo the latest chunk info: bytes of it are missing."""
        self.listed.pop()
        self.infos -= 1
        self.messages -= self._latest

    def settle(self, losses: DamageReport, *, connections: int, chunks: int, size_bytes: int) -> int | None:
        """Compare with the connections and readable chunks, and report what is missing.

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
