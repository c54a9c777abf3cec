"""Base class of the writers of chunked files: the chunk being filled, those being compressed, and the index so far.

With `workers`, threads compress, and one more writes; the order of chunks and their bytes are the same as without.
Memory: the chunk being filled, at most `workers` and two more that wait (one, if they have more than 32 MiB), and the
records of the index.
"""

from __future__ import annotations

import struct
from array import array
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import BinaryIO, NamedTuple

COMPRESSION_THREADS = 2
"""Threads that compress chunks of one output: more than the thread that reads can fill with work gain nothing."""

_MAX_WAITING_BYTES = 32 * 2**20


class Chunk(NamedTuple):
    """A complete chunk. `indexes`: for each channel, the flat entries of its index."""

    pieces: list[bytes]
    size: int
    first_ns: int
    last_ns: int
    indexes: dict[int, array[int]]


class PackedChunk(NamedTuple):
    """What is stored of a chunk. `checksum`: of the uncompressed bytes, where the format has one."""

    stored: bytes
    checksum: int


class ChunkedWriter:
    """Collects messages and writes chunks. `compress` runs in several threads at once if there are `workers`."""

    def __init__(
        self,
        file: BinaryIO,
        compress: Callable[[bytes], bytes],
        chunk_bytes: int,
        index_code: str,
        workers: int = 0,
    ) -> None:
        self._file, self._compress, self._chunk_bytes, self._index_code = file, compress, chunk_bytes, index_code
        self._position = self._raw_bytes = self._stored_bytes = 0
        self._definitions: list[bytes] = []
        self._chunk_indexes: list[bytes] = []
        self._most_waiting = workers + 2
        self._pools = (ThreadPoolExecutor(workers, "compress"), ThreadPoolExecutor(1, "write")) if workers else None
        self._waiting: deque[tuple[int, Future[None]]] = deque()
        self._begin_chunk()

    @property
    def bytes_written(self) -> int:
        """Size of the file so far; of the chunk being filled, what it will be if it compresses like those before."""
        if not self._raw_bytes:
            return self._position + self._size
        return self._position + self._size * self._stored_bytes // self._raw_bytes

    def close(self) -> None:
        """End the threads. The file is not closed; without `finish` before, it is not complete."""
        for pool in self._pools or ():
            pool.shutdown(cancel_futures=True)

    def _begin_chunk(self) -> None:
        self._pieces: list[bytes] = []
        self._size = 0
        self._first_ns, self._last_ns = 2**64 - 1, 0
        self._index: dict[int, array[int]] = {}

    def _define(self, record: bytes) -> None:
        self._definitions.append(record)
        self._pieces.append(record)
        self._size += len(record)

    def _add(self, channel: int, index_entry: tuple[int, ...], log_time_ns: int, head: bytes, payload: bytes) -> None:
        index = self._index.get(channel)
        if index is None:
            index = self._index[channel] = array(self._index_code)
        index.extend(index_entry)
        self._pieces += (head, payload)
        self._size += len(head) + len(payload)
        self._first_ns, self._last_ns = min(self._first_ns, log_time_ns), max(self._last_ns, log_time_ns)
        if self._size >= self._chunk_bytes:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Give the chunk being filled, if anything is in it, to be compressed and written."""
        if not self._size:
            return
        chunk = Chunk(self._pieces, self._size, self._first_ns, self._last_ns, self._index)
        self._begin_chunk()
        if self._pools is None:
            self._store(chunk, self._pack(chunk))
            return
        compressing, writing = self._pools
        packed = compressing.submit(self._pack, chunk)
        self._waiting.append((chunk.size, writing.submit(lambda: self._store(chunk, packed.result()))))
        while self._waiting and (self._waiting[0][1].done() or self._has_too_many_waiting()):
            self._waiting.popleft()[1].result()

    def _has_too_many_waiting(self) -> bool:
        waiting = len(self._waiting)
        return waiting > self._most_waiting or (
            waiting > 1 and sum(size for size, _ in self._waiting) > _MAX_WAITING_BYTES
        )

    def _flush(self) -> None:
        """Write all chunks, that being filled included. Until then, what is written belongs to the other threads."""
        self._end_chunk()
        while self._waiting:
            self._waiting.popleft()[1].result()

    def _pack(self, chunk: Chunk) -> PackedChunk:
        """Compress a chunk, in any thread."""
        raw = b"".join(chunk.pieces)
        return PackedChunk(self._compress(raw), self._checksum(raw))

    def _checksum(self, raw: bytes) -> int:
        return 0

    def _store(self, chunk: Chunk, packed: PackedChunk) -> None:
        self._raw_bytes += chunk.size
        self._stored_bytes += len(packed.stored)
        self._write_chunk(chunk, packed)

    def _write_chunk(self, chunk: Chunk, packed: PackedChunk) -> None:
        raise NotImplementedError

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._position += len(data)


def counted_bytes(data: bytes) -> bytes:
    """Return bytes behind their length."""
    return struct.pack("<I", len(data)) + data
