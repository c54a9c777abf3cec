"""Recovers topics and messages from databases that SQLite calls malformed: cut, overwritten, or with invalid pages.

Rows are whole in leaf pages, whatever became of the tree above them. So every page is looked at once: leaf pages
that hold rows of the shape of messages are brought into the order of their row ids and read; a row whose data goes on
in other pages counts only if all of those are there. rosbag2 numbers messages without gaps and deletes none, so row
ids tell how many are missing. Holds 8 bytes a leaf page.

What cannot be seen: a flipped byte inside of a message's data; SQLite keeps no checksums.
"""

from __future__ import annotations

import struct
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.recordings.chunk_reader import MAX_MESSAGE
from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.errors import Malformed, SourceError
from kleinkram.recordings.formats.base import ChunkedMember, MemberContents
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.chunks import MESSAGE_FIELDS, table_of_records
from kleinkram.recordings.formats.mcap.format import MCAP_CHUNKS
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.formats.rosbag2 import pages
from kleinkram.recordings.formats.rosbag2.database import MessageRow, TopicRow
from kleinkram.recordings.formats.rosbag2.pages import Cell, Column, PageFile
from kleinkram.recordings.limits import MAX_NAME, MAX_TOPICS
from kleinkram.recordings.messages import Channel, Schema
from kleinkram.recordings.model import counted
from kleinkram.recordings.sources import FileSource
from kleinkram.recordings.streams import open_range
from kleinkram.recordings.temporary_files import TooLarge, temporary_copy

_MAX_SORTED_PAGES = 2_000_000
_PAGE_BITS = 32
_MOST_ROW_ID = 2**31
_LEAST_ROW_BYTES = 16
_SCHEMA_COLUMNS = 5
_LEAST_TOPIC_COLUMNS = 3
_U32 = struct.Struct(">I")


