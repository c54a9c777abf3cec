"""Byte sources: random access (`Source`) and sequential reading (`SequentialReader`).

Sources are safe to share between threads, hold no more than the bytes they return, and never read on their own.
"""

from __future__ import annotations

import os
import resource
import stat
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import BinaryIO, Generic, NamedTuple, Protocol, TypeVar

from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.limits import MAX_READ, READ_AHEAD

Read = Callable[[int], bytes]  # returns the next bytes, at most so many; b"" at the end


class Source(Protocol):
    """Random access to the bytes of one file."""

    @property
    def name(self) -> str:
        """For messages, and for the extension that a file claims; never opened."""

    @property
    def size_bytes(self) -> int:
        """The size of the file; fixed while it is read."""

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`, at most `MAX_READ`; raises `SourceError`, and nothing else."""


def check_range(source: Source, offset: int, length: int) -> None:
    """Raise `SourceError` for a range outside of a file, or of more than `MAX_READ`."""
    if length < 0 or length > MAX_READ:
        raise SourceError(f"{source.name}: {length} bytes requested at once; at most {MAX_READ} may be")
    if offset < 0 or offset + length > source.size_bytes:
        raise SourceError(f"{source.name}: bytes {offset}+{length} lie outside its {source.size_bytes} bytes")


class _OpenFiles:
    """Counts the files that stay open between reads: at most a quarter of what the process may open, and 256."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = 0

    def take(self) -> bool:
        """Return whether one more may stay open."""
        allowed, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        limit = MAX_OPEN_FILES if allowed == resource.RLIM_INFINITY else min(MAX_OPEN_FILES, allowed // 4)
        with self._lock:
            if self._count >= limit:
                return False
            self._count += 1
            return True

    def give_back(self) -> None:
        """Have one less open."""
        with self._lock:
            self._count -= 1


MAX_OPEN_FILES = 256
_open_files = _OpenFiles()


class FileSource:
    """A local file. Close it, or use it in a `with`. `SourceError` if it cannot be opened.

    Beyond a number of sources, those opened later open their file for each read, so that a mission of any size can be
    read at once.
    """

    parallel_reads = 1

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.name = self.path.name
        self._absolute = self.path.absolute()
        self._descriptor = -1
        self._is_closed = False
        descriptor = self._open()
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise SourceError(f"{path}: is not a regular file")
            self._file = status.st_dev, status.st_ino
            self.size_bytes = status.st_size
            self._modified_ns = status.st_mtime_ns
            if _open_files.take():
                self._descriptor, descriptor = descriptor, -1
        finally:
            if descriptor >= 0:
                os.close(descriptor)

    def _open(self) -> int:
        try:
            # Without O_NONBLOCK, opening a pipe would wait here for a writer.
            return os.open(self._absolute, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise SourceError(f"{self.path}: cannot be opened: {error.strerror}") from error

    @contextmanager
    def _opened_again(self) -> Iterator[int]:
        """Open the file for one read; `SourceError` if another has its name now."""
        if self._is_closed:
            raise SourceError(f"{self.name}: is closed")
        descriptor = self._open()
        try:
            status = os.fstat(descriptor)
            if (status.st_dev, status.st_ino) != self._file:
                raise SourceError(f"{self.name}: was replaced while it was read")
            yield descriptor
        finally:
            os.close(descriptor)

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`."""
        check_range(self, offset, length)
        if self._descriptor >= 0:
            return self._read(self._descriptor, offset, length)
        with self._opened_again() as descriptor:
            return self._read(descriptor, offset, length)

    def _read(self, descriptor: int, offset: int, length: int) -> bytes:
        pieces: list[bytes] = []
        while length:
            try:
                piece = os.pread(descriptor, length, offset)
            except OSError as error:
                raise SourceError(f"{self.name}: cannot be read at byte {offset}: {error.strerror}") from error
            if not piece:
                raise SourceError(f"{self.name}: became shorter than {self.size_bytes} bytes while it was read")
            pieces.append(piece)
            offset += len(piece)
            length -= len(piece)
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)

    def check_unchanged(self) -> None:
        """Raise `SourceError` if something was written to the file since it was opened."""
        if self._descriptor >= 0:
            status = os.fstat(self._descriptor)
        else:
            with self._opened_again() as descriptor:
                status = os.fstat(descriptor)
        if (status.st_size, status.st_mtime_ns) != (self.size_bytes, self._modified_ns):
            raise SourceError(f"{self.name}: changed while it was read; wait until no program writes to it")

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._is_closed = True
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
            _open_files.give_back()

    def __enter__(self) -> FileSource:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class CountingSource:
    """A source that counts bytes and reads."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._lock = threading.Lock()
        self.name = source.name
        self.size_bytes = source.size_bytes
        self.path: Path | None = getattr(source, "path", None)
        self.parallel_reads: int = getattr(source, "parallel_reads", 1)
        self.bytes_read = 0
        self.reads = 0

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`, and count them."""
        data = self._source.read(offset, length)
        with self._lock:
            self.reads += 1
            self.bytes_read += length
        return data

    def read_short(self, ranges: Iterable[tuple[int, int]]) -> Iterator[bytes]:
        """Yield the bytes of each (offset, length), and count them; see `read_short_ranges`."""
        for data in read_short_ranges(self._source, ranges):
            with self._lock:
                self.reads += 1
                self.bytes_read += len(data)
            yield data


def read_short_ranges(source: Source, ranges: Iterable[tuple[int, int]]) -> Iterator[bytes]:
    """Yield the bytes of each (offset, length), in order; over a network, the next ranges are requested in advance.

    A source that gains from it has a method `read_short`. For ranges of some kB.
    """
    read_short: Callable[[Iterable[tuple[int, int]]], Iterator[bytes]] | None = getattr(source, "read_short", None)
    if read_short is not None:
        yield from read_short(ranges)
        return
    for offset, length in ranges:
        yield source.read(offset, length)


T = TypeVar("T")


class ReadAheadTask(NamedTuple, Generic[T]):
    """A task, and the memory that its result takes."""

    size_bytes: int
    run: Callable[[], T]


def read_ahead(tasks: Iterator[ReadAheadTask[T]], *, workers: int, max_bytes: int, first_bytes: int = 0) -> Iterator[T]:
    """Yield the results of tasks, in order, while threads run the next ones; an exception is raised in this order.

    Results of `first_bytes` are read ahead at first, and twice as much with each result, up to `max_bytes`; by default
    the first task runs alone, because its result may be all that is wanted.

    Closed early, it returns at once: tasks that have begun run to their end, without effect.
    """
    from concurrent.futures import Future, ThreadPoolExecutor  # slow to import

    upcoming = next(tasks, None)
    if upcoming is None:
        return
    raise_malloc_threshold()
    allowance = first_bytes
    if not allowance:
        yield upcoming.run()
        allowance, upcoming = max(1, upcoming.size_bytes), next(tasks, None)
    pool = ThreadPoolExecutor(workers, thread_name_prefix="read-ahead")
    try:
        running: deque[tuple[int, Future[T]]] = deque()
        buffered_bytes = 0
        while upcoming is not None or running:
            allowance = min(max_bytes, 2 * allowance)
            while upcoming is not None and (not running or buffered_bytes + upcoming.size_bytes <= allowance):
                running.append((upcoming.size_bytes, pool.submit(upcoming.run)))
                buffered_bytes += upcoming.size_bytes
                upcoming = next(tasks, None)
            size, future = running.popleft()
            result = future.result()
            buffered_bytes -= size
            yield result
    finally:
        # The threads are not awaited here: the garbage collector may close this, in a thread that is being started,
        # and no thread could end then.
        pool.shutdown(wait=False, cancel_futures=True)


_LARGE_ALLOCATION = 24 * 2**20


@cache
def raise_malloc_threshold() -> None:
    """Make malloc keep up to 48 MB of freed memory for reuse, because fresh pages cost as much as decompression.

    glibc raises its threshold when a large allocation is freed, even an untouched one; other libraries ignore it. Once
    per process: a second such allocation would reuse memory and first fill it with zeros, which takes 1 ms. A
    `bytearray` always does, which takes 15 ms.

    Source: mallopt(3), M_MMAP_THRESHOLD, "dynamic mmap threshold".
    """
    bytes(_LARGE_ALLOCATION)


class SequentialReader(Protocol):
    """The bytes of one file from the first to the last, once."""

    @property
    def name(self) -> str:
        """For messages, and for the extension that a file claims; never opened."""

    @property
    def size_bytes(self) -> int:
        """The size of the whole file; fixed while it is read."""

    @property
    def path(self) -> Path | None:
        """The local file with the same bytes, for formats that need more than one pass; None: there is no such file."""

    def read(self, length: int) -> bytes:
        """Return the next bytes, at least one and at most `length`; b"" behind the last of `size_bytes`.

        Raises:
            SourceError: they cannot be had, or end before `size_bytes`.
        """


class SourceReader:
    """Reads a source from its start; over a network, threads read the next blocks."""

    def __init__(self, source: Source) -> None:
        self.name = source.name
        self.size_bytes = source.size_bytes
        self.path: Path | None = getattr(source, "path", None)
        self._source = source
        self._is_local = getattr(source, "parallel_reads", 1) == 1
        self._blocks = self._read_blocks()
        self._block = b""
        self._at = 0

    def read(self, length: int) -> bytes:
        """Return the next bytes; b"" at the end."""
        if self._is_local:  # no more than requested, so that it is still in the processor's cache when it is used
            length = min(length, MAX_READ, self.size_bytes - self._at)
            piece = self._source.read(self._at, length) if length else b""
            self._at += length
            return piece
        if self._at == len(self._block):
            self._block, self._at = next(self._blocks, b""), 0
        piece = (
            self._block if self._at == 0 and length >= len(self._block) else self._block[self._at : self._at + length]
        )
        self._at += len(piece)
        return piece

    def _read_blocks(self) -> Iterator[bytes]:
        workers: int = getattr(self._source, "parallel_reads", 1)
        starts = range(0, self.size_bytes, READ_AHEAD)
        ranges = ((start, min(READ_AHEAD, self.size_bytes - start)) for start in starts)
        tasks = (ReadAheadTask(length, partial(self._source.read, start, length)) for start, length in ranges)
        return read_ahead(tasks, workers=workers, max_bytes=workers * READ_AHEAD)


class PipeReader:
    """Reads exactly `size_bytes` bytes of a stream. `name`: of the file, for messages and its extension."""

    path = None

    def __init__(self, stream: BinaryIO, size_bytes: int, name: str) -> None:
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


@dataclass
class _RewoundReader:
    """A reader whose first bytes are read again."""

    name: str
    size_bytes: int
    path: Path | None
    read: Read


def peek(reader: SequentialReader, length: int) -> tuple[bytes, SequentialReader]:
    """Return the first bytes, at most `length`, and a reader that still begins with them, to be used instead."""
    head, read = peek_bytes(reader.read, min(length, reader.size_bytes))
    return head, _RewoundReader(reader.name, reader.size_bytes, reader.path, read)


def peek_bytes(read: Read, length: int) -> tuple[bytes, Read]:
    """Return the first bytes, at most `length`, and a function that reads from the first byte again."""
    head = b""
    while len(head) < length and (piece := read(length - len(head))):
        head += piece
    rest = head

    def read_again(size: int) -> bytes:
        nonlocal rest
        if not rest:
            return read(size)
        first, rest = rest[:size], rest[size:]
        return first

    return head, read_again
