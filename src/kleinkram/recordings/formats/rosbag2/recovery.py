"""Recovers topics and messages from databases that SQLite calls malformed: cut, overwritten, or with invalid pages.

Leaf pages contain complete rows, even if the tree above them is damaged. Every page is read once; leaf pages with rows
of the shape of messages are sorted by row id (8 bytes a page). A row counts if all its overflow pages exist. rosbag2
numbers messages without gaps and deletes none, so row ids show how many are missing. A flipped byte in the data of a
message is not found, because SQLite has no checksums.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.recordings.chunk_reader import MAX_MESSAGE, ChunkedMember
from kleinkram.recordings.chunk_table import ChunkTableBuilder
from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.errors import Malformed, SourceError
from kleinkram.recordings.formats.base import MemberContents
from kleinkram.recordings.formats.mcap.chunks import MESSAGE_FIXED, MESSAGE_HEAD
from kleinkram.recordings.formats.mcap.format import MCAP_CHUNKS
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.formats.rosbag2 import pages
from kleinkram.recordings.formats.rosbag2.database import MessageRow, TopicRow, read_properties
from kleinkram.recordings.formats.rosbag2.pages import Cell, Column, PageFile
from kleinkram.recordings.limits import MAX_NAME, MAX_TOPICS
from kleinkram.recordings.messages import Channel, Schema
from kleinkram.recordings.model import counted
from kleinkram.recordings.scanned_messages import Batch, LocationKind, MessageLocation
from kleinkram.recordings.sources import FileSource
from kleinkram.recordings.temporary_files import TooLarge, temporary_copy

_MAX_SORTED_PAGES = 2_000_000
_PAGE_BITS = 32
_MAX_ROW_ID = 2**31
_MIN_ROW_BYTES = 16
_SCHEMA_COLUMNS = 5
_MIN_TOPIC_COLUMNS = 3
_U32 = struct.Struct(">I")


@dataclass
class Recovered:
    """The result of a recovery, complete once `Recovery.messages` is exhausted.

    Attributes:
        claimed_bytes: the file's size by its header; its real size without one.
        damaged_pages: pages that are invalid, or of which rows cannot be read.
        damaged_bytes: of these pages, and of messages that are cut.
        lost_messages: at least missing, by the gaps in the row ids; exact if `is_exact`, where the last row exists.
    """

    size_bytes: int
    claimed_bytes: int
    damaged_pages: int = 0
    damaged_bytes: int = 0
    cut_messages: int = 0
    lost_messages: int = 0
    is_exact: bool = False
    first_damage: str = ""
    topics: list[TopicRow] = field(default_factory=list)


class Recovery:
    """Reads a damaged database; use it in a `with`. `Malformed` if not even the header is there."""

    def __init__(self, path: Path, name: str) -> None:
        self._file = PageFile(path, name)
        header = self._file.header
        size = self._file.size_bytes
        self.result = Recovered(size, header.page_count * header.page_bytes or size)
        self._damaged: set[int] = set()
        self._topics: dict[int, TopicRow] = {}
        self._leaves = array("Q")
        self._roots: dict[str, int] = {}
        self._overflow_left = self._file.whole_pages

    def __enter__(self) -> Recovery:
        self._survey()
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def messages(self) -> Iterator[MessageRow]:
        """Yield every whole message, by row id."""
        return (row for row, _, _ in self._whole_rows())

    def messages_with_data(self, max_bytes: int) -> Iterator[tuple[MessageRow, bytes]]:
        """Yield what `messages` yields, with the data; messages above `max_bytes` are left out."""
        for row, page, location in self._whole_rows():
            if row.data_bytes <= max_bytes:
                cell, column = location
                yield row, self._payload(page, cell)[column.at : column.at + column.length]

    def _whole_rows(self) -> Iterator[tuple[MessageRow, bytes, tuple[Cell, Column]]]:
        in_order = _sort(self._leaves)
        previous, count = 0, 0
        mask = (1 << _PAGE_BITS) - 1
        for key in self._leaves:
            for row, page, location in self._rows_of_page(key & mask):
                row_id = location[0].row_id
                if in_order and row_id <= previous:
                    continue  # a copy of a page that the file no longer means
                previous = max(previous, row_id)
                count += 1
                yield row, page, location
        self._measure(previous, count)

    def _survey(self) -> None:
        """Find the leaf pages of messages, the topics, and invalid pages."""
        free = self._file.free_pages()
        for number in range(1, self._file.whole_pages + 1):
            if number in free:
                continue
            page = self._file.page(number)
            kind = page[pages.HEADER_BYTES if number == 1 else 0]
            if kind == pages.LEAF_TABLE:
                self._survey_leaf(number, page)
            elif kind == 0:
                # Pages of data begin with the number of the next one, and those of the freelist too.
                if not any(page):
                    self._note(number, "it is all zeros")
            elif kind not in (pages.INTERIOR_TABLE, pages.INTERIOR_INDEX, pages.LEAF_INDEX) and number < 1 << 24:
                self._note(number, "it is of no kind that there is")
        tail = self._file.size_bytes % self._file.header.page_bytes
        if tail:
            self.result.damaged_pages += 1
            self.result.damaged_bytes += tail
        self.result.topics = [self._topics[topic_id] for topic_id in sorted(self._topics)]

    def _survey_leaf(self, number: int, page: bytes) -> None:
        """Note a leaf page of messages, or read topics and roots from another leaf page."""
        try:
            for cell, columns in self._cells(number, page):
                if _is_message(columns):
                    self._leaves.append(min(max(cell.row_id, 0), _MAX_ROW_ID) << _PAGE_BITS | number)
                    return
                self._read_row(page, cell, columns)
        except Malformed as error:
            self._note(number, error.message)

    def _read_row(self, page: bytes, cell: Cell, columns: list[Column]) -> None:
        texts = [self._text(page, cell, column) if pages.is_text(column) else "" for column in columns]
        if len(columns) == _SCHEMA_COLUMNS and texts[0] == "table" and pages.is_integer(columns[3]):
            self._roots.setdefault(texts[1], pages.read_integer(columns[3], page, cell.at))
        elif len(columns) >= _MIN_TOPIC_COLUMNS and columns[0].serial == 0 and texts[1] and "/" in texts[2]:
            encoding = texts[3] if len(texts) > _MIN_TOPIC_COLUMNS else ""
            if len(self._topics) < MAX_TOPICS:
                whole = [text if column.length <= MAX_NAME else "" for text, column in zip(texts, columns, strict=True)]
                row = TopicRow(cell.row_id, texts[1], texts[2], encoding, read_properties(whole[4:]))
                self._topics.setdefault(cell.row_id, row)

    def _text(self, page: bytes, cell: Cell, column: Column) -> str:
        """Return a text as far as it is in the leaf page."""
        end = min(column.at + min(column.length, MAX_NAME), cell.local_bytes)
        return page[cell.at + column.at : cell.at + end].decode("utf-8", "replace")

    def _payload(self, page: bytes, cell: Cell) -> bytes:
        pieces = [page[cell.at : cell.at + cell.local_bytes]]
        left, number = cell.payload_bytes - cell.local_bytes, cell.overflow_page
        while left > 0:
            more = self._file.page(number)
            (number,) = _U32.unpack_from(more)
            pieces.append(more[4 : min(self._file.header.usable_bytes, 4 + left)])
            left -= len(pieces[-1])
        return b"".join(pieces)

    def _rows_of_page(self, number: int) -> Iterator[tuple[MessageRow, bytes, tuple[Cell, Column]]]:
        page = self._file.page(number)
        try:
            for cell, columns in self._cells(number, page):
                if not _is_message(columns):
                    self._note(number, "a row of it is no message")
                elif cell.overflow_page and not self._is_complete(cell):
                    self.result.cut_messages += 1
                    self.result.damaged_bytes += cell.local_bytes
                else:
                    topic_id = pages.read_integer(columns[1], page, cell.at)
                    timestamp = pages.read_integer(columns[2], page, cell.at)
                    yield MessageRow(topic_id, timestamp, columns[3].length), page, (cell, columns[3])
        except Malformed as error:
            self._note(number, error.message)

    def _cells(self, number: int, page: bytes) -> Iterator[tuple[Cell, list[Column]]]:
        start = pages.HEADER_BYTES if number == 1 else 0
        for cell in pages.leaf_cells(page, start, self._file.header.usable_bytes):
            end = cell.at + cell.local_bytes if cell is not None else 0
            columns = pages.read_columns(page, cell.at, end, cell.payload_bytes) if cell is not None else None
            if cell is None or columns is None:
                self._note(number, "a row of it cannot be read")
            else:
                yield cell, columns

    def _is_complete(self, cell: Cell) -> bool:
        """Return whether all overflow pages of a row are there."""
        usable = self._file.header.usable_bytes
        left = cell.payload_bytes - cell.local_bytes
        number = cell.overflow_page
        while left > 0:
            self._overflow_left -= 1
            if self._overflow_left < 0 or not 1 <= number <= self._file.whole_pages:
                return False
            (following,) = _U32.unpack_from(self._file.page(number))
            left -= usable - 4
            number = following
        return number == 0

    def _note(self, number: int, what: str) -> None:
        if number in self._damaged:
            return
        self._damaged.add(number)
        self.result.damaged_pages += 1
        self.result.damaged_bytes += self._file.header.page_bytes
        if not self.result.first_damage:
            self.result.first_damage = f"page {number} is damaged: {what}"

    def _measure(self, highest: int, count: int) -> None:
        leaf, key = self._file.last_leaf(self._roots.get("messages", 0))
        numbered = max(highest, key)
        # A number that no file of this size can have reached is itself damage.
        if numbered <= self.result.claimed_bytes // _MIN_ROW_BYTES:
            self.result.lost_messages = max(numbered - count, 0)
            self.result.is_exact = leaf > 0 and leaf not in self._damaged
        self.result.lost_messages = max(self.result.lost_messages, self.result.cut_messages)


def _is_message(columns: list[Column]) -> bool:
    """Return whether a row has the shape (id, topic_id, timestamp, data) of a message."""
    return (
        len(columns) == 4
        and columns[0].serial == 0
        and pages.is_integer(columns[1])
        and pages.is_integer(columns[2])
        and (columns[3].serial >= 12 and columns[3].serial % 2 == 0)
    )


def _sort(leaves: array[int]) -> bool:
    """Sort pages by their first row; False if they are too many to be sorted."""
    if all(leaves[number] <= leaves[number + 1] for number in range(len(leaves) - 1)):
        return True
    if len(leaves) > _MAX_SORTED_PAGES:
        return False
    leaves[:] = array("Q", sorted(leaves))
    return True


_LATEST_NS = 2**63 - 1


def open_recovered(
    path: Path, name: str, problem_log: ProblemLog, stack: ExitStack, *, message_compression: str = ""
) -> ChunkedMember:
    """Open a recovered database by a temporary file of MCAP message records, which is removed with the stack."""
    channels: dict[int, Channel] = {}
    builder = ChunkTableBuilder(problem_log)
    try:
        with Recovery(path, name) as recovery:
            result = recovery.result
            for number, topic in enumerate(result.topics):
                schema, encoding = Schema(topic.message_type, "", b""), topic.serialization_format or "cdr"
                channels[number] = Channel(topic.name, encoding, schema, message_compression, topic.properties)
            pieces = _records(recovery, channels, builder)
            copy = stack.enter_context(temporary_copy(lambda _most: next(pieces, b"")))
            lost = counted(result.lost_messages, "message is", "messages are")
            message = f"{result.first_damage or 'it is damaged'}; at least {lost} lost"
            problem_log.add("damaged", f"{name}: pages", message)
    except Malformed as error:
        problem_log.add("damaged", f"{name}: pages", f"nothing of it can be read: {error}")
        copy = stack.enter_context(temporary_copy(lambda _: b""))
    except TooLarge as error:
        raise SourceError(f"{name}: {error}") from error
    builder.close()
    contents = MemberContents(channels, builder.counts, sum(builder.counts.values()), *builder.table.span())
    source = stack.enter_context(FileSource(copy))
    return ChunkedMember(source, MCAP_CHUNKS, builder.table, contents, problem_log)


def _records(recovery: Recovery, channels: dict[int, Channel], builder: ChunkTableBuilder) -> Iterator[bytes]:
    """Yield each message as an MCAP record, without those of undefined topics, and note its location."""
    numbers = {topic.topic_id: number for number, topic in enumerate(recovery.result.topics)}
    start = 0
    for row, data in recovery.messages_with_data(MAX_MESSAGE):
        number, time = numbers.get(row.topic_id), row.timestamp
        if number is None or not 0 <= time <= _LATEST_NS:
            continue
        length = MESSAGE_HEAD.size + len(data)
        batch = Batch(channels)
        batch[number].extend((time, time, length))
        builder.add(MessageLocation(LocationKind.records, start, length, length), batch)
        start += length
        yield MESSAGE_HEAD.pack(Opcode.MESSAGE, MESSAGE_FIXED + len(data), number, 0, time, time) + data