@dataclass
class Recovered:
    """The result of a recovery, complete once `Recovery.messages` is exhausted.

    Attributes:
        claimed_bytes: the size that the file should have by its own header; its real size where that says nothing.
        damaged_pages: pages that are invalid data, or of which rows cannot be read.
        damaged_bytes: bytes of these pages, and of messages that are cut.
        cut_messages: messages that begin and whose data is not all there.
        lost_messages: how many are missing for sure, from the gaps in the numbers of the rows.
        is_exact: no more than those are missing, because the last row that was written is there.
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
    """Reads a damaged database; use it in a `with`.

    Raises:
        Malformed: not even the header is there.
        SourceError: the file cannot be read.
    """

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

    def messages_with_data(self, most_bytes: int) -> Iterator[tuple[MessageRow, bytes]]:
        """Yield what `messages` yields, with the data; messages above `most_bytes` are left out."""
        for row, page, place in self._whole_rows():
            if row.data_bytes <= most_bytes:
                cell, column = place
                yield row, self._payload(page, cell)[column.at : column.at + column.length]

    def _whole_rows(self) -> Iterator[tuple[MessageRow, bytes, tuple[Cell, Column]]]:
        in_order = _sort(self._leaves)
        previous, count = 0, 0
        mask = (1 << _PAGE_BITS) - 1
        for key in self._leaves:
            for row, page, place in self._rows_of_page(key & mask):
                row_id = place[0].row_id
                if in_order and row_id <= previous:
                    continue  # a copy of a page that the file no longer means
                previous = max(previous, row_id)
                count += 1
                yield row, page, place
        self._measure(previous, count)

    def _survey(self) -> None:
        """Find the leaf pages of messages, the topics, and invalid pages."""
        free = self._file.free_pages()
        for number in range(1, self._file.whole_pages + 1):
            if number not in free:
                self._look_at(number, self._file.page(number))
        tail = self._file.size_bytes % self._file.header.page_bytes
        if tail:
            self.result.damaged_pages += 1
            self.result.damaged_bytes += tail
        self.result.topics = [self._topics[topic_id] for topic_id in sorted(self._topics)]

    def _look_at(self, number: int, page: bytes) -> None:
        kind = page[pages.HEADER_BYTES if number == 1 else 0]
        if kind == pages.LEAF_TABLE:
            self._look_at_leaf(number, page)
        elif kind == 0:
            # Pages of data begin with the number of the next one, and those of the freelist too.
            if not any(page):
                self._note(number, "it is all zeros")
        elif kind not in (pages.INTERIOR_TABLE, pages.INTERIOR_INDEX, pages.LEAF_INDEX) and number < 1 << 24:
            self._note(number, "it is of no kind that there is")

    def _look_at_leaf(self, number: int, page: bytes) -> None:
        """Note a leaf page of messages, or read topics and roots from another leaf page."""
        try:
            for cell, columns in self._cells(number, page):
                if _is_message(columns):
                    self._leaves.append(min(max(cell.row_id, 0), _MOST_ROW_ID) << _PAGE_BITS | number)
                    return
                self._look_at_row(page, cell, columns)
        except Malformed as error:
            self._note(number, error.message)

    def _look_at_row(self, page: bytes, cell: Cell, columns: list[Column]) -> None:
        texts = [self._text(page, cell, column) if pages.is_text(column) else "" for column in columns[:4]]
        if len(columns) == _SCHEMA_COLUMNS and texts[0] == "table" and pages.is_integer(columns[3]):
            self._roots.setdefault(texts[1], pages.read_integer(columns[3], page, cell.at))
        elif len(columns) >= _LEAST_TOPIC_COLUMNS and columns[0].serial == 0 and texts[1] and "/" in texts[2]:
            encoding = texts[3] if len(texts) > _LEAST_TOPIC_COLUMNS else ""
            if len(self._topics) < MAX_TOPICS:
                self._topics.setdefault(cell.row_id, TopicRow(cell.row_id, texts[1], texts[2], encoding))

    def _text(self, page: bytes, cell: Cell, column: Column) -> str:
        """Return a text as far as it is in the leaf page."""
        end = min(column.at + min(column.length, MAX_NAME), cell.local_bytes)
        return page[cell.at + column.at : cell.at + end].decode("utf-8", "replace")

    def _payload(self, page: bytes, cell: Cell) -> bytes:
        """Return the payload of a whole row, with its overflow pages."""
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
                elif cell.overflow_page and not self._is_whole(cell):
                    self.result.cut_messages += 1
                    self.result.damaged_bytes += cell.local_bytes
                else:
                    topic_id = pages.read_integer(columns[1], page, cell.at)
                    timestamp = pages.read_integer(columns[2], page, cell.at)
                    yield MessageRow(topic_id, timestamp, columns[3].length), page, (cell, columns[3])
        except Malformed as error:
            self._note(number, error.message)

    def _cells(self, number: int, page: bytes) -> Iterator[tuple[Cell, list[Column]]]:
        """Yield the readable rows of a leaf page; note a page with others."""
        start = pages.HEADER_BYTES if number == 1 else 0
        for cell in pages.leaf_cells(page, start, self._file.header.usable_bytes):
            end = cell.at + cell.local_bytes if cell is not None else 0
            columns = pages.read_columns(page, cell.at, end, cell.payload_bytes) if cell is not None else None
            if cell is None or columns is None:
                self._note(number, "a row of it cannot be read")
            else:
                yield cell, columns

    def _is_whole(self, cell: Cell) -> bool:
        """Return whether all overflow pages of a row are there.

        A page belongs to one row only, so that all of this takes no more steps than the file has pages.
        """
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
        if numbered <= self.result.claimed_bytes // _LEAST_ROW_BYTES:
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
    """Open a recovered database; its temporary file is removed with the stack.

    Raises:
        SourceError: it cannot be read, or there is no room for the temporary file.
    """
    counts: dict[int, int] = defaultdict(int)
    channels: dict[int, Channel] = {}
    try:
        with Recovery(path, name) as recovery:
            numbers = {topic.topic_id: number for number, topic in enumerate(recovery.result.topics)}
            channels = {
                number: Channel(
                    topic.name,
                    topic.serialization_format or "cdr",
                    Schema(topic.message_type, "", b""),
                    message_compression,
                )
                for number, topic in enumerate(recovery.result.topics)
            }
            copy = stack.enter_context(temporary_copy(_reading(_records(recovery, numbers, counts))))
            result = recovery.result
            lost = counted(result.lost_messages, "message is", "messages are")
            message = f"{result.first_damage or 'it is damaged'}; at least {lost} lost"
            problem_log.add("damaged", f"{name}: pages", message)
    except Malformed as error:
        problem_log.add("damaged", f"{name}: pages", f"nothing of it can be read: {error}")
        copy = stack.enter_context(temporary_copy(lambda _: b""))
    except TooLarge as error:
        raise SourceError(f"{name}: {error}") from error
    source = stack.enter_context(FileSource(copy))
    table = table_of_records(open_range(source, 0, source.size_bytes))
    contents = MemberContents(channels, counts, sum(counts.values()), *table.span())
    return ChunkedMember(source, MCAP_CHUNKS, table, contents, problem_log)


def _records(recovery: Recovery, numbers: dict[int, int], counts: dict[int, int]) -> Iterator[bytes]:
    """Yield each message as an MCAP record, without those of undefined topics."""
    for row, data in recovery.messages_with_data(MAX_MESSAGE):
        number = numbers.get(row.topic_id)
        if number is None or not 0 <= row.timestamp <= _LATEST_NS:
            continue
        counts[number] += 1
        head = MESSAGE_FIELDS.pack(number, 0, row.timestamp, row.timestamp)
        yield records.RECORD_HEAD.pack(Opcode.MESSAGE, len(head) + len(data)) + head + data


def _reading(pieces: Iterator[bytes]) -> Callable[[int], bytes]:
    """Return a function that returns the next piece of any size; b"" at the end."""
    return lambda _most: next(pieces, b"")
