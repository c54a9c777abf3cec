"""Reads SQLite pages without SQLite, for databases that SQLite calls malformed.

Every number in a page is only a claim: nothing is read beyond the page and the file, chains of pages are followed no
further than the file has pages. Holds one window of the file.

Source: sqlite.org/fileformat2.html, sections 1.3 (header), 1.5 (freelist), 1.6 (b-tree pages), 2.1 (records).
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from kleinkram.recordings.errors import Malformed, SourceError
from kleinkram.recordings.limits import WINDOW

MAGIC = b"SQLite format 3\0"
HEADER_BYTES = 100
INTERIOR_TABLE, LEAF_TABLE = 0x05, 0x0D
INTERIOR_INDEX, LEAF_INDEX = 0x02, 0x0A
DEFAULT_PAGE_BYTES = 4096
_MAX_LEVELS = 20
_FIXED_BYTES = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 7: 8, 8: 0, 9: 0}
_U16 = struct.Struct(">H")
_U32 = struct.Struct(">I")


class Header(NamedTuple):
    """The first 100 bytes. `usable_bytes`: of a page; `page_count`: 0 if unknown."""

    page_bytes: int
    usable_bytes: int
    page_count: int
    freelist_page: int
    freelist_count: int


class Cell(NamedTuple):
    """A row of a leaf page; `local_bytes` of its payload, from `at`, are in the page itself."""

    row_id: int
    payload_bytes: int
    at: int
    local_bytes: int
    overflow_page: int


class Column(NamedTuple):
    """A column of a record: its serial type, and the offset of its value in the payload."""

    serial: int
    at: int
    length: int


def read_header(head: bytes) -> Header:
    """Read the database header; an invalid page size becomes the default."""
    if len(head) < HEADER_BYTES or not head.startswith(MAGIC):
        raise Malformed("byte 0", "the header of the database is not whole")
    (page_bytes,) = _U16.unpack_from(head, 16)
    page_bytes = 65536 if page_bytes == 1 else page_bytes
    if page_bytes < 512 or page_bytes & (page_bytes - 1):
        page_bytes = DEFAULT_PAGE_BYTES
    reserved = head[20] if page_bytes - head[20] >= 480 else 0
    changed, valid_for = _U32.unpack_from(head, 24)[0], _U32.unpack_from(head, 92)[0]
    (page_count,) = _U32.unpack_from(head, 28)
    freelist_page, freelist_count = struct.unpack_from(">II", head, 32)
    return Header(
        page_bytes, page_bytes - reserved, page_count if changed == valid_for else 0, freelist_page, freelist_count
    )


class PageFile:
    """The pages of a file, numbered from 1; `whole_pages` are there to their last byte. Use it in a `with`."""

    def __init__(self, path: Path, name: str) -> None:
        self._name = name
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError as error:
            raise SourceError(f"{name}: cannot be opened: {error.strerror}") from error
        self._window, self._window_at = b"", 0
        try:
            self.size_bytes = os.fstat(self._descriptor).st_size
            self.header = read_header(self._pread(HEADER_BYTES, 0))
        except BaseException:
            self.close()
            raise
        self.whole_pages = self.size_bytes // self.header.page_bytes

    def __enter__(self) -> PageFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)

    def page(self, number: int) -> bytes:
        """Return a page."""
        if not 1 <= number <= self.whole_pages:
            raise Malformed(f"page {number}", "it lies beyond the end of the file")
        size = self.header.page_bytes
        at = (number - 1) * size - self._window_at
        if 0 <= at <= len(self._window) - size:
            return self._window[at : at + size]
        if at != len(self._window):
            return self._pread(size, (number - 1) * size)  # pages in no order: a window for each would cost too much
        self._window_at += at
        self._window = self._pread(WINDOW, self._window_at)
        return self._window[:size]

    def _pread(self, length: int, offset: int) -> bytes:
        try:
            return os.pread(self._descriptor, length, offset)
        except OSError as error:
            raise SourceError(f"{self._name}: cannot be read at byte {offset}: {error.strerror}") from error

    def free_pages(self) -> set[int]:
        """Return the pages of the freelist, as far as it can be followed."""
        free: set[int] = set()
        trunk = self.header.freelist_page
        most = min(self.header.freelist_count, self.whole_pages, 1_000_000)
        while trunk and trunk not in free and len(free) < most:
            try:
                page = self.page(trunk)
            except Malformed:
                break
            free.add(trunk)
            trunk, count = struct.unpack_from(">II", page)
            count = min(count, len(page) // 4 - 2)
            free.update(struct.unpack_from(f">{count}I", page, 8))
        return free

    def last_leaf(self, root: int) -> tuple[int, int]:
        """Return the last leaf of the table at page `root` (0 if the tree is broken), and the largest key above it."""
        highest = 0
        number = root
        for _ in range(_MAX_LEVELS):
            try:
                page = self.page(number)
            except Malformed:
                break
            start = HEADER_BYTES if number == 1 else 0
            if page[start] == LEAF_TABLE:
                return number, highest
            if page[start] != INTERIOR_TABLE:
                break
            (count,) = _U16.unpack_from(page, start + 3)
            (number,) = _U32.unpack_from(page, start + 8)
            if count and start + 12 + 2 * count <= len(page):
                (at,) = _U16.unpack_from(page, start + 10 + 2 * count)
                if at + 13 <= len(page):
                    highest = max(highest, read_varint(page, at + 4)[0])
        return 0, highest


def read_varint(data: bytes, at: int) -> tuple[int, int]:
    """Return a number of 1 to 9 bytes (two's complement in 64 bits), and where it ends."""
    value = data[at]
    if value < 0x80:
        return value, at + 1
    value &= 0x7F
    for end in range(at + 1, at + 8):
        byte = data[end]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, end + 1
    value = value << 8 | data[at + 8]
    return value - (1 << 64) if value >> 63 else value, at + 9


def local_bytes(payload_bytes: int, usable_bytes: int) -> int:
    """Return how much of a payload is in the leaf page itself."""
    if payload_bytes <= usable_bytes - 35:
        return payload_bytes
    minimum = (usable_bytes - 12) * 32 // 255 - 23
    in_page = minimum + (payload_bytes - minimum) % (usable_bytes - 4)
    return in_page if in_page <= usable_bytes - 35 else minimum


def leaf_cells(page: bytes, start: int, usable_bytes: int) -> Iterator[Cell | None]:
    """Yield the rows of a table leaf page; None for an invalid one. `start`: of the page header."""
    (count,) = _U16.unpack_from(page, start + 3)
    first = start + 8 + 2 * count
    if first > usable_bytes:
        raise Malformed("page", "it claims more rows than it can hold")
    for at in struct.unpack_from(f">{count}H", page, start + 8):
        yield _read_cell(page, at, usable_bytes) if first <= at < usable_bytes else None


def _read_cell(page: bytes, at: int, usable_bytes: int) -> Cell | None:
    try:
        payload_bytes, at = read_varint(page, at)
        row_id, at = read_varint(page, at)
    except IndexError:
        return None
    if payload_bytes <= 0:
        return None
    local = local_bytes(payload_bytes, usable_bytes)
    end = at + local
    if local == payload_bytes:
        return Cell(row_id, payload_bytes, at, local, 0) if end <= usable_bytes else None
    if end + 4 > usable_bytes:
        return None
    (overflow,) = _U32.unpack_from(page, end)
    return Cell(row_id, payload_bytes, at, local, overflow)


def read_columns(data: bytes, at: int, end: int, payload_bytes: int) -> list[Column] | None:
    """Return the columns of the record that begins at `data[at]`; None if invalid, or if its header passes `end`."""
    try:
        header_bytes, offset = read_varint(data, at)
        if not 1 <= header_bytes <= end - at:
            return None
        columns: list[Column] = []
        value_at = header_bytes
        while offset < at + header_bytes:
            serial, offset = read_varint(data, offset)
            length = (serial - 12) // 2 if serial >= 12 else _FIXED_BYTES.get(serial, -1)
            if length < 0:
                return None
            columns.append(Column(serial, value_at, length))
            value_at += length
    except IndexError:
        return None
    return columns if offset == at + header_bytes and value_at == payload_bytes else None


def read_integer(column: Column, data: bytes, at: int) -> int:
    """Return the number in a column of serial type 1 to 6, 8 or 9; `at`: where the payload begins in `data`."""
    if column.serial >= 8:
        return column.serial - 8
    return int.from_bytes(data[at + column.at : at + column.at + column.length], "big", signed=True)


def is_integer(column: Column) -> bool:
    """Return whether a column holds a whole number."""
    return column.serial in (1, 2, 3, 4, 5, 6, 8, 9)


def is_text(column: Column) -> bool:
    """Return whether a column holds text."""
    return column.serial >= 13 and column.serial % 2 == 1
