"""How blobs are read: completely, for their checksums, and by child processes, which parse untrusted recordings.

Memory holds one piece of an object at a time; a parser may receive the same pieces.

Children are started on demand, reused for a second, and killed after any failure. Starting one costs more than reading
a small file, so a child reads several files in succession. All of them belong to one person: a hostile file could at
most falsify the summaries of its uploader's other files.
"""

import asyncio
import contextlib
import hashlib
import os
import time
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from typing import TypeVar

from aiohttp import ClientPayloadError
from typing_extensions import Self

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.uploads import crc64nvme
from kleinkram.recordings import RecordingSummary
from kleinkram.recordings.formats.rosbag2.metadata import Rosbag2Metadata
from kleinkram.recordings.isolation import (
    CHILD_COMMAND,
    CHILD_ENVIRONMENT,
    PreviewAnswer,
    read_answer,
    read_metadata_answer,
    read_preview_answer,
    timed_out,
)
from kleinkram.server.blobs.queries import BlobRow
from kleinkram.server.context import AppContext
from kleinkram.server.s3.client import S3Error
from kleinkram.server.s3.storage import Storage, StoreRefused

T = TypeVar("T")
# Takes a child's line, its stderr and its exit code.
_ParseAnswer = Callable[[bytes, bytes, int], T]
_FILES_EACH = 100
_IDLE_S = 1.0
# Databases are copied to TMPDIR; children get no other variable of this process.
_ENVIRONMENT = CHILD_ENVIRONMENT | {name: os.environ[name] for name in ("TMPDIR",) if name in os.environ}
# A summary with ten thousand topics is a few megabytes of JSON.
_ANSWER_LIMIT_BYTES = 64 * 1024 * 1024
_RETRY_BYTES = 64 * 1024  # read again where reading failed
_CONTROL_BYTES = 1024
ByteReceiver = Callable[[bytes], Awaitable[None]]


# -- all bytes of an object -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ObjectChecksums:
    """Result of reading an object completely."""

    size_bytes: int
    sha256: bytes
    md5: bytes
    crc64nvme: bytes

    def differs_from(self, row: BlobRow) -> str | None:
        """Return how the object differs from its row; None if it does not."""
        if self.size_bytes != row.size_bytes:
            return f"it has {self.size_bytes} bytes instead of {row.size_bytes}"
        if row.crc64nvme is not None and self.crc64nvme != row.crc64nvme:
            return f"its CRC-64/NVME is {self.crc64nvme.hex()} instead of {row.crc64nvme.hex()} at its upload"
        if self.sha256 != row.sha256:
            return f"its sha256 is {self.sha256.hex()} instead of {row.sha256.hex()} as stated by its uploader"
        return None


class Unreadable(Exception):
    """The store serves other objects but not the bytes of this one; the message names the first byte that failed."""


async def read_through(context: AppContext, key: str, receive: ByteReceiver | None = None) -> ObjectChecksums:
    """Read an object at the rate that the settings allow, and pass each piece to `receive`.

    Raises:
        FileNotFoundError: the store does not have it.
        Unreadable: the store fails at this object alone.
        StoreUnavailable: the store did not answer.
    """
    sha256, md5, crc, size_bytes = hashlib.sha256(), hashlib.md5(usedforsecurity=False), 0, 0
    started = time.monotonic()
    try:
        async with contextlib.aclosing(context.storage.read(key, attempts=1)) as pieces:
            async for piece in pieces:
                size_bytes += len(piece)
                crc = await asyncio.to_thread(_digest, piece, sha256, md5, crc)
                if receive is not None:
                    await receive(piece)
                ahead_s = size_bytes / context.settings.verify_bytes_per_s - (time.monotonic() - started)
                if ahead_s > 0:
                    await asyncio.sleep(ahead_s)
    except StoreUnavailable as error:
        await _raise_if_unreadable(context.storage, key, size_bytes, error)
        raise
    return ObjectChecksums(size_bytes, sha256.digest(), md5.digest(), crc.to_bytes(8, "big"))


def _digest(piece: bytes, sha256: "hashlib._Hash", md5: "hashlib._Hash", crc: int) -> int:
    sha256.update(piece)
    md5.update(piece)
    return int(crc64nvme(piece, crc))


async def _raise_if_unreadable(storage: Storage, key: str, offset: int, error: StoreUnavailable) -> None:
    """Check whether the store fails only at this object, which it returned up to `offset` before `error`.

    Reads again from there only: with a damaged object, SeaweedFS 4.48 tries for 13 s before it answers 500.

    Raises:
        Unreadable: it does.
        StoreUnavailable: the store fails at other objects, too.
    """
    if not isinstance(error.__cause__, ClientPayloadError) and not _is_failure(error):
        return
    try:
        await storage.read_range(key, offset=offset, size_bytes=_RETRY_BYTES, attempts=1)
    except StoreUnavailable as again:
        if not _is_failure(again):
            return
        await _read_control(storage)
        message = f"the store does not return its bytes from {offset:,} on, but serves others ({again.reason})"
        raise Unreadable(message) from again


def _is_failure(error: StoreUnavailable) -> bool:
    """Whether the store itself answered with a failure; a broken connection may be the network's fault."""
    return isinstance(error.__cause__, S3Error) and error.__cause__.status == 500


