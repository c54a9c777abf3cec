"""The threads of an upload: the caller's hashes, one signs, some send, one finishes.

Each byte is read once for its checksums; senders send their part again, from the page cache, as the body of its PUT.
So memory is a slice a thread, and a part whose bytes changed in between is refused by the store, which checks it
against the checksum that the server signed. At most `AHEAD_BYTES` are hashed and not yet sent.
"""

import contextlib
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from kleinkram.client._http import store_unreachable
from kleinkram.client._retry import Backoff
from kleinkram.client.errors import FileChanged, FileUnreadable, StoreTroubled, TransferFailed
from kleinkram.client.transfer.file_upload import FilePart, FileUpload
from kleinkram.client.transfer.link import RECONNECT_S, Lane, LinkMonitor, Window
from kleinkram.client.transfer.local_file import FileSlice
from kleinkram.client.transfer.report import Outcome, TransferResult, Watcher
from kleinkram.client.transfer.store import MOST_TROUBLED, PATIENCE_S, PutResult, StoreAnswer, StoreClient
from kleinkram.client.transfer.threads import Budget, RateLimit, Stop, Stopped, WorkQueue
from kleinkram.client.uploads import Uploads
from kleinkram.contract.errors import KleinkramError, NotFound, UploadGone, UploadIncomplete
from kleinkram.contract.problems import from_problem
from kleinkram.contract.uploads import Completed, NotCompleted, SignedPart

AHEAD_BYTES = 128 * 1024 * 1024
_PART_COST = 512 * 1024  # what the smallest part counts, so that open files are bounded too
_FILES_UNDER_WAY = 256
_AT_ONCE = 100
_RENEW_S = 20.0
_LINGER_S = 0.02
_GATHER_S = 0.5
_REFUSALS = 4
_JOIN_S = 2.0

_OF_ONE_FILE = (FileChanged, FileUnreadable, TransferFailed, UploadGone, NotFound)


