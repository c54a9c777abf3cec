"""The log of a container, by a warden that may be killed at any moment, and by the one after it.

A warden that is there from the start gets what the container writes as it comes. One that is not reads what the engine
keeps, and passes over what is in the log already: so many bytes of stdout, so many of stderr. How many these are stands
beside the log, said before each write, so that a write that was cut short can be told as well.
Imports nothing but Python's own library, since wardens wait for it.
"""

import json
import os
import threading
import time
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from kleinkram.runner import ward

_CURSOR = "log.streams"
_GAP = b"\n[kleinkram] lines may be missing here: nobody followed, and the engine keeps only so much\n"
_FIRST_BYTES = 2**17


class Piece(NamedTuple):
    """Something that a container wrote; `stream` is 1 for stdout, 2 for stderr."""

    stream: int
    data: bytes


class Log:
    """The log of a run, in its folder: open while this is a context."""

    def __init__(self, folder: Path, limit_bytes: int) -> None:
        self._log = os.open(folder / ward.LOG, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600)
        self._cursor = os.open(folder / _CURSOR, os.O_RDWR | os.O_CREAT, 0o600)
        self._limit = limit_bytes
        self._size = os.fstat(self._log).st_size
        self.has_room = True
        self._kept = self._read_cursor()
        self._lock = threading.Lock()
        self._open_stream: int | None = None
        self._held: list[Piece] = []
        self._held_since_s = 0.0

    def __enter__(self) -> "Log":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.add_held(after_s=0)
        os.close(self._log)
        os.close(self._cursor)

    @property
    def is_full(self) -> bool:
        """Whether nothing more is kept; `has_room` is then false where that is for want of room on the disk."""
        return self._size >= self._limit or not self.has_room

    @property
    def last_written_ns(self) -> int:
        """When it was last written to, of the wall clock."""
        return os.fstat(self._log).st_mtime_ns

    def add(self, pieces: Iterable[Piece]) -> None:
        """Keep what a container wrote, up to the limit. Lines of one stream do not cut those of the other."""
        with self._lock:
            ordered: list[Piece] = []
            for piece in pieces:
                if self._open_stream not in (None, piece.stream):
                    self._held_since_s = self._held_since_s or time.monotonic()
                    self._held.append(piece)
                    continue
                ordered.append(piece)
                self._open_stream = None if piece.data.endswith(b"\n") else piece.stream
                if self._open_stream is None and self._held:
                    ordered += self._let_go()
            self._write(ordered)

    def add_held(self, *, after_s: float) -> None:
        """Keep what was held back for so long, though the line before it has not ended."""
        with self._lock:
            if self._held and time.monotonic() >= self._held_since_s + after_s:
                self._write(self._let_go())

    def _let_go(self) -> list[Piece]:
        held, self._held, self._held_since_s = self._held, [], 0.0
        self._open_stream = None if held[-1].data.endswith(b"\n") else held[-1].stream
        return held

    def _write(self, pieces: Iterable[Piece]) -> None:
        try:
            self._write_all(pieces)
        except OSError:
            self.has_room = False

    def _write_all(self, pieces: Iterable[Piece]) -> None:
        for stream, same in groupby(pieces, key=lambda piece: piece.stream):
            if self.is_full:
                return
            data = b"".join(piece.data for piece in same)[: self._limit - self._size]
            said = {"size": self._size, "kept": [self._kept[1], self._kept[2]], "next": stream}
            # Of constant length, and one write: it is there as a whole or not at all.
            os.pwrite(self._cursor, json.dumps(said).ljust(120).encode(), 0)
            ward.write_log(self._log, data)
            self._size += len(data)
            self._kept[stream] += len(data)
            if self.is_full:
                ward.write_log(self._log, ward.LOG_IS_FULL)

    def without_kept(self, batches: Iterable[list[Piece]]) -> Iterator[list[Piece]]:
        """Yield of all that the container wrote since its start what is not in here."""
        left = dict(self._kept)
        for pieces in batches:
            fresh = []
            for stream, data in pieces:
                passed = min(left[stream], len(data))
                left[stream] -= passed
                if passed < len(data):
                    fresh.append(Piece(stream, data[passed:]))
            yield fresh

    def begins_with(self, piece: Piece) -> bool:
        """Whether what is said to be a container's first words is what was kept of its beginning."""
        return not self._kept[piece.stream] or piece.data in os.pread(self._log, _FIRST_BYTES, 0)

    def note_gap(self) -> None:
        """Say that something may be missing from here on."""
        try:
            ward.write_log(self._log, _GAP)
            self._size += len(_GAP)
        except OSError:
            self.has_room = False

    def _read_cursor(self) -> dict[int, int]:
        text = os.pread(self._cursor, 4096, 0)
        if not text:
            return {1: 0, 2: 0}
        said = json.loads(text)
        kept = {1: said["kept"][0], 2: said["kept"][1]}
        kept[said["next"]] += self._size - said["size"]
        return kept