async def _read_control(storage: Storage) -> None:
    """Write, read and remove a probe; raise StoreUnavailable if that fails: the store fails as a whole."""
    key, body = f"probe/{uuid.uuid4()}", os.urandom(_CONTROL_BYTES)
    try:
        await storage.put_object(key, body)
        if await storage.read_range(key, offset=0, size_bytes=_CONTROL_BYTES) != body:
            raise StoreUnavailable(reason="it returns other bytes than were written")
    except (FileNotFoundError, StoreRefused) as error:
        raise StoreUnavailable(reason=f"it does not keep what is written: {error}") from error
    finally:
        await storage.delete(key)


# -- child processes --------------------------------------------------------------------------------------------------


@dataclass
class _Reader:
    process: asyncio.subprocess.Process
    owner: uuid.UUID
    files: int = 0
    retirement: "asyncio.Task[None] | None" = None

    async def ask(self, request: bytes) -> bytes:
        """Return the child's line, or b"" if it ended."""
        if self.process.stdin is None or self.process.stdout is None:
            raise TypeError("the child was started without its pipes")
        self.files += 1
        with contextlib.suppress(ConnectionError):  # it ended: its stderr has the reason
            self.process.stdin.write(request + b"\n")
            await self.process.stdin.drain()
        return await self.process.stdout.readline()

    async def wait_for_end(self) -> tuple[bytes, int]:
        """Wait for the end; return stderr and exit code."""
        _, stderr = await self.process.communicate()
        return stderr, self.process.returncode or 0

    async def end(self) -> None:
        """Kill it."""
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        await self.process.communicate()


class StreamParser:
    """A child that receives the bytes of one recording from a caller who reads them anyway.

    A child that ends early does not disturb `feed`; `summary` reports it.
    """

    def __init__(self, reader: _Reader, timeout_s: float) -> None:
        self._reader = reader
        self._timeout_s = timeout_s
        self._has_ended = self._is_late = False
        self.answered = False

    async def feed(self, piece: bytes) -> None:
        """Pass it the next bytes; waits while it is busy."""
        stdin = self._reader.process.stdin
        if self._has_ended or self._is_late or stdin is None:
            return
        try:
            stdin.write(piece)
            await asyncio.wait_for(stdin.drain(), self._timeout_s)
        except ConnectionError:
            self._has_ended = True
        except asyncio.TimeoutError:
            self._is_late = True

    async def summary(self) -> RecordingSummary:
        """Return the summary; call it after all announced bytes were fed.

        Raises:
            SummaryFailed: it ran out of memory or time, crashed, or ended early.
        """
        if self._is_late:
            raise timed_out()
        stdout = self._reader.process.stdout
        try:
            # A child that ended early may have answered for a part of the file.
            line = b""
            if stdout is not None and not self._has_ended:
                line = await asyncio.wait_for(stdout.readline(), self._timeout_s)
            if not line:
                stderr, code = await asyncio.wait_for(self._reader.wait_for_end(), self._timeout_s)
                return read_answer(b"", stderr, code)
        except asyncio.TimeoutError:
            raise timed_out() from None
        self.answered = True
        return read_answer(line, b"", 0)


class ReaderProcesses:
    """The idle children of one worker; leaving the context ends them."""

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
        """Read one recording of `owner`.

        Raises:
            SummaryFailed: the child ran out of memory or time, crashed, or could not read the bytes.
        """
        return await self._ask(request, read_answer, owner, timeout_s)

    async def metadata(self, request: bytes, *, owner: uuid.UUID, timeout_s: float) -> Rosbag2Metadata | None:
        """Read one metadata.yaml of `owner`; None if it is damaged.

        Raises:
            SummaryFailed: the child ran out of memory or time, or crashed.
        """
        return await self._ask(request, read_metadata_answer, owner, timeout_s)

    async def preview(self, request: bytes, *, owner: uuid.UUID, timeout_s: float) -> PreviewAnswer:
        """Make the preview of one recording of `owner`; its bytes are not checked.

        Raises:
            SummaryFailed: the child ran out of memory or time, crashed, or could not open the recording.
        """
        return await self._ask(request, read_preview_answer, owner, timeout_s)

    async def _ask(self, request: bytes, parse: _ParseAnswer[T], owner: uuid.UUID, timeout_s: float) -> T:
        reader = await self._take_idle(owner) or await _start(owner)
        try:
            line = await asyncio.wait_for(reader.ask(request), timeout_s)
            if not line:
                stderr, code = await asyncio.wait_for(reader.wait_for_end(), timeout_s)
                return parse(b"", stderr, code)
            answer = parse(line, b"", 0)
        except asyncio.TimeoutError:
            await reader.end()
            raise timed_out() from None
        except BaseException:
            await reader.end()
            raise
        await self._keep(reader)
        return answer

    @contextlib.asynccontextmanager
    async def parse_stream(self, request: bytes, *, owner: uuid.UUID, timeout_s: float) -> AsyncIterator[StreamParser]:
        """Start parsing in a child the bytes that `request` announces; the caller feeds them."""
        reader = await self._take_idle(owner) or await _start(owner)
        reader.files += 1
        parser = StreamParser(reader, timeout_s)
        try:
            await parser.feed(request + b"\n")
            yield parser
        except BaseException:
            await reader.end()
            raise
        if parser.answered:
            await self._keep(reader)
        else:
            await reader.end()

    async def _take_idle(self, owner: uuid.UUID) -> _Reader | None:
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
