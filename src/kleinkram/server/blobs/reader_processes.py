"""The child processes that read untrusted recordings: started when needed, kept for a moment, ended on any doubt.

Starting one costs more than reading a small file, so a child takes several files, one after the other: of one person
only, so that whoever sends a hostile file could at most falsify what is said of their own.
"""

import asyncio
import contextlib
import os
import uuid
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import TypeVar

from typing_extensions import Self

from kleinkram.recordings import RecordingSummary
from kleinkram.recordings.formats.rosbag2.metadata import Rosbag2Metadata
from kleinkram.recordings.isolation import (
    CHILD_COMMAND,
    CHILD_ENVIRONMENT,
    read_answer,
    read_metadata_answer,
    timed_out,
)

T = TypeVar("T")
# Of what a child left behind: its line, what it said on stderr, its exit code.
_Understand = Callable[[bytes, bytes, int], T]
_FILES_EACH = 100
_IDLE_S = 1.0
# Where a database may be copied to be read; everything else of ours stays out of it.
_ENVIRONMENT = CHILD_ENVIRONMENT | {name: os.environ[name] for name in ("TMPDIR",) if name in os.environ}
# The summary of a recording with some ten thousand topics is a few megabytes of JSON.
_ANSWER_LIMIT_BYTES = 64 * 1024 * 1024


@dataclass
class _Reader:
    process: asyncio.subprocess.Process
    owner: uuid.UUID
    files: int = 0
    retirement: "asyncio.Task[None] | None" = None

    async def ask(self, request: bytes) -> bytes:
        """Return the child's line, or b"" when it ended instead."""
        if self.process.stdin is None or self.process.stdout is None:
            raise TypeError("the child was started without its pipes")
        self.files += 1
        with contextlib.suppress(ConnectionError):  # it died: what it left on stderr tells why
            self.process.stdin.write(request + b"\n")
            await self.process.stdin.drain()
        return await self.process.stdout.readline()

    async def wait_for_end(self) -> tuple[bytes, int]:
        """Wait for the end; return what it said on stderr, and its exit code."""
        _, stderr = await self.process.communicate()
        return stderr, self.process.returncode or 0

    async def end(self) -> None:
        """End it, whatever it is doing."""
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        await self.process.communicate()


class StreamParser:
    """A child that is given the bytes of one recording by somebody who reads them anyway.

    A child that dies meanwhile is no concern of the feeder: only `summary` says so.
    """

    def __init__(self, reader: _Reader, patience_s: float) -> None:
        self._reader = reader
        self._patience_s = patience_s
        self._is_gone = self._is_late = False
        self.answered = False

    async def feed(self, piece: bytes) -> None:
        """Give it the next bytes; waits while it is busy with those before."""
        stdin = self._reader.process.stdin
        if self._is_gone or self._is_late or stdin is None:
            return
        try:
            stdin.write(piece)
            await asyncio.wait_for(stdin.drain(), self._patience_s)
        except ConnectionError:
            self._is_gone = True
        except asyncio.TimeoutError:
            self._is_late = True

    async def summary(self) -> RecordingSummary:
        """Return what it found, once it was given all that was announced.

        Raises:
            SummaryFailed: it ran out of memory or time, crashed, or ended before it was given everything.
        """
        if self._is_late:
            raise timed_out()
        stdout = self._reader.process.stdout
        try:
            # Whatever it says that has not taken all bytes is said of half a file.
            line = b""
            if stdout is not None and not self._is_gone:
                line = await asyncio.wait_for(stdout.readline(), self._patience_s)
            if not line:
                stderr, code = await asyncio.wait_for(self._reader.wait_for_end(), self._patience_s)
                return read_answer(b"", stderr, code)
        except asyncio.TimeoutError:
            raise timed_out() from None
        self.answered = True
        return read_answer(line, b"", 0)


class ReaderProcesses:
    """Children that wait for the next file. One a worker; leaving its context ends them all."""

    def __init__(self) -> None:
        self._idle: list[_Reader] = []
        self._ending: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        idle, self._idle = self._idle, []
        for reader in idle:
            await self._recall(reader)
            await reader.end()
        await asyncio.gather(*self._ending)

    async def summary(self, request: bytes, *, owner: uuid.UUID, timeout_s: float) -> RecordingSummary:
        """Have one recording of `owner` read.

        Raises:
            SummaryFailed: the child ran out of memory or time, crashed, or could not read the bytes.
        """
        return await self._ask(request, read_answer, owner, timeout_s)

    async def metadata(self, request: bytes, *, owner: uuid.UUID, timeout_s: float) -> Rosbag2Metadata | None:
        """Have one metadata.yaml of `owner` read; None if it is damaged.

        Raises:
            SummaryFailed: the child ran out of memory or time, or crashed.
        """
        return await self._ask(request, read_metadata_answer, owner, timeout_s)

    async def _ask(self, request: bytes, read: _Understand[T], owner: uuid.UUID, timeout_s: float) -> T:
        reader = await self._waiting_for(owner) or await _start(owner)
        try:
            line = await asyncio.wait_for(reader.ask(request), timeout_s)
            if not line:
                stderr, code = await asyncio.wait_for(reader.wait_for_end(), timeout_s)
                return read(b"", stderr, code)
            answer = read(line, b"", 0)
        except asyncio.TimeoutError:
            await reader.end()
            raise timed_out() from None
        except BaseException:
            await reader.end()
            raise
        await self._keep(reader)
        return answer

    @contextlib.asynccontextmanager
    async def parse_stream(self, request: bytes, *, owner: uuid.UUID, patience_s: float) -> AsyncIterator[StreamParser]:
        """Have a child read along with whoever feeds it the bytes that `request` announces."""
        reader = await self._waiting_for(owner) or await _start(owner)
        reader.files += 1
        along = StreamParser(reader, patience_s)
        try:
            await along.feed(request + b"\n")
            yield along
        except BaseException:
            await reader.end()
            raise
        if along.answered:
            await self._keep(reader)
        else:
            await reader.end()

    async def _waiting_for(self, owner: uuid.UUID) -> _Reader | None:
        for reader in self._idle:
            if reader.owner == owner:
                self._idle.remove(reader)
                await self._recall(reader)
                return reader
        return None

    async def _keep(self, reader: _Reader) -> None:
        if reader.files >= _FILES_EACH:
            await reader.end()
            return
        self._idle.append(reader)
        reader.retirement = asyncio.create_task(self._retire(reader))

    async def _retire(self, reader: _Reader) -> None:
        await asyncio.sleep(_IDLE_S)
        self._idle.remove(reader)
        ending = asyncio.create_task(reader.end())
        self._ending.add(ending)
        ending.add_done_callback(self._ending.discard)

    async def _recall(self, reader: _Reader) -> None:
        if reader.retirement is not None:
            reader.retirement.cancel()
            await asyncio.gather(reader.retirement, return_exceptions=True)
            reader.retirement = None


async def _start(owner: uuid.UUID) -> _Reader:
    process = await asyncio.create_subprocess_exec(
        *CHILD_COMMAND,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=_ENVIRONMENT,
        limit=_ANSWER_LIMIT_BYTES,
    )
    return _Reader(process, owner)