class UploadPipeline:
    """Takes uploads that the server has agreed to, sends their parts and finishes them.

    `ended` is called once a file, from any thread. A failure of one file ends that file; any other stops everything.
    """

    def __init__(
        self,
        uploads: Uploads,
        stop: Stop,
        *,
        pace: RateLimit,
        link: LinkMonitor,
        watcher: Watcher,
        ended: Callable[[TransferResult], None],
    ) -> None:
        self._uploads = uploads
        self._stop = stop
        self._pace = pace
        self._watcher = watcher
        self._link = link
        self._ended = ended
        self._ahead = Budget(stop, AHEAD_BYTES)
        self._under_way = Budget(stop, _FILES_UNDER_WAY)
        self._to_sign: WorkQueue[FilePart] = WorkQueue(stop)
        self._to_send: WorkQueue[tuple[FilePart, SignedPart]] = WorkQueue(stop)
        self._to_finish: WorkQueue[FileUpload] = WorkQueue(stop)
        self._open: dict[uuid.UUID, FileUpload] = {}
        self._troubled = 0
        self._leases: dict[uuid.UUID, FileUpload] = {}
        self._threads: list[threading.Thread] = []

    def start(self, connections: int) -> None:
        """Start the threads; so many send."""
        self._store = StoreClient(connections)
        self._lane = Lane(self._stop, Window(connections))
        loops = [self._sign_loop, self._finish_loop, *[self._send_loop] * connections]
        self._threads = [threading.Thread(target=self._guard, args=(loop,), daemon=True) for loop in loops]
        for thread in self._threads:
            thread.start()

    def submit(self, sending: FileUpload) -> None:
        """Hash an upload's parts and queue those that the store does not hold; waits while enough is under way.

        Raises:
            Stopped: it is over.
        """
        self._under_way.acquire(1)
        self._open[sending.upload.id] = sending
        self._leases[sending.upload.id] = sending
        try:
            for number, offset, size in sending.ranges():
                if sending.ended:
                    break
                self._queue_part(sending, number, offset, size)
        except (FileChanged, FileUnreadable) as error:
            self._fail(sending, error)
        self._count_done(sending)

    def drain(self) -> None:
        """Wait until every upload submitted has ended.

        Raises:
            Stopped: it is over.
        """
        self._under_way.wait_until_free()

    def close(self) -> None:
        """Send the threads home and close what is open; journals stay for the next run."""
        self._stop.now()
        gives_up_at = time.monotonic() + _JOIN_S  # for all together: on a dead link each would take it whole
        for thread in self._threads:
            thread.join(max(0.0, gives_up_at - time.monotonic()))
        for sending in self._open.values():
            sending.source.close()
            sending.journal.close()
        self._store.close()

    def _guard(self, loop: Callable[[], None]) -> None:
        try:
            loop()
        except Stopped:
            return
        except BaseException as error:  # carried to the caller's thread, which raises it
            self._stop.now(error)

    def _queue_part(self, sending: FileUpload, number: int, offset: int, size_bytes: int) -> None:
        self._stop.check()
        checksum = sending.hash_part(number, offset, size_bytes)
        if sending.is_stored(number, size_bytes, checksum):
            self._watcher.skipped(sending.file.path, size_bytes, sending.file.size_bytes)
            return
        cost = max(size_bytes, _PART_COST)
        self._ahead.acquire(cost)
        sending.add_part()
        part = FilePart(sending, number, offset, size_bytes, checksum, cost)
        if sending.signed is None:
            self._to_sign.put(part)
        else:  # the server has signed it for what was announced, which is what was hashed
            self._to_send.put((part, sending.signed))

    # -- signing ------------------------------------------------------------------------------------------------------

    def _sign_loop(self) -> None:
        while True:
            parts = self._to_sign.take(_AT_ONCE, _RENEW_S)
            if 0 < len(parts) < _AT_ONCE:  # more come within moments: one request for all of them
                self._stop.wait(_LINGER_S)
                parts += self._to_sign.take(_AT_ONCE - len(parts), timeout_s=0)
            for part in parts:
                if part.sending.ended:
                    self._part_over(part)
            self._sign([part for part in parts if not part.sending.ended])
            self._renew_leases()

    def _sign(self, parts: Sequence[FilePart]) -> None:
        if not parts:
            return
        try:
            signed = self._uploads.sign([part.to_sign() for part in parts])
        except (UploadGone, NotFound) as error:
            self._sign_apart(parts, error)
            return
        for part, one in zip(parts, signed.items, strict=True):
            part.sending.renewed_at = time.monotonic()
            self._to_send.put((part, one))

    def _sign_apart(self, parts: Sequence[FilePart], error: KleinkramError) -> None:
        """One of several uploads has ended: find out which, so that the others go on."""
        uploads = {part.sending.upload.id: part.sending for part in parts}
        if len(uploads) == 1:
            for part in parts:
                self._fail(part.sending, error)
                self._part_over(part)
            return
        for sending in uploads.values():
            self._sign([part for part in parts if part.sending is sending])

    def _renew_leases(self) -> None:
        due = time.monotonic() - _RENEW_S
        for sending in [*self._leases.values()]:
            if sending.renewed_at < due and (latest := sending.latest()) is not None and not sending.ended:
                sending.renewed_at = time.monotonic()
                try:
                    self._uploads.sign([latest])
                except (UploadGone, NotFound) as error:
                    self._fail(sending, error)

    # -- sending ------------------------------------------------------------------------------------------------------

    def _send_loop(self) -> None:
        while True:
            for part, signed in self._to_send.take(1):
                try:
                    if not part.sending.ended:
                        self._send(part, signed)
                except _OF_ONE_FILE as error:
                    self._fail(part.sending, error)
                self._part_over(part)

    def _send(self, part: FilePart, signed: SignedPart) -> None:
        with self._lane.place() as place:
            self._send_in_turn(part, signed, place)

    def _send_in_turn(self, part: FilePart, signed: SignedPart, place: int) -> None:
        backoff: Backoff | None = None  # a part may be on its way for long, and be cut off then
        began_at = time.monotonic()
        shown = [0]
        refusals = 0
        while True:
            with self._lane.turn(place, part.size_bytes) as waited_s:
                if backoff is not None:
                    backoff.excuse(waited_s)
                if signed.expires_at <= self._uploads.now():  # spares sending it in vain
                    signed = self._uploads.sign([part.to_sign()]).items[0]
                answer = self._put(part, signed, shown)
            if answer.answer is StoreAnswer.taken:
                part.sending.record(part, answer.etag)
                self._troubled = 0
                return
            if answer.answer is StoreAnswer.gone:
                raise UploadGone(upload_id=str(part.sending.upload.id))
            if answer.answer is StoreAnswer.try_again:
                if backoff is None or self._lane.arrived_at > began_at:  # other parts arrive: the way is open
                    backoff, began_at = Backoff(PATIENCE_S, self._stop.wait), time.monotonic()
                self._link.lost(signed.url, backoff, answer.error, answer.why, answer.sent_bytes)
                if answer.error is None:
                    self._lane.step_out(place)
                if self._link.has_moved():
                    self._stop.wait(RECONNECT_S)
                elif not backoff.pause():
                    raise self._gave_up(signed.url, part, answer)
                if answer.error is not None:
                    continue  # the address is as good as before
            else:
                part.sending.source.check_unchanged()
                refusals += 1
                if refusals >= _REFUSALS:
                    raise TransferFailed(path=part.sending.file.path, reason=answer.reason)
            signed = self._uploads.sign([part.to_sign()]).items[0]

    def _put(self, part: FilePart, signed: SignedPart, shown: list[int]) -> PutResult:
        began_at = time.monotonic()
        sent = [0]
        answer = self._store.put(signed.url, signed.headers, part.size_bytes, self._body(part, sent, shown))
        took_s = time.monotonic() - began_at
        if answer.answer is StoreAnswer.taken:
            self._lane.arrived(part.size_bytes, took_s)
            self._link.arrived(took_s)
        elif answer.answer is StoreAnswer.try_again:
            self._lane.lost()
        return replace(answer, sent_bytes=sent[0])

    def _body(self, part: FilePart, sent: list[int], shown: list[int]) -> Iterator[FileSlice]:
        """Yield the part's bytes. Those that were `shown` at an earlier try are not shown again: no bar goes back."""
        for piece in part.sending.source.stretches(part.offset, part.size_bytes):
            self._stop.check()
            self._pace.spend(piece.length, self._stop.wait)
            yield piece
            sent[0] += piece.length
            if sent[0] > shown[0]:
                self._watcher.moved(part.sending.file.path, sent[0] - shown[0], part.sending.file.size_bytes)
                shown[0] = sent[0]

    def _gave_up(self, url: str, part: FilePart, answer: PutResult) -> KleinkramError:
        self._troubled += 1
        if answer.is_of_all or self._troubled > MOST_TROUBLED:
            return store_unreachable(url, answer.why)
        return StoreTroubled(path=part.sending.file.path, reason=answer.why)

    # -- finishing ----------------------------------------------------------------------------------------------------

    def _finish_loop(self) -> None:
        while True:
            ready = [sending for sending in self._all_sent() if self._is_unchanged(sending)]
            if not ready:
                continue
            outcomes = self._uploads.complete([sending.to_finish() for sending in ready])
            for sending, outcome in zip(ready, outcomes.items, strict=True):
                self._finished(sending, outcome)
                self._release(sending)

    def _all_sent(self) -> list[FileUpload]:
        """Wait for files that are all sent: for a good number of them, as long as others are on their way."""
        sent = self._to_finish.take(_AT_ONCE)
        gathers_until = time.monotonic() + _GATHER_S
        while (lacking := min(_AT_ONCE, self._under_way.used()) - len(sent)) > 0:
            left_s = gathers_until - time.monotonic()
            if left_s <= 0:
                break
            sent += self._to_finish.take(_AT_ONCE - len(sent), left_s, at_least=lacking)
        return sent

    def _is_unchanged(self, sending: FileUpload) -> bool:
        try:
            sending.source.check_unchanged()
        except FileChanged as error:
            self._fail(sending, error)
            self._release(sending)
            return False
        return True

    def _finished(self, sending: FileUpload, outcome: Completed | NotCompleted) -> None:
        if isinstance(outcome, NotCompleted):
            self._fail(sending, from_problem(outcome.problem))
        elif sending.end():
            sending.journal.forget()
            file_id = outcome.file.id if outcome.file else None
            self._ended(sending.result(Outcome.uploaded, file_id=file_id, sha256=sending.sha256()))

    # -- ends ---------------------------------------------------------------------------------------------------------

    def _fail(self, sending: FileUpload, error: KleinkramError) -> None:
        """End one file's upload; the others go on. What can be resumed keeps its journal."""
        self._stop.check()
        if not sending.end():
            return
        if isinstance(error, FileChanged | UploadGone):
            # Its name is free at once; it expires by itself where this cannot be notify.
            with contextlib.suppress(KleinkramError):
                self._uploads.abort(sending.upload.id)
        if not isinstance(error, TransferFailed | UploadIncomplete | FileUnreadable):
            sending.journal.forget()
        self._ended(sending.result(Outcome.refused, error=error))

    def _part_over(self, part: FilePart) -> None:
        self._ahead.release(part.cost)
        self._count_done(part.sending)

    def _count_done(self, sending: FileUpload) -> None:
        if not sending.part_done():
            return
        if sending.ended:
            self._release(sending)
        else:
            self._leases.pop(sending.upload.id, None)
            self._to_finish.put(sending)

    def _release(self, sending: FileUpload) -> None:
        """Close what a file's upload held open. Only once no thread reads it any more."""
        self._leases.pop(sending.upload.id, None)
        self._open.pop(sending.upload.id, None)
        sending.source.close()
        sending.journal.close()
        self._under_way.release(1)
