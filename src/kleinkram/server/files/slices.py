"""Slices of recordings, made while they are sent: by a child process without credentials, from a URL of the store.

The bytes pass through this process in pieces. A child ends with its request: when the client disconnects, when the
time is over, or when it fails. A failure before the first bytes is a problem document; a later one cuts the connection,
so that no client takes a part of a slice for the whole.
"""

import asyncio
import contextlib
import logging
import signal
import uuid
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass

from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from kleinkram.contract.errors import CannotSlice, FieldProblem, InvalidRequest, StoreUnavailable, TooManySlices
from kleinkram.contract.files import FileRead
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import file_name
from kleinkram.recordings.isolation import CHILD_ENVIRONMENT
from kleinkram.recordings.slice_process import (
    SLICE_COMMAND,
    RefusalKind,
    SliceRefusal,
    SliceRequest,
    read_refusal,
    slice_request_bytes,
)
from kleinkram.recordings.time_range import resolve_time
from kleinkram.server.access.actor import Actor
from kleinkram.server.context import AppContext
from kleinkram.server.files.service import record_slice
from kleinkram.server.http.rate_limit import account_of
from kleinkram.server.settings import Settings
from kleinkram.server.shares.service import count_downloads

_log = logging.getLogger("kleinkram.slices")
# A file without a usable index is read whole, up to so many bytes.
_MAX_SCAN_BYTES = 1024 * 1024 * 1024
_PIECE_BYTES = 256 * 1024
# Bounds the first line of a child.
_LINE_LIMIT_BYTES = 1024 * 1024
_READABLE_FORMATS = {"mcap", "rosbag1"}
_URL_MARGIN_S = 60
_FIELDS = {RefusalKind.topic: "topics", RefusalKind.range: "start"}


@dataclass(frozen=True)
class SliceSelection:
    """Topics (names or globs; None: all) from log time `start` to before `end` (None: all), as the client wrote it."""

    topics: tuple[str, ...] | None
    start: str | None
    end: str | None

    def for_audit(self) -> Metadata:
        """Return what the audit log records."""
        return {
            "topics": None if self.topics is None else [*self.topics],
            "start": self.start,
            "end": self.end,
        }


class SliceSlots:
    """Bounds the slices that this process makes at once, in total and for each account."""

    def __init__(self, limit: int, limit_per_account: int) -> None:
        self._limit, self._limit_per_account = limit, limit_per_account
        self._taken: Counter[str] = Counter()

    @property
    def taken(self) -> int:
        """How many slices are made now."""
        return self._taken.total()

    def take(self, account: str) -> contextlib.ExitStack:
        """Take a slot; closing the stack returns it. Raises TooManySlices."""
        if self._taken[account] >= self._limit_per_account:
            raise TooManySlices(limit=self._limit_per_account, scope="for one account")
        if self.taken >= self._limit:
            raise TooManySlices(limit=self._limit, scope="by this server")
        self._taken[account] += 1
        slot = contextlib.ExitStack()
        slot.callback(self._release, account)
        return slot

    def _release(self, account: str) -> None:
        self._taken[account] -= 1
        if not self._taken[account]:
            del self._taken[account]


class _Child:
    """The process that makes one slice, and its slot; it is killed after the time limit."""

    def __init__(self, process: asyncio.subprocess.Process, slot: contextlib.ExitStack, timeout_s: float) -> None:
        self._process, self._slot = process, slot
        self._is_late = False
        self._timer = asyncio.get_running_loop().call_later(timeout_s, self._kill_late)

    @property
    def seconds_left(self) -> float:
        """Time until it is killed."""
        return self._timer.when() - asyncio.get_running_loop().time()

    async def request(self, line: bytes) -> SliceRefusal | None:
        """Return why the child refuses the request; None once its first bytes can be read."""
        process = self._process
        if process.stdin is None or process.stdout is None:
            raise TypeError("the child was started without its pipes")
        with contextlib.suppress(ConnectionError):  # it ended: its exit code has the reason
            process.stdin.write(line + b"\n")
            await process.stdin.drain()
        process.stdin.close()
        try:
            if answer := await process.stdout.readline():
                return read_refusal(answer)
        except ValueError:  # what the child never writes
            self._kill()
        _, stderr = await process.communicate()
        return SliceRefusal(RefusalKind.recording, self._why_ended(stderr))

    async def pieces(self) -> AsyncIterator[bytes]:
        """Yield the bytes of the slice. Raises SliceCutOff if they are not whole."""
        stdout = self._process.stdout
        while stdout is not None and (piece := await stdout.read(_PIECE_BYTES)):
            yield piece
        _, stderr = await self._process.communicate()
        if self._process.returncode != 0:
            raise SliceCutOff(self._why_ended(stderr))

    def _why_ended(self, stderr: bytes) -> str:
        if self._is_late or self._process.returncode == -signal.SIGXCPU:
            return "it takes longer than is allowed"
        if b"MemoryError" in stderr:
            return "it needs more memory than is allowed"
        _log.warning("slice failed", extra={"fields": {"stderr": stderr.decode("utf-8", "replace")[-2000:]}})
        return "reading it failed"

    async def end(self) -> None:
        """Kill it, if it still runs, and free its slot."""
        self._timer.cancel()
        with self._slot:
            self._kill()
            await self._process.communicate()

    def _kill_late(self) -> None:
        self._is_late = True
        with self._slot:
            self._kill()

    def _kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()


