"""A recording's bytes from the first to the last, once: what a scan reads.

Three origins: any `Source`, a local file, and a pipe into which somebody else writes (a server that hashes the same
bytes meanwhile). None holds more than one block, none can go back.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Protocol

from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.limits import MAX_READ, READ_AHEAD
from kleinkram.recordings.sources import FileSource, Source, read_ranges


class Forward(Protocol):
    """The bytes of one file in order."""

    @property
    def name(self) -> str:
        """For messages, and for the extension that a file claims; never opened."""

    @property
    def size_bytes(self) -> int:
        """The size of the whole file; fixed while it is read."""

    @property
    def path(self) -> Path | None:
        """Where the same bytes stand on this machine, for formats that need more than one pass; None: nowhere."""

    def read(self, length: int) -> bytes:
        """Return the next bytes, at least one and at most `length`; b"" behind the last of `size_bytes`.

        Raises:
            SourceError: they cannot be had, or end before `size_bytes`.
        """


class SourceForward:
    """A source read from its start; over a network, the next blocks are already under way."""

    def __init__(self, source: Source, *, path: Path | None = None) -> None:
        self.name = source.name
        self.size_bytes = source.size_bytes
        self.path = path
        self._source = source
        self._is_near = getattr(source, "parallel_reads", 1) == 1
        self._blocks = self._read(source)
        self._block = b""
        self._at = 0

    @staticmethod
    def _read(source: Source) -> Iterator[bytes]:
        size, step = source.size_bytes, min(READ_AHEAD, MAX_READ)
        return read_ranges(source, ((start, min(step, size - start)) for start in range(0, size, step)))

    def read(self, length: int) -> bytes:
        """Return the next bytes; b"" at the end."""
        if self._is_near:
            return self._read_near(min(length, MAX_READ, self.size_bytes - self._at))
        if self._at == len(self._block):
            self._block, self._at = next(self._blocks, b""), 0
        whole = self._at == 0 and length >= len(self._block)
        piece = self._block if whole else self._block[self._at : self._at + length]
        self._at += len(piece)
        return piece

    def _read_near(self, length: int) -> bytes:
        """Read what is asked for and no more, so that it is still in the processor's cache when it is used."""
        piece = self._source.read(self._at, length) if length else b""
        self._at += length
        return piece


class FileForward(SourceForward):
    """A local file. Close it, or use it in a `with`.

    Raises:
        SourceError: the file cannot be opened.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._file = FileSource(path)
        super().__init__(self._file, path=Path(path))

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def __enter__(self) -> FileForward:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class PipeForward:
    """The next `size_bytes` bytes of a stream; what follows them stays in it."""

    path = None

    def __init__(self, stream: BinaryIO, *, size_bytes: int, name: str) -> None:
        self.name = name
        self.size_bytes = size_bytes
        self._stream = stream
        self._left = size_bytes

    def read(self, length: int) -> bytes:
        """Return the next bytes; b"" at the end."""
        length = min(length, self._left)
        if length == 0:
            return b""
        try:
            piece = self._stream.read(length)
        except OSError as error:
            raise SourceError(f"{self.name}: cannot be read: {error.strerror}") from error
        if not piece:
            raise SourceError(f"{self.name}: its bytes end {self._left} before the {self.size_bytes} announced")
        self._left -= len(piece)
        return piece


class _Rewound:
    """A forward whose first bytes were looked at already."""

    def __init__(self, head: bytes, rest: Forward) -> None:
        self.name = rest.name
        self.size_bytes = rest.size_bytes
        self.path = rest.path
        self._head = head
        self._rest = rest

    def read(self, length: int) -> bytes:
        """Return the next bytes; b"" at the end."""
        if not self._head:
            return self._rest.read(length)
        piece, self._head = self._head[:length], self._head[length:]
        return piece


def peek(forward: Forward, length: int) -> tuple[bytes, Forward]:
    """Return the first bytes, at most `length`, and what still begins with them. `forward` itself is used up."""
    pieces: list[bytes] = []
    have, length = 0, min(length, forward.size_bytes)
    while have < length and (piece := forward.read(length - have)):
        pieces.append(piece)
        have += len(piece)
    head = b"".join(pieces)
    return head, _Rewound(head, forward)


def from_source(source: Source) -> Forward:
    """Read a source forward."""
    return SourceForward(source, path=source.path if isinstance(source, FileSource) else None)


def from_file(path: str | os.PathLike[str]) -> FileForward:
    """Read a local file forward; use it in a `with`.

    Raises:
        SourceError: the file cannot be opened.
    """
    return FileForward(path)


def from_pipe(stream: BinaryIO, size_bytes: int, name: str) -> Forward:
    """Read exactly `size_bytes` bytes of a stream forward. `name` is the file's own, for messages and extension."""
    return PipeForward(stream, size_bytes=size_bytes, name=name)
