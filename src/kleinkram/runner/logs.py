"""Uploads the log of a run while it lasts: in order, in chunks, without secrets.

A chunk is recorded before it is uploaded. So after a kill the next runner uploads the same chunk again, and nothing is
missing or there twice.
"""

import hashlib
import logging
import re
import threading
from collections.abc import Callable, Collection
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client.transfer.store import StoreAnswer
from kleinkram.contract.errors import KleinkramError, RunGone
from kleinkram.contract.runners import LogChunkConfirm, LogChunkCreate
from kleinkram.contract.uploads import crc64nvme
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.supervision import write_atomically
from kleinkram.runner.state_directory import LOG_UPLOAD, Attempt, RunnerContext

_CHUNK_BYTES = 4 * 2**20
_EVERY_S = 1.0
_CHECK_EVERY_S = 0.2
_RETRY_S = 30.0
_CLOSE_S = 2.0
_REDACTED = b"[redacted]"
# No secret is longer: one that begins this far from the end of a window is complete.
_LONGEST_SECRET = 512
_SHORTEST_SECRET = 16
_SECRET_PATTERNS = (
    rb"klein_[a-z]{1,16}_[A-Za-z0-9_-]{43}[0-9A-Za-z]{6}",
    rb"(X-Amz-(?:Signature|Credential|Security-Token)=)[0-9A-Za-z%/._+-]{1,256}",
)
_SECRET_PREFIXES = (b"klein_", b"X-Amz-")

# Returns bytes of the log of a job, from an offset on.
ReadLog = Callable[[int, int], bytes]

_log = logging.getLogger("kleinkram.runner")


