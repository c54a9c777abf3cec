"""Bringing a run's inputs into the cache and from there into its folder: signed addresses, resumed where they break."""

import threading
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from pathlib import Path

import urllib3

from kleinkram.client._retry import Backoff
from kleinkram.client.runners import Runners
from kleinkram.client.transfer.store import PATIENCE_S, StoreAnswer, StoreClient
from kleinkram.contract.runners import AssignedInput, InputsRequest, RunAssignment
from kleinkram.contract.runs import EndReason
from kleinkram.runner.cache import Cache, Damaged, NoRoom, Part, Wanted
from kleinkram.runner.given import check_place
from kleinkram.runner.orders import Orders
from kleinkram.runner.work import CannotStart, Ending

_AT_ONCE = 4
_ADDRESSES_AT_ONCE = 500
_SLICE_BYTES = 256 * 2**10
_LOOK_EVERY_S = 0.1
_REFUSALS = 4


class InputFetcher:
    """Fetches the inputs of one run. `store` is shared by all runs."""

    def __init__(
        self, runners: Runners, store: StoreClient, cache: Cache, claim: RunAssignment, orders: Orders
    ) -> None:
        self._runners = runners.with_patience(PATIENCE_S, orders.wait)
        self._store = store
        self._cache = cache
        self._claim = claim
        self._orders = orders
        self._urls: dict[str, str] = {}
        self._lock = threading.Lock()
        self._is_over = threading.Event()

    def lay(self, folder: Path, *, may_share: bool) -> None:
        """Have all inputs of the run in a folder, under their paths, to be read only.

        They are the cache's own where the run `may_share` them, since it cannot change them; else copies.

        Raises:
            CannotStart: one cannot be had, or there is no room.
            Told: the run is to end.
            RunGone: it is not this runner's.
        """
        inputs = {_place(each): each for each in self._claim.inputs}
        wanted = {path: Wanted(each.sha256, each.size_bytes) for path, each in inputs.items()}
        with self._cache.pinned(wanted.values()):
            missing = self._cache.missing(wanted.values())
            try:
                if missing:
                    self._cache.make_room(missing)
                    self._fetch_all(missing)
                for path, each in wanted.items():
                    target = folder / path
                    target.parent.mkdir(parents=True, exist_ok=True)
                    (self._cache.link if may_share else self._cache.copy)(each, target)
            except NoRoom as error:
                raise _unavailable(str(error)) from error
            except OSError as error:
                raise _unavailable(f"Its inputs cannot be laid out: {error.strerror}.") from error

    def _fetch_all(self, missing: Sequence[Wanted]) -> None:
        paths = {each.sha256: each.path for each in self._claim.inputs}
        pool = ThreadPoolExecutor(min(_AT_ONCE, len(missing)), "fetch")
        try:
            for at in range(0, len(missing), _ADDRESSES_AT_ONCE):
                batch = missing[at : at + _ADDRESSES_AT_ONCE]
                self._ask([paths[each.sha256] for each in batch])
                self._wait_for({pool.submit(self._fetch, each, paths[each.sha256]) for each in batch})
        finally:
            # Nobody waits for a store that does not answer: whoever asked it sees later that it is over.
            self._is_over.set()
            pool.shutdown(wait=False, cancel_futures=True)

    def _wait_for(self, coming: set[Future[None]]) -> None:
        while coming:
            done, coming = wait(coming, timeout=_LOOK_EVERY_S, return_when=FIRST_EXCEPTION)
            for each in done:
                each.result()
            self._orders.check()

    def _fetch(self, wanted: Wanted, path: str) -> None:
        try:
            self._cache.get(wanted, lambda part: self._receive(part, path), self._orders.wait)
        except Damaged as error:
            raise _unavailable(f"The input {path} is damaged: {error}.") from error

    def _check(self) -> None:
        self._orders.check()
        if self._is_over.is_set():
            raise _unavailable("Another input could not be had.")

    def _ask(self, paths: Sequence[str]) -> None:
        ask = InputsRequest(attempt=self._claim.attempt, paths=[*paths])
        urls = self._runners.inputs(self._claim.run_id, ask).urls
        with self._lock:
            self._urls.update(zip(paths, urls, strict=True))

    def _receive(self, part: Part, path: str) -> None:
        """Take what is missing of a file, from wherever the last connection broke off."""
        backoff, refusals = Backoff(PATIENCE_S, self._orders.wait), 0
        while part.offset < part.wanted.size_bytes:
            self._check()
            before = part.offset
            answer = self._store.get(self._urls[path], before, part.wanted.size_bytes - 1, _SLICE_BYTES)
            try:
                for data in answer.slices():
                    part.add(data)
                    self._check()
            except urllib3.exceptions.HTTPError as error:
                answer.error = error
            finally:
                answer.close()
            if part.offset > before:
                backoff = Backoff(PATIENCE_S, self._orders.wait)
            elif answer.answer is StoreAnswer.sign_again and refusals < _REFUSALS:
                refusals += 1
                self._ask([path])
            elif answer.answer in {StoreAnswer.taken, StoreAnswer.try_again}:
                if not backoff.pause():
                    raise _unavailable(f"The input {path} cannot be fetched: {answer.why}.")
            else:
                raise _unavailable(f"The input {path} cannot be fetched: {answer.reason}.")


def _place(given: AssignedInput) -> str:
    try:
        return check_place(given.path)
    except ValueError as error:
        raise _unavailable(f"The file {given.path} {error}.") from error


def _unavailable(message: str) -> CannotStart:
    return CannotStart(Ending(EndReason.inputs_unavailable, message))
