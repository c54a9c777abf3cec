"""Sources for tests: bytes in memory, and sparse files that are never stored."""

from __future__ import annotations

import io
from bisect import bisect_right
from pathlib import PurePosixPath

from kleinkram.recordings.sources import check_range


class MemorySource:
    """A source over bytes."""

    def __init__(self, data: bytes, name: str = "test.mcap") -> None:
        self._data = data
        self.name = PurePosixPath(name).name
        self.size_bytes = len(data)

    def read(self, offset: int, length: int) -> bytes:
        check_range(self, offset, length)
        return self._data[offset : offset + length]


class SparseFile(io.RawIOBase):
    """A file to write into that keeps no run of zeros above 64 KB, and a source over what was written."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self._starts: list[int] = []
        self._pieces: list[bytes] = []
        self.size_bytes = 0
        self._position = 0

    def seek(self, offset: int, whence: int = 0) -> int:
        self._position = offset if whence == 0 else self.size_bytes
        return self._position

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]  # only bytes are written
        if self._position < self.size_bytes:
            number = self._starts.index(self._position)
            assert len(data) == len(self._pieces[number])
            self._pieces[number] = data
        elif len(data) < 65536 or data.count(0) < len(data) - 65536:
            self._starts.append(self._position)
            self._pieces.append(data)
        self._position += len(data)
        self.size_bytes = max(self.size_bytes, self._position)
        return len(data)

    def read(self, offset: int = 0, length: int = 0) -> bytes:
        check_range(self, offset, length)
        out = bytearray(length)
        number = max(0, bisect_right(self._starts, offset) - 1)
        while number < len(self._starts) and self._starts[number] < offset + length:
            start, piece = self._starts[number], self._pieces[number]
            number += 1
            part = piece[max(0, offset - start) : offset + length - start]
            out[max(0, start - offset) : max(0, start - offset) + len(part)] = part
        return bytes(out)
