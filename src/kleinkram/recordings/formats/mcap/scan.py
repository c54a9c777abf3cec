"""Scans an MCAP from the first byte to the last: every record, chunk and CRC."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

from kleinkram.recordings.chunk_index_check import ChunkClaim, compare_with_scan, wrong_compression
from kleinkram.recordings.chunk_scanner import LOOK, ChunkContents, ChunkScan, ChunkScanner
from kleinkram.recordings.chunk_table import UNKNOWN, ChunkHead, ChunkTableBuilder, Int64Table
from kleinkram.recordings.errors import Cut, Malformed
from kleinkram.recordings.formats.mcap import chunks, records, resync
from kleinkram.recordings.formats.mcap.chunks import MESSAGE_FIXED, MESSAGE_HEAD, walk_messages
from kleinkram.recordings.formats.mcap.records import RECORD_HEAD, ChannelRecord, McapFacts, Opcode
from kleinkram.recordings.limits import MAX_TAKE, WINDOW
from kleinkram.recordings.model import counted
from kleinkram.recordings.scanned_messages import Batch, LocationKind, MessageCounter, MessageLocation
from kleinkram.recordings.sources import SequentialReader
from kleinkram.recordings.streams import LookaheadStream, open_bytes

_U32 = struct.Struct("<I")
_FLUSH_BYTES = 8 * 2**20
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
class McapScan(ChunkScan[McapFacts]):
    """The result of a scan. `closed`: the file has its footer."""

    facts: McapFacts = field(default_factory=McapFacts)
    counter: MessageCounter = field(default_factory=MessageCounter)
    closed: bool = False


class _McapScanner(ChunkScanner[McapFacts]):
    _scan: McapScan

    def __init__(
        self, reader: SequentialReader, builder: ChunkTableBuilder | None, channels: Mapping[int, ChannelRecord]
    ) -> None:
        super().__init__(McapScan(McapFacts(dict(channels))), LookaheadStream(reader), builder)
        self._unchunked = Batch(self._scan.facts.channels)
        self._unchunked_bytes = 0
        self._is_resynced = False
        self._data_end: int | None = None

    def run(self) -> McapScan:
        scan, stream, losses = self._scan, self._stream, self._scan.losses
        stream.advance(min(len(records.MAGIC), stream.left))
        while stream.left:
            self._step()
        self._flush()
        self._end_chunk()
        self._drop_undefined("channels", "on channels that the file does not define")
        self._compare_index()
        losses.messages_are_known = losses.messages_are_known and scan.closed
        claimed = scan.facts.statistics
        is_believed = claimed is not None and not losses.damage and not losses.index_faults
        if claimed is not None and is_believed and claimed.messages > scan.counter.messages:
            missing = claimed.messages - scan.counter.messages
            losses.note(Malformed("statistics", f"they say {counted(missing, 'message')} more than the file holds"))
            losses.messages += missing
        return scan

    def _compare_index(self) -> None:
        facts, claims = self._scan.facts, Int64Table(ChunkClaim)
        for row in facts.table.rows:
            times = row.first_ns, row.last_ns
            claims.append(ChunkClaim(row.start, row.start + row.length, *times, row.channels, UNKNOWN))
        if not len(claims):
            return
        for chunk in self._actual_chunks if facts.unknown_compression else ():
            named = facts.unknown_compression.get(chunk.start)
            if named is not None and chunk.messages != UNKNOWN:
                facts.index_faults.note(chunk.start, wrong_compression(named))
        is_damaged = bool(self._scan.losses.damage)
        compare_with_scan(claims, self._actual_chunks, facts.table.sets, facts.index_faults, is_damaged=is_damaged)

    def _step(self) -> None:
        """Read some messages, one other record, or skip damage."""
        stream, losses = self._stream, self._scan.losses
        stream.ahead(LOOK)
        behind_chunk = self._chunk is not None or self._is_resynced
        if resync.has_flipped_opcode(stream.window, stream.at, stream.left, behind_chunk=behind_chunk):
            _, length = RECORD_HEAD.unpack_from(stream.window, stream.at)
            losses.note(Malformed(f"byte {stream.position}", "a record of another kind that claims to be a message"))
            losses.bytes += RECORD_HEAD.size + length
            stream.advance(RECORD_HEAD.size + length)
            return
        self._is_resynced = False
        if last_bytes := self._walk_unchunked():
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
            if wrong := resync.fault(stream.window, stream.at, stream.left):
                raise Malformed(where, wrong)
            if opcode == Opcode.CHUNK and resync.is_unfinished_chunk(stream.window, stream.at):
                raise Cut(where, "a chunk was begun here and never finished: its lengths were never filled in")
            if length > (left := stream.left - RECORD_HEAD.size):
                name = _NAMES.get(opcode, "a record")
                raise Cut(where, f"{name} of {length} bytes begins, but only {left} bytes follow")
            self._pass_record(opcode, length, where)
        except Cut as cut:
            if opcode == Opcode.CHUNK:
                head = self._chunk_head()
                if head.is_unfinished:
                    total = min(RECORD_HEAD.size + length, stream.left)
                    head = head._replace(stored_bytes=total - head.data_start)
                self._read_cut_chunk(head, cut)
            else:
                self._resync(cut)
        except Malformed as error:
            self._resync(error)

    def _pass_record(self, opcode: int, length: int, where: str) -> None:
        """Read a whole record; where it cannot be one, nothing is skipped."""
        stream, total = self._stream, RECORD_HEAD.size + length
        if opcode == Opcode.HEADER and stream.position != len(records.MAGIC):
            raise Malformed(where, "the header of a file in the middle of it")
        if opcode == Opcode.MESSAGE_INDEX:
            (entries_bytes,) = _U32.unpack_from(stream.window, stream.at + RECORD_HEAD.size + 2)
            points_at_messages = partial(self._points_at_messages, length)
            self._note_index_record(entries_bytes // 16, points_at_messages, "its message index has wrong offsets")
        else:
            self._end_chunk()
        if opcode == Opcode.CHUNK:
            self._pass_chunk(self._chunk_head())
        elif opcode == Opcode.ATTACHMENT:
            self._pass_attachment(length, where)
        elif opcode == Opcode.FOOTER:
            self._pass_footer(where)
            self._scan.closed = True
        elif opcode == Opcode.DATA_END:
            self._pass_data_end(total, where)
        elif opcode == Opcode.MESSAGE:
            self._take_large_message()
            self._pass(total)
        else:
            if opcode in _READERS:
                at_hand = stream.ahead(RECORD_HEAD.size + min(length, MAX_TAKE))
                body = bytes(stream.window[stream.at + RECORD_HEAD.size : stream.at + at_hand])
                if length > LOOK and self._scan.losses.is_search_budget_spent(stream.position):
                    raise Malformed(where, "an unverified record, after too many bytes were searched without result")
                _READERS[opcode](self._scan.facts, body, where)
            self._pass(total)

    def _chunk_head(self) -> ChunkHead:
        stream = self._stream
        return chunks.open_chunk(open_bytes(bytes(stream.window[stream.at :][:LOOK]), stream.position))

    def _points_at_messages(self, length: int) -> bool:
        """Compare a message index of `length` bytes with the messages at its offsets."""
        stream = self._stream
        stream.ahead(RECORD_HEAD.size + length)
        body = bytes(stream.window[stream.at + RECORD_HEAD.size : stream.at + RECORD_HEAD.size + length])
        return chunks.points_at_messages(self._content, *records.read_message_index(body, ""))

    def _walk(self, raw: bytes, batch: Batch, *, may_end_early: bool = False) -> ChunkContents:
        return chunks.walk_contents(raw, self._scan.facts, batch)

    def _note_holes(self, start: int, head: ChunkHead, contents: ChunkContents, size_bytes: int) -> None:
        for hole in contents.holes:
            self._scan.losses.note(Malformed(f"chunk at byte {start}", hole.fault.message, certain=hole.fault.certain))

    def _reaches_over_chunk(self, after: int) -> bool:
        stream = self._stream
        inner = resync.find_inner(stream.window, stream.at, after, stream.left)
        return resync.holds_chunk(stream.window, stream.at + 1, after if inner is None else inner, stream.left - 1)

    def _is_followed(self, total: int) -> bool:
        stream = self._stream
        return resync.stands_outside_chunks(stream.window, stream.at + total, stream.left - total)

    def _search(self) -> None:
        resync.skip_damage(self._stream, self._scan.facts.channels, self._scan.losses)
        self._is_resynced = True

    def _pass(self, total: int) -> None:
        """Skip a record; if no record can begin after it, its length is wrong, and the search begins inside it."""
        stream, scan = self._stream, self._scan
        wrong = resync.fault_in_window(stream.window, stream.at + total, stream.left - total)
        if wrong is None:
            stream.advance(total)
            return
        if stream.window[stream.at] == Opcode.STATISTICS:
            scan.facts.statistics = None  # bytes of it are missing
        scan.losses.wasted_bytes += total if total > LOOK else 0
        self._resync(Malformed(f"byte {stream.position + total}", wrong), valid_bytes=total)

    def _pass_attachment(self, length: int, where: str) -> None:
        stream = self._stream
        body_at = stream.at + RECORD_HEAD.size
        records.read_attachment(self._scan.facts, bytes(stream.window[body_at : body_at + min(length, WINDOW)]), where)
        stream.advance(RECORD_HEAD.size)
        crc = stream.digest(length - _U32.size)
        (claimed,) = _U32.unpack(stream.read_up_to(_U32.size))
        if claimed and claimed != crc:
            self._scan.losses.note(Malformed(f"attachment at {where}", "its checksum is wrong"))

    def _pass_data_end(self, total: int, where: str) -> None:
        stream, losses = self._stream, self._scan.losses
        (claimed,) = _U32.unpack_from(stream.window, stream.at + RECORD_HEAD.size)
        if self._data_end is None and claimed and claimed != stream.crc() and not losses.damage:
            message = "its checksum is wrong: some of its bytes are not as they were written"
            losses.note(Malformed(f"data section (to {where})", message))
            # Whole records may be gone without a trace.
            losses.messages_are_known = False
        stream.advance(total)
        stream.restart_crc()
        self._data_end = stream.position

    def _pass_footer(self, where: str) -> None:
        """Read the footer and the magic after it."""
        stream, losses = self._stream, self._scan.losses
        body_at = stream.at + RECORD_HEAD.size
        summary_start, _offsets_start, claimed = records.FOOTER_BODY.unpack_from(stream.window, body_at)
        stream.advance(RECORD_HEAD.size + records.FOOTER_BODY.size - _U32.size)
        if claimed and summary_start == self._data_end and claimed != stream.crc() and not losses.damage:
            losses.note_index(Malformed(where, "the checksum of the summary section is wrong"))
        stream.advance(_U32.size + len(records.MAGIC))
        if stream.left:
            # It may be the footer of a file inside this one, which a search has found, so the scan continues.
            losses.note(Malformed(f"byte {stream.position}", f"{stream.left} bytes follow its end"))

    def _walk_unchunked(self) -> int:
        """Take all unchunked messages in the window, and skip all but the last; return the size of that one, or 0."""
        stream = self._stream
        after, last = walk_messages(stream.window, stream.at, len(stream.window), self._unchunked)
        self._note_unchunked(after - stream.at)
        self._pass_unchunked(last - stream.at)
        return after - last

    def _take_large_message(self) -> None:
        """Take a message outside of chunks of which only the head is in the window; skips nothing."""
        stream = self._stream
        head = stream.window[stream.at : stream.at + MESSAGE_HEAD.size]
        if len(head) < MESSAGE_HEAD.size or MESSAGE_HEAD.unpack(head)[1] < MESSAGE_FIXED:
            raise Malformed(f"byte {stream.position}", "a message that is too short to be one")
        _opcode, length, channel_id, _sequence, log_time, publish_time = MESSAGE_HEAD.unpack(head)
        self._unchunked[channel_id].extend((log_time, publish_time, RECORD_HEAD.size + length))
        self._note_unchunked(RECORD_HEAD.size + length)
        self._pass_unchunked(0)

    def _note_unchunked(self, length: int) -> None:
        """Add the messages in the next `length` bytes to the chunk table."""
        if self._builder is not None and length:
            location = MessageLocation(LocationKind.records, self._stream.position, length, length)
            self._builder.add(location, self._unchunked)
            self._flush()  # what the batch holds next is somewhere else

    def _pass_unchunked(self, length: int) -> None:
        self._stream.advance(length)
        self._unchunked_bytes += length
        if self._unchunked_bytes > _FLUSH_BYTES:
            self._flush()

    def _flush(self) -> None:
        """Count the messages outside of chunks that were taken."""
        facts, counter = self._scan.facts, self._scan.counter
        counter.learn(facts.channels)
        counter.add(self._unchunked)
        self._unchunked, self._unchunked_bytes = Batch(facts.channels), 0


def scan_records(
    reader: SequentialReader,
    builder: ChunkTableBuilder | None = None,
    channels: Mapping[int, ChannelRecord] | None = None,
) -> McapScan:
    """Scan a whole file; its content never raises. `channels`: known before, for a part that defines none."""
    return _McapScanner(reader, builder, channels or {}).run()
