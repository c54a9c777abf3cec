"""What a run writes, on its way to the store while it lasts: in order, in pieces, without secrets.

A piece is decided and written down before it is sent. So a runner that was killed in between sends the very same piece
again, and nothing is there twice or missing.
"""

import hashlib
import logging
import threading
from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client.runners import Runners
from kleinkram.client.transfer.store import StoreAnswer, StoreClient
from kleinkram.contract.checksums import crc64nvme
from kleinkram.contract.errors import KleinkramError, RunGone
from kleinkram.contract.runners import LogChunkConfirm, LogChunkCreate, RunAssignment
from kleinkram.runner.disk import write_whole
from kleinkram.runner.redacting import Redactor

LOG = "log"
LOG_STATE = "log.json"
_PIECE_BYTES = 4 * 2**20
_EVERY_S = 1.0
_LOOK_EVERY_S = 0.2
_PATIENCE_S = 30.0
_LEAVE_S = 2.0

_log = logging.getLogger("kleinkram.runner")


class _Sent(BaseModel):
    """How far it is: `raw` bytes of what the run wrote are kept, as `kept` bytes without secrets.

    `next_raw` bytes are the piece under way.
    """

    model_config = ConfigDict(frozen=True)

    raw: int = 0
    kept: int = 0
    next_raw: int = 0


class LogFollower:
    """Follows the log of one run, in a thread of its own, until it is told to leave."""

    def __init__(
        self, runners: Runners, store: StoreClient, claim: RunAssignment, folder: Path, redactor: Redactor
    ) -> None:
        self._runners = runners.with_patience(_PATIENCE_S, self._wait)
        self._store = store
        self._claim = claim
        self._folder = folder
        self._redactor = redactor
        self._is_whole = threading.Event()
        self._leave = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="log", daemon=True)
        self._sent = _read(folder / LOG_STATE)

    def start(self) -> None:
        """Begin, or go on where an earlier runner was."""
        self._thread.start()

    def is_whole(self) -> None:
        """Nothing comes any more: send the rest."""
        self._is_whole.set()

    def leave(self, *, within_s: float = 0.0) -> None:
        """End it, when all is sent or after some time."""
        self._is_whole.set()
        if self._thread.ident is not None:
            self._thread.join(within_s)
            self._leave.set()
            # It may be at a server that does not answer; nobody waits for that.
            self._thread.join(_LEAVE_S)

    def _follow(self) -> None:
        try:
            while True:
                self._wait(0)
                is_whole = self._is_whole.is_set()
                if is_whole and not self._sent.raw:
                    # What a short run wrote is kept with all that it left, before anybody could look.
                    self._wait(_EVERY_S)
                size = self._send_piece(is_whole=is_whole)
                if not is_whole and size < _PIECE_BYTES // 2:
                    self._is_whole.wait(_EVERY_S if size else _LOOK_EVERY_S)
                if is_whole and size == 0:
                    return
        except (_Left, RunGone):
            return
        except OSError as error:
            # People then see the log once the run is over.
            _log.error("the log of the run %s is not followed any more: %s", self._claim.run_id, error)

    def _send_piece(self, *, is_whole: bool) -> int:
        """Send what comes next, and return its size; 0 where there is nothing yet."""
        raw = _read_raw(self._folder / LOG, self._sent.raw, self._sent.next_raw or _PIECE_BYTES)
        if not raw:
            return 0
        if not self._sent.next_raw:
            size = len(raw) if is_whole and len(raw) < _PIECE_BYTES else self._redactor.cut(raw, _PIECE_BYTES)
            if size == 0:
                return 0
            raw = raw[:size]
            self._note(self._sent.model_copy(update={"next_raw": size}))
        piece = self._redactor.clean(raw)
        self._send(piece)
        self._note(_Sent(raw=self._sent.raw + len(raw), kept=self._sent.kept + len(piece)))
        return len(raw)

    def _send(self, piece: bytes) -> None:
        offset = self._sent.kept
        ask = LogChunkCreate(
            attempt=self._claim.attempt,
            offset=offset,
            size_bytes=len(piece),
            sha256=hashlib.sha256(piece).hexdigest(),
            crc64nvme=f"{crc64nvme(piece):016x}",
            md5=hashlib.md5(piece, usedforsecurity=False).hexdigest(),
        )
        while True:
            try:
                put = self._runners.create_log_chunk(self._claim.run_id, ask)
                if self._store.put(put.url, put.headers, len(piece), [piece]).answer is StoreAnswer.taken:
                    kept = LogChunkConfirm(attempt=self._claim.attempt, offset=offset, size_bytes=len(piece))
                    self._runners.confirm_log_chunk(self._claim.run_id, kept)
                    return
            except RunGone:
                raise
            except KleinkramError as error:
                _log.warning("the log of the run %s waits: %s", self._claim.run_id, error)
            self._wait(_EVERY_S)

    def _wait(self, seconds: float) -> None:
        if self._leave.wait(seconds):
            raise _Left

    def _note(self, sent: _Sent) -> None:
        write_whole(self._folder / LOG_STATE, sent.model_dump_json())
        self._sent = sent


class _Left(Exception):
    """The thread is to end."""


def write_clean(folder: Path, redactor: Redactor, target: Path) -> int:
    """Write all that a run that is over wrote, without secrets, to a file; return its size."""
    size = 0
    with target.open("wb") as stream:
        for raw in _pieces(folder / LOG, redactor):
            size += stream.write(redactor.clean(raw))
    return size


def _pieces(log: Path, redactor: Redactor) -> Iterator[bytes]:
    offset = 0
    while raw := _read_raw(log, offset, _PIECE_BYTES):
        size = len(raw) if len(raw) < _PIECE_BYTES else redactor.cut(raw, _PIECE_BYTES)
        yield raw[:size]
        offset += size


def _read_raw(log: Path, offset: int, size_bytes: int) -> bytes:
    try:
        with log.open("rb") as stream:
            stream.seek(offset)
            return stream.read(size_bytes)
    except FileNotFoundError:
        return b""


def _read(path: Path) -> _Sent:
    try:
        return _Sent.model_validate_json(path.read_bytes())
    except (FileNotFoundError, ValidationError):
        return _Sent()