class SliceCutOff(Exception):
    """A slice could not be finished; ends its connection."""


class SliceResponse(StreamingResponse):
    """The bytes of a slice. Its child ends once the response is over, however it ends; so does a slow response."""

    def __init__(self, context: AppContext, actor: Actor, child: _Child, path: str) -> None:
        self._context, self._actor, self._child = context, actor, child
        self._sent_bytes = 0
        headers = {
            "Content-Disposition": f'attachment; filename="{_file_name(path)}"',
            "Accept-Ranges": "none",
            "X-Accel-Buffering": "no",  # nginx: do not buffer
            "Cache-Control": "private, no-store",
        }
        super().__init__(self._counted_pieces(), media_type="application/octet-stream", headers=headers)

    async def _counted_pieces(self) -> AsyncIterator[bytes]:
        async for piece in self._child.pieces():
            self._sent_bytes += len(piece)
            yield piece

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the slice. Raises SliceCutOff."""
        try:
            await asyncio.wait_for(super().__call__(scope, receive, send), self._child.seconds_left)
        except asyncio.TimeoutError:  # a client that does not read holds the response, not only its child
            raise SliceCutOff("the client takes longer than is allowed") from None
        finally:
            await self._child.end()
            async with self._context.database.begin() as db:
                await count_downloads(db, self._actor, files=0, size_bytes=self._sent_bytes)


async def open_slice(
    context: AppContext, slots: SliceSlots, actor: Actor, *, file_id: uuid.UUID, selection: SliceSelection
) -> SliceResponse:
    """Return a response that sends a slice of a recording as MCAP; the audit log records it as a download.

    Raises:
        NotFound: the file does not exist, or is not visible.
        FileUnavailable: the stored copy is lost or corrupt.
        CannotSlice: it is no MCAP or ROS 1 bag, or cannot be read within the limits.
        InvalidRequest: there is no such topic, or the range is none of the recording.
        TooManySlices: the account, or this process, makes as many as it may.
        StoreUnavailable: the store does not return its bytes.
    """
    with contextlib.ExitStack() as on_failure:
        async with context.database.begin() as db:
            read, _, key = await record_slice(db, actor, file_id=file_id, selection=selection.for_audit())
            start_ns, end_ns = _resolve_range(selection, read)
            if read.format not in _READABLE_FORMATS:
                raise CannotSlice(path=read.path, reason="only MCAP files and ROS 1 bags are sliced here")
            slot = on_failure.enter_context(slots.take(account_of(actor)))
        timeout_s = context.settings.slice_timeout_s
        request = SliceRequest(
            url=context.storage.sign_internal_get(key, expires_s=timeout_s + _URL_MARGIN_S),
            size_bytes=read.size_bytes,
            name=file_name(read.path),
            sha256=read.sha256,
            topics=selection.topics,
            start_ns=start_ns,
            end_ns=end_ns,
            max_scan_bytes=_MAX_SCAN_BYTES,
            memory_bytes=context.settings.slice_memory_bytes,
            cpu_s=timeout_s,
        )
        child = await _start(context.settings, slot)
        try:
            refusal = await child.request(slice_request_bytes(request))
            if refusal is not None:
                raise _error_of(refusal, read.path)
        except BaseException:
            await child.end()
            raise
        on_failure.pop_all()
        return SliceResponse(context, actor, child, read.path)


def _resolve_range(selection: SliceSelection, read: FileRead) -> tuple[int | None, int | None]:
    start_ns = None if selection.start is None else _resolve("start", selection.start, read)
    end_ns = None if selection.end is None else _resolve("end", selection.end, read)
    if start_ns is not None and end_ns is not None and end_ns <= start_ns:
        raise InvalidRequest(problems=[FieldProblem(field="end", message="is not after the start")])
    return start_ns, end_ns


def _resolve(field: str, text: str, read: FileRead) -> int:
    try:
        return resolve_time(text, read.start_ns, read.end_ns)
    except ValueError as error:
        raise InvalidRequest(problems=[FieldProblem(field=field, message=str(error))]) from None


async def _start(settings: Settings, slot: contextlib.ExitStack) -> _Child:
    process = await asyncio.create_subprocess_exec(
        *SLICE_COMMAND,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=CHILD_ENVIRONMENT,
        limit=_LINE_LIMIT_BYTES,
    )
    return _Child(process, slot, settings.slice_timeout_s)


def _error_of(refusal: SliceRefusal, path: str) -> CannotSlice | InvalidRequest | StoreUnavailable:
    if (field := _FIELDS.get(refusal.kind)) is not None:
        return InvalidRequest(problems=[FieldProblem(field=field, message=refusal.message)])
    if refusal.kind is RefusalKind.source:
        return StoreUnavailable(reason=refusal.message)
    return CannotSlice(path=path, reason=refusal.message)


def _file_name(path: str) -> str:
    """Return the name under which a slice is saved, in the characters of a header."""
    stem = file_name(path).rpartition(".")[0] or file_name(path)
    return f"{stem}.slice.mcap".encode("ascii", "replace").decode().replace('"', "_").replace("?", "_")