class Redactor:
    """Removes secrets from a log: some known tokens, all tokens of Kleinkram, and signatures of URLs."""

    def __init__(self, secrets: Collection[str]) -> None:
        known = [secret.encode() for secret in secrets if _SHORTEST_SECRET <= len(secret) <= _LONGEST_SECRET // 2]
        self._pattern = re.compile(b"|".join([*map(re.escape, known), *_SECRET_PATTERNS]))
        # Searched for first: most output has none of these, and the pattern is a hundred times slower.
        self._prefixes = [*known, *_SECRET_PREFIXES]

    def redact(self, data: bytes) -> bytes:
        """Return data without secrets. It may be cut where `cut` allows."""
        if not any(prefix in data for prefix in self._prefixes):
            return data
        return self._pattern.sub(lambda match: (match.group(1) or b"") + _REDACTED, data)

    def cut(self, data: bytes, max_bytes: int) -> int:
        """Return the number of bytes that can be redacted without those that follow; 0: none yet.

        These are complete lines, since no secret contains a line break. In a line longer than `max_bytes`, they end
        where no secret can continue.
        """
        window = data[:max_bytes]
        lines = max(window.rfind(b"\n"), window.rfind(b"\r")) + 1
        if lines > 0 or len(window) < max_bytes:
            return lines
        end = max_bytes - _LONGEST_SECRET
        for match in self._pattern.finditer(window):
            if match.start() < end < match.end():
                return match.start()
        return end


class _UploadState(BaseModel):
    """`raw_bytes` of the log are stored as `redacted_bytes`; the chunk being uploaded has `chunk_bytes`."""

    model_config = ConfigDict(frozen=True)

    raw_bytes: int = 0
    redacted_bytes: int = 0
    chunk_bytes: int = 0


class LogUpload:
    """Uploads the log of one run in a thread."""

    def __init__(self, context: RunnerContext, attempt: Attempt, redactor: Redactor) -> None:
        self._executor = context.executor
        self._runners = context.runners.with_retry(_RETRY_S, self._wait)
        self._store = context.store
        self._every_s = context.log_every_s
        self._assignment = attempt.state.assignment
        self._path = attempt.directory / LOG_UPLOAD
        self._redactor = redactor
        self._is_complete = threading.Event()
        self._is_closed = threading.Event()
        self._thread: threading.Thread | None = None
        try:
            self._state = _UploadState.model_validate_json(self._path.read_bytes())
        except (FileNotFoundError, ValidationError):
            self._state = _UploadState()

    def start(self, job: RunJob) -> None:
        """Start the upload, or continue that of an earlier runner. No effect while it goes on."""
        if self._thread is not None and self._thread.is_alive():
            return
        self._thread = threading.Thread(target=self._upload, args=(job,), name="log", daemon=True)
        self._thread.start()

    def finish(self) -> None:
        """Upload the rest: the job has ended."""
        self._is_complete.set()

    def close(self) -> None:
        """End the thread."""
        self._is_complete.set()
        self._is_closed.set()
        if self._thread is not None:
            # It may wait for a server that does not answer.
            self._thread.join(_CLOSE_S)

    def _upload(self, job: RunJob) -> None:
        try:
            self._is_complete.wait(self._first_s())
            while True:
                self._wait(0)
                is_complete = self._is_complete.is_set()
                if is_complete and not self._state.raw_bytes:
                    # The log of a short run is stored with its artifacts before anybody can look.
                    self._wait(_EVERY_S)
                size_bytes = self._upload_chunk(job, is_complete=is_complete)
                if not is_complete and size_bytes < _CHUNK_BYTES // 2:
                    self._is_complete.wait(max(_EVERY_S, self._every_s()) if size_bytes else _CHECK_EVERY_S)
                if is_complete and size_bytes == 0:
                    return
        except (_Closed, RunGone):
            return
        except OSError as error:
            # The log then appears once the run has ended.
            _log.error("the log of the run %s is not uploaded any more: %s", self._assignment.run_id, error)

    def _first_s(self) -> float:
        """Return when to look for the first output, in seconds: at once, unless the runner has many runs."""
        return self._every_s() if self._every_s() > _EVERY_S else 0

    def _upload_chunk(self, job: RunJob, *, is_complete: bool) -> int:
        """Upload the next chunk, and return its size; 0 where there is none yet."""
        state = self._state
        raw = self._executor.read_log(job, state.raw_bytes, state.chunk_bytes or _CHUNK_BYTES)
        if not raw:
            return 0
        if not state.chunk_bytes:
            is_last = is_complete and len(raw) < _CHUNK_BYTES
            size_bytes = len(raw) if is_last else self._redactor.cut(raw, _CHUNK_BYTES)
            if size_bytes == 0:
                return 0
            raw = raw[:size_bytes]
            self._record(state.model_copy(update={"chunk_bytes": size_bytes}))
        chunk = self._redactor.redact(raw)
        self._send(chunk)
        self._record(
            _UploadState(raw_bytes=state.raw_bytes + len(raw), redacted_bytes=state.redacted_bytes + len(chunk))
        )
        return len(raw)

    def _send(self, chunk: bytes) -> None:
        offset, attempt, run_id = self._state.redacted_bytes, self._assignment.attempt, self._assignment.run_id
        request = LogChunkCreate(
            attempt=attempt,
            offset=offset,
            size_bytes=len(chunk),
            sha256=hashlib.sha256(chunk).hexdigest(),
            crc64nvme=f"{crc64nvme(chunk):016x}",
            md5=hashlib.md5(chunk, usedforsecurity=False).hexdigest(),
        )
        while True:
            try:
                upload = self._runners.create_log_chunk(run_id, request)
                if self._store.put(upload.url, upload.headers, len(chunk), [chunk]).answer is StoreAnswer.taken:
                    confirmation = LogChunkConfirm(attempt=attempt, offset=offset, size_bytes=len(chunk))
                    self._runners.confirm_log_chunk(run_id, confirmation)
                    return
            except RunGone:
                raise
            except KleinkramError as error:
                _log.warning("the log of the run %s waits: %s", run_id, error)
            self._wait(_EVERY_S)

    def _wait(self, seconds: float) -> None:
        if self._is_closed.wait(seconds):
            raise _Closed

    def _record(self, state: _UploadState) -> None:
        write_atomically(self._path, state.model_dump_json())
        self._state = state


class _Closed(Exception):
    """The thread is to end."""


def write_redacted_log(read_log: ReadLog, redactor: Redactor, target: Path) -> int:
    """Write the complete log of an ended job, without secrets, to a file; return its size."""
    offset = written_bytes = 0
    with target.open("wb") as stream:
        while raw := read_log(offset, _CHUNK_BYTES):
            size_bytes = len(raw) if len(raw) < _CHUNK_BYTES else redactor.cut(raw, _CHUNK_BYTES)
            written_bytes += stream.write(redactor.redact(raw[:size_bytes]))
            offset += size_bytes
    return written_bytes
