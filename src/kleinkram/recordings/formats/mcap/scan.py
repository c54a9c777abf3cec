"""Scans an MCAP from the first byte to the last: every record, chunk and CRC.

Holds one chunk of at most `MAX_CHUNK_BYTES` (larger ones are left out), keeps no message, and
goes on behind damage: behind a chunk that cannot be believed, and, where the records themselves break off, at the next
place where one can begin. What is left out on the way is measured.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from kleinkram.recordings.chunk_table import ANY_CHANNEL, UNKNOWN
from kleinkram.recordings.compression import unreadable_chunk, without_zero_tail
from kleinkram.recordings.damage_report import DamageReport, IndexedChunk
from kleinkram.recordings.errors import Cut, Malformed
from kleinkram.recordings.formats.mcap import chunks, records, resync
from kleinkram.recordings.formats.mcap.chunks import points_at_messages, walk_messages
from kleinkram.recordings.formats.mcap.records import RECORD_HEAD, ChannelRecord, McapFacts, Opcode
from kleinkram.recordings.formats.mcap.resync import (
    LOOK,
    fault,
    find_inner,
    holds_chunk,
    pass_damage,
    stands_outside_chunks,
)
from kleinkram.recordings.index_check import (
    ChunkClaim,
    ChunkMessages,
    compare_with_scan,
    new_table,
    wrong_compression,
    wrong_times,
)
from kleinkram.recordings.limits import MAX_CHUNK_BYTES, MAX_TAKE, WINDOW
from kleinkram.recordings.message_counts import Batch, MessageCounter, MessageObserver, MessagePlace, PlaceKind
from kleinkram.recordings.model import counted
from kleinkram.recordings.sources import SequentialReader
from kleinkram.recordings.streams import LookaheadStream

_U32 = struct.Struct("<I")
_NAMES: dict[int, str] = {Opcode.MESSAGE: "a message", Opcode.CHUNK: "a chunk", Opcode.ATTACHMENT: "an attachment"}
_READERS: dict[int, Callable[[McapFacts, bytes, str], None]] = {
    Opcode.HEADER: records.read_header,
    Opcode.SCHEMA: records.read_schema,
    Opcode.CHANNEL: records.read_channel,
    Opcode.STATISTICS: records.read_statistics,
    Opcode.CHUNK_INDEX: records.read_chunk_index,
    Opcode.METADATA: records.read_metadata,
}


@dataclass
class McapScan:
    """The result of a scan.

    Attributes:
        closed: the file ends as its writer meant it to.
        chunks: that could be read.
    """

    facts: McapFacts = field(default_factory=McapFacts)
    counter: MessageCounter = field(default_factory=MessageCounter)
    losses: DamageReport = field(default_factory=DamageReport)
    closed: bool = False
    chunks: int = 0


class _McapScanner:
    def __init__(self, reader: SequentialReader, observer: MessageObserver | None) -> None:
        self.scan = McapScan()
        self.scan.facts.observer = observer
        self._stream = LookaheadStream(reader)
        self._unchunked = UnchunkedMessages(self._stream, self.scan.facts, self.scan.counter)
        self._listed: IndexedChunk | None = None
        self._content = b""
        self._actual_chunks = new_table()
        self._is_resynced = False
        self._sections = Sections(self._stream, self.scan.facts, self.scan.losses)

    def run(self) -> McapScan:
        scan, stream = self.scan, self._stream
        stream.advance(min(len(records.MAGIC), stream.left))
        while stream.left:
            self._step()
        self._unchunked.flush()
        self._end_chunk()
        nameless = scan.counter.finish()
        if nameless:
            scan.losses.note(
                Malformed(
                    "channels",
                    f"{counted(nameless, 'message is', 'messages are')} on channels that the file does not define",
                )
            )
            scan.losses.messages += nameless
        self._compare_index()
        scan.losses.messages_are_known = scan.losses.messages_are_known and scan.closed
        claimed = scan.facts.statistics
        is_believed = claimed is not None and not scan.losses.damage and not scan.losses.index_faults
        if claimed is not None and is_believed and claimed.messages > scan.counter.messages:
            missing = claimed.messages - scan.counter.messages
            scan.losses.note(
                Malformed("statistics", f"they say {counted(missing, 'message')} more than the file holds")
            )
            scan.losses.messages += missing
        return scan

    def _compare_index(self) -> None:
        """Compare the chunk index with the chunks that were read."""
        facts, losses, claims = self.scan.facts, self.scan.losses, new_table()
        for place in facts.table.rows:
            times = place.first_ns, place.last_ns
            claims.append(ChunkClaim(place.start, place.start + place.length, *times, place.channels, UNKNOWN))
        if not len(claims):
            return
        for chunk in self._actual_chunks if facts.unknown_compression else ():
            named = facts.unknown_compression.get(chunk.start)
            if named is not None and chunk.messages != UNKNOWN:
                facts.index_faults.note(chunk.start, wrong_compression(named))
        is_damaged = bool(losses.damage)
        compare_with_scan(claims, self._actual_chunks, facts.table.sets, facts.index_faults, is_damaged=is_damaged)

    def _step(self) -> None:
        """Read some messages, one other record, or skip damage."""
        stream = self._stream
        stream.ahead(LOOK)
        if self._is_disguised():
            return
        self._is_resynced = False
        if last_bytes := self._unchunked.walk():
            self._end_chunk()
            self._pass(last_bytes)
            return
        where = f"byte {stream.position}"
        if stream.left < RECORD_HEAD.size:
            self._give_up(Cut(where, "the file ends within a record"), stream.left)
            return
        opcode, length = RECORD_HEAD.unpack_from(stream.window, stream.at)
        stream.ahead(RECORD_HEAD.size + min(length, WINDOW))
        try:
            self._check(opcode, length, where)
            self._pass_record(opcode, length, where)
        except Cut as cut:
            if opcode == Opcode.CHUNK:
                self._read_cut_chunk(cut, min(RECORD_HEAD.size + length, stream.left))
            else:
                self._resync(cut)
        except Malformed as error:
            self._resync(error)

    def _is_disguised(self) -> bool:
        """Skip a record of another kind that claims to be a message, if there is one."""
        stream, losses = self._stream, self.scan.losses
        behind_chunk = self._listed is not None or self._is_resynced
        if not resync.is_disguised(stream.window, stream.at, stream.left, behind_chunk=behind_chunk):
            return False
        _, length = RECORD_HEAD.unpack_from(stream.window, stream.at)
        losses.note(Malformed(f"byte {stream.position}", "a record of another kind that claims to be a message"))
        losses.bytes += RECORD_HEAD.size + length
        stream.advance(RECORD_HEAD.size + length)
        return True

    def _check(self, opcode: int, length: int, where: str) -> None:
        stream = self._stream
        if wrong := fault(stream.window, stream.at, stream.left):
            raise Malformed(where, wrong)
        if opcode == Opcode.CHUNK and resync.is_unfinished_chunk(stream.window, stream.at):
            raise Cut(where, "a chunk was begun here and never finished: its lengths were never filled in")
        if length > (left := stream.left - RECORD_HEAD.size):
            name = _NAMES.get(opcode, "a record")
            raise Cut(where, f"{name} of {length} bytes begins, but only {left} bytes follow")

    def _pass_record(self, opcode: int, length: int, where: str) -> None:
        """Read a whole record.

        Raises:
            Malformed: it cannot be one; nothing was passed over.
        """
        stream, total = self._stream, RECORD_HEAD.size + length
        if opcode == Opcode.HEADER and stream.position != len(records.MAGIC):
            raise Malformed(where, "the header of a file in the middle of it")
        if opcode == Opcode.MESSAGE_INDEX:
            self._note_listed(length)
        else:
            self._end_chunk()
        if opcode == Opcode.CHUNK:
            self._pass_chunk(total)
        elif opcode == Opcode.ATTACHMENT:
            self._sections.pass_attachment(length, where)
        elif opcode == Opcode.FOOTER:
            self._sections.pass_footer(where)
            self.scan.closed = True
        elif opcode == Opcode.DATA_END:
            self._sections.pass_data_end(total, where)
        elif opcode == Opcode.MESSAGE:
            self._unchunked.take_large(total)
            self._pass(total)
        else:
            if opcode in _READERS:
                at_hand = stream.ahead(RECORD_HEAD.size + min(length, MAX_TAKE))
                body = bytes(stream.window[stream.at + RECORD_HEAD.size : stream.at + at_hand])
                if length > LOOK and self.scan.losses.is_search_budget_spent(stream.position):
                    raise Malformed(where, "an unverified record, after too many bytes were searched without result")
                _READERS[opcode](self.scan.facts, body, where)
            self._pass(total)

    def _pass_chunk(self, total: int) -> None:
        stream, scan = self._stream, self.scan
        start = stream.position
        head = chunks.read_chunk_head(stream.window, stream.at)
        scan.facts.compression.add(head.compression or "none")
        before = scan.counter.messages
        try:
            messages, fault = self._read_chunk(head, total)
        except Malformed as error:
            self._skip_damaged_chunk(
                start, total, head, Malformed(f"chunk at byte {start}", error.message, certain=error.certain)
            )
            return
        scan.chunks += 1
        self._listed = IndexedChunk(start, scan.counter.messages - before, damaged=fault is not None)
        self._note_chunk(start, start + total, head, messages if fault is None else None)
        if fault is not None:
            self.scan.losses.note(Malformed(f"chunk at byte {start}", fault.message, certain=fault.certain))
            scan.losses.chunks += 1

    def _note_chunk(self, start: int, end: int, head: chunks.ChunkHead, messages: ChunkMessages | None) -> None:
        """Note the messages of a chunk (None: not all of them), and compare them with its head."""
        facts = self.scan.facts
        if messages is None:
            self._actual_chunks.append(ChunkClaim(start, UNKNOWN, 0, 0, ANY_CHANNEL, UNKNOWN))
            return
        times, channels = (messages.first_ns, messages.last_ns), facts.table.sets.number(messages.channels)
        known = UNKNOWN if channels == ANY_CHANNEL and messages.channels else messages.messages
        self._actual_chunks.append(ChunkClaim(start, end, *times, channels, known))
        wrong = wrong_times((head.first_ns, head.last_ns), times) if messages.messages else None
        if wrong is not None:
            facts.index_faults.note(start, f"its head is wrong: it says that its messages {wrong}")

    def _read_chunk(self, head: chunks.ChunkHead, total: int) -> tuple[ChunkMessages, Malformed | None]:
        """Read a chunk; return its messages, and why not all of it could be read.

        Raises:
            Malformed: nothing in it can be believed, and nothing was counted.
        """
        stream, scan = self._stream, self.scan
        if why := unreadable_chunk(head.compression, stored=total, uncompressed=head.uncompressed):
            raise why
        stream.ahead(total + LOOK)
        if scan.losses.is_search_budget_spent(stream.position) and not self._is_followed(total):
            raise Malformed("chunk", "unverified, after too many bytes were searched without result")
        if head.compression:
            scan.losses.unpack(head.uncompressed, end=stream.position + total)
        stored = stream.window[stream.at + head.data_start : stream.at + total]
        batch = Batch(scan.facts.channels)
        contents = chunks.read_chunk(stored, head, scan.facts, batch)
        readable_ranges = ((0, contents.walked),) if contents.fault else None
        self._count(
            batch, head, MessagePlace(PlaceKind.chunk, stream.position, total, head.uncompressed, readable_ranges)
        )
        stream.advance(total)
        self._content = contents.raw
        messages = ChunkMessages()
        messages.add(batch)
        return messages, contents.fault

    def _count(self, batch: Batch, head: chunks.ChunkHead, place: MessagePlace) -> None:
        self.scan.counter.learn(self.scan.facts.channels)
        chunks.notify(self.scan.facts, place, batch)
        self.scan.counter.add(batch, stored=head.stored, uncompressed=head.uncompressed)

    def _skip_damaged_chunk(self, start: int, total: int, head: chunks.ChunkHead, damage: Malformed) -> None:
        """Skip a damaged chunk if a record follows it; else search for the next record."""
        stream, scan = self._stream, self.scan
        scan.losses.chunks += 1
        before, used = scan.counter.messages, 0
        if stream.position == start and (after := stream.at + total) <= len(stream.window):
            stored = bytes(stream.window[stream.at + head.data_start : after])
            zeroed = without_zero_tail(head.compression, stored)
            # Bytes of it may be missing, so that its length reaches over the next one.
            is_short = not scan.losses.is_search_budget_spent(start) and self._reaches_over_chunk(after)
            if stream.left > total and (is_short or (zeroed is None and not self._is_followed(total))):
                scan.losses.wasted_bytes += total
                self._resync(damage)
                return
            if zeroed is not None:
                used = self._save_beginning(zeroed, head)
        scan.losses.note(damage)
        self._note_chunk(start, start + total, head, None)
        stream.advance(start + total - stream.position)
        scan.losses.bytes += total - used
        self._listed = IndexedChunk(start, scan.counter.messages - before, damaged=True)

    def _reaches_over_chunk(self, after: int) -> bool:
        """Return whether another chunk of this file begins before a place in the window."""
        stream = self._stream
        inner = find_inner(stream.window, stream.at, after, stream.left)
        return holds_chunk(stream.window, stream.at + 1, after if inner is None else inner, stream.left - 1)

    def _is_followed(self, total: int) -> bool:
        """Return whether a record that is never inside a chunk follows the next `total` bytes."""
        stream = self._stream
        return stands_outside_chunks(stream.window, stream.at + total, stream.left - total)

    def _read_cut_chunk(self, cut: Cut, total: int) -> None:
        """Read what is left of a chunk that reaches beyond the end of the file, or was never finished.

        `total`: bytes of the file that are left for it.
        """
        stream, scan = self._stream, self.scan
        self._end_chunk()
        head = chunks.read_chunk_head(stream.window, stream.at)
        scan.facts.compression.add(head.compression or "none")
        scan.losses.chunks += 1
        start, before = stream.position, scan.counter.messages
        if head.is_unfinished:
            head = head._replace(stored=total - head.data_start)
        at_hand = stream.ahead(min(total, MAX_CHUNK_BYTES))
        stored = bytes(stream.window[stream.at + head.data_start : stream.at + at_hand])
        used = self._save_beginning(without_zero_tail(head.compression, stored) or stored, head)
        if start + total == stream.size_bytes:
            self._give_up(cut, total - used)
            return
        stream.advance(start + total - stream.position)
        scan.losses.note(cut)
        scan.losses.bytes += total - used
        self._listed = IndexedChunk(start, scan.counter.messages - before, damaged=True)

    def _save_beginning(self, stored: bytes, head: chunks.ChunkHead) -> int:
        """Count the messages of a chunk whose end is missing; return how many of its bytes are used."""
        scan, batch = self.scan, Batch(self.scan.facts.channels)
        uncompressed = min(head.uncompressed, MAX_CHUNK_BYTES)
        if head.compression and not scan.losses.may_unpack(uncompressed, end=self._stream.size_bytes):
            return 0
        walked, _, raw = chunks.read_beginning(stored, head, scan.facts, batch)
        place = MessagePlace(
            PlaceKind.cut, self._stream.position, head.data_start + len(stored), len(raw), ((0, walked),)
        )
        before = scan.counter.messages
        self._count(batch, head._replace(stored=len(stored), uncompressed=len(raw)), place)
        scan.losses.unverified += scan.counter.messages - before
        return head.data_start + len(stored) * walked // len(raw) if walked else 0

    def _note_listed(self, length: int) -> None:
        stream = self._stream
        if self._listed is not None:
            (entries_bytes,) = _U32.unpack_from(stream.window, stream.at + RECORD_HEAD.size + 2)
            self._listed.records += 1
            self._listed.messages += entries_bytes // 16
            if self._content:
                self._check_listed(self._listed.start, length)

    def _check_listed(self, start: int, length: int) -> None:
        """Compare a message index with the messages at its offsets."""
        stream = self._stream
        stream.ahead(RECORD_HEAD.size + length)
        body = bytes(stream.window[stream.at + RECORD_HEAD.size : stream.at + RECORD_HEAD.size + length])
        try:
            channel_id, stamps, offsets = records.read_message_index(body, "")
            is_right = points_at_messages(self._content, channel_id, stamps, offsets)
        except Malformed:
            is_right = False
        if not is_right:
            self.scan.facts.index_faults.note(start, "its message index has wrong offsets")

    def _end_chunk(self) -> None:
        """Compare the last chunk with its message indexes."""
        if self._listed is not None:
            self._listed.settle(self.scan.losses)
            self._listed, self._content = None, b""

    def _pass(self, total: int) -> None:
        """Skip a record; if no record can begin after it, its length is wrong, and the search begins inside it."""
        stream = self._stream
        after = stream.at + total
        wrong = resync.fault_at_hand(stream.window, after, stream.left - total)
        if wrong is None:
            stream.advance(total)
        else:
            if stream.window[stream.at] == Opcode.STATISTICS:
                self.scan.facts.statistics = None  # bytes of it are missing
            self.scan.losses.wasted_bytes += total if total > LOOK else 0
            self._resync(Malformed(f"byte {stream.position + total}", wrong), believed=total)

    def _resync(self, damage: Malformed, believed: int = 0) -> None:
        """Skip damage up to the next record; the first `believed` bytes are not lost."""
        stream, scan = self._stream, self.scan
        self._end_chunk()
        self.scan.losses.note(damage)
        scan.losses.messages_are_known = False
        start = stream.position + believed
        pass_damage(stream, scan.facts.channels, scan.losses)
        self._is_resynced = True
        scan.losses.bytes += max(0, stream.position - start)

    def _give_up(self, damage: Malformed, lost: int) -> None:
        """Skip the rest of the file, of which so many bytes are lost."""
        self.scan.losses.note(damage)
        self.scan.losses.bytes += lost
        self.scan.losses.messages_are_known = False
        self._stream.advance(self._stream.left)


def scan_records(
    reader: SequentialReader,
    observer: MessageObserver | None = None,
    channels: Mapping[int, ChannelRecord] | None = None,
) -> McapScan:
    """Scan a whole file. Its content never raises. The observer receives every message that is counted.

    Args:
        reader: the file.
        observer: as above.
        channels: that are known before; a part of a file may not define its own.

    Raises:
        SourceError: as `SequentialReader.read`.
    """
    scanner = _McapScanner(reader, observer)
    scanner.scan.facts.channels.update(channels or {})
    return scanner.run()


class Sections:
    """Reads attachments and the ends of sections, and compares their checksums."""

    def __init__(self, stream: LookaheadStream, facts: McapFacts, losses: DamageReport) -> None:
        self._stream = stream
        self._facts = facts
        self._losses = losses
        self._data_end: int | None = None

    def pass_attachment(self, length: int, where: str) -> None:
        """Read an attachment without holding it."""
        stream = self._stream
        body_at = stream.at + RECORD_HEAD.size
        head = bytes(stream.window[body_at : body_at + min(length, WINDOW)])
        records.read_attachment(self._facts, head, where)
        stream.advance(RECORD_HEAD.size)
        crc = stream.digest(length - _U32.size)
        (claimed,) = _U32.unpack(stream.read_up_to(_U32.size))
        if claimed and claimed != crc:
            self._losses.note(Malformed(f"attachment at {where}", "its checksum is wrong"))

    def pass_data_end(self, total: int, where: str) -> None:
        """Read the end of the data section."""
        stream = self._stream
        (claimed,) = _U32.unpack_from(stream.window, stream.at + RECORD_HEAD.size)
        if self._data_end is None and claimed and claimed != stream.crc() and not self._losses.damage:
            place = f"data section (to {where})"
            self._losses.note(Malformed(place, "its checksum is wrong: some of its bytes are not as they were written"))
            # Whole records may be gone without a trace.
            self._losses.messages_are_known = False
        stream.advance(total)
        stream.restart_crc()
        self._data_end = stream.position

    def pass_footer(self, where: str) -> None:
        """Read the footer and the magic after it."""
        stream = self._stream
        body_at = stream.at + RECORD_HEAD.size
        summary_start, _offsets_start, claimed = records.FOOTER_BODY.unpack_from(stream.window, body_at)
        stream.advance(RECORD_HEAD.size + records.FOOTER_BODY.size - _U32.size)
        if claimed and summary_start == self._data_end and claimed != stream.crc() and not self._losses.damage:
            self._losses.note_index(Malformed(where, "the checksum of the summary section is wrong"))
        stream.advance(_U32.size + len(records.MAGIC))
        if stream.left:
            # It may be that of a file inside of this one, whose place the search came upon: the scan goes on.
            self._losses.note(Malformed(f"byte {stream.position}", f"{stream.left} bytes follow its end"))


_FLUSH_BYTES = 8 * 2**20


class UnchunkedMessages:
    """Counts messages outside of chunks in batches; call `flush` at the end."""

    def __init__(self, stream: LookaheadStream, facts: McapFacts, counter: MessageCounter) -> None:
        self._stream = stream
        self._facts = facts
        self._counter = counter
        self._batch = Batch(facts.channels)
        self._bytes = 0

    def walk(self) -> int:
        """Take all messages in the window, and skip all but the last; return the size of that one.

        0: none is here that is in memory as a whole.
        """
        stream = self._stream
        after, last = walk_messages(stream.window, stream.at, len(stream.window), self._batch)
        self._notify_observer(after - stream.at)
        self._pass(last - stream.at)
        return after - last

    def take_large(self, total: int) -> None:
        """Take a message of `total` bytes, of which only the head is in the window; skips nothing.

        Raises:
            Malformed: it is too short to be one.
        """
        channel_id, row = chunks.read_large_message(self._stream)
        self._batch[channel_id].extend(row)
        self._notify_observer(total)
        self._pass(0)

    def flush(self) -> None:
        """Count what was taken."""
        self._counter.learn(self._facts.channels)
        self._counter.add(self._batch)
        self._batch, self._bytes = Batch(self._facts.channels), 0

    def _pass(self, length: int) -> None:
        self._stream.advance(length)
        self._bytes += length
        if self._bytes > _FLUSH_BYTES:
            self.flush()

    def _notify_observer(self, length: int) -> None:
        """Pass the messages in the next `length` bytes to the observer."""
        if self._facts.observer is not None and length:
            chunks.notify(
                self._facts, MessagePlace(PlaceKind.records, self._stream.position, length, length), self._batch
            )
            self.flush()  # what the batch holds next is somewhere else
