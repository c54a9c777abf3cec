"""Adapting a transfer to its network, and telling the person who waits about trouble.

`Window` decides how many bytes may be on their way at once, `Lane` makes the threads of a transfer keep to it, and
`LinkMonitor` counts lost connections and reports them.
"""

import contextlib
import errno
import itertools
import socket
import threading
import time
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import urllib3

from kleinkram.client._http import Backoff, reason_of, store_unreachable
from kleinkram.client._network import SILENCE_S, NetworkMonitor
from kleinkram.client.errors import ServerUnreachable, StoreTroubled, StoreUnreachable
from kleinkram.client.transfer.report import LinkReport
from kleinkram.client.transfer.store import MAX_FAILED_FILES, PATIENCE_S, StoreResult
from kleinkram.client.transfer.threads import Stop, Stopped
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.uploads import MIN_PART_BYTES

# A part that takes less leaves room for another beside it; one that takes more has too many beside it.
QUICK_S, SLOW_S = 5.0, 15.0
# After a lost connection, and on a link that is neither quick nor slow, the next step up waits for so long.
CALM_S = 60.0
QUICK_AFTER_LOSS_S = 1.0
_NOTIFY_AFTER_S, _NOTIFY_AGAIN_S = 5.0, 60.0
_PROBE_S = 3.0
_NO_ROUTE = frozenset({errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EADDRNOTAVAIL, errno.ENETDOWN})
_RECONNECT_S = 0.05
_MOVED_S = 1.0


class CongestionWindow:
    """How many bytes may be on their way at once. Not safe to share between threads.

    It begins with one part. A part that arrives quickly adds its size, up to `connections` parts. A lost connection, or
    parts that take long, leave one part. On a link in between, one is added after a calm minute: several connections
    may be faster than one where each is limited by itself.
    """

    def __init__(self, connections: int, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._connections = connections
        self._clock = clock
        self._calm_since = clock()
        self._has_lost = False
        self.limit_bytes = MIN_PART_BYTES

    def arrived(self, size_bytes: int, took_s: float) -> None:
        """Adapt to a part that arrived."""
        unit_bytes = max(size_bytes, MIN_PART_BYTES)
        took_s *= MIN_PART_BYTES / unit_bytes
        is_calm = self._clock() - self._calm_since >= CALM_S
        self._has_lost = self._has_lost and not is_calm
        is_quick = took_s <= (QUICK_AFTER_LOSS_S if self._has_lost else QUICK_S)
        if took_s > SLOW_S:
            self.limit_bytes = max(MIN_PART_BYTES, self.limit_bytes // 2)
            self._calm_since = self._clock()
        elif is_quick or is_calm:
            most_bytes = self._connections * unit_bytes
            self.limit_bytes = max(self.limit_bytes, min(self.limit_bytes + size_bytes, most_bytes))
            if not is_quick:
                self._calm_since = self._clock()

    def lost(self) -> None:
        """Adapt to a connection that broke, or to a store that asks for less."""
        self.limit_bytes = MIN_PART_BYTES
        self._calm_since = self._clock()
        self._has_lost = True


class Lane:
    """Admits parts to the link in order, as its window allows; one may always go. Shared by the threads of a transfer.

    A part that broke off continues before others begin, so that a bad link is not filled with beginnings of parts.
    """

    def __init__(self, stop: Stop, window: CongestionWindow) -> None:
        self._stop = stop
        self._window = window
        self._used_bytes = 0
        self._places = itertools.count()
        self._line: list[int] = []
        self._moving: set[int] = set()
        self._changed = stop.condition()
        self.arrived_at = time.monotonic()

    @contextlib.contextmanager
    def place(self) -> Iterator[int]:
        """Hold a place in the line, in turns and between them."""
        with self._changed:
            place = next(self._places)
            self._line.append(place)
        try:
            yield place
        finally:
            self.step_out(place)

    def step_out(self, place: int) -> None:
        """Leave the line, for trouble that concerns this part alone. The next turn waits at its end."""
        with self._changed:
            if place in self._line:
                self._line.remove(place)
            self._changed.notify_all()

    @contextlib.contextmanager
    def turn(self, place: int, size_bytes: int) -> Iterator[float]:
        """Wait for room for a part, and hold it; yields how many seconds it waited."""
        began_at = time.monotonic()
        with self._changed:
            if place not in self._line:
                self._line.append(place)
            while not self._may_go(place, size_bytes):
                self._stop.check()
                self._changed.wait()
            self._stop.check()
            self._used_bytes += size_bytes
            self._moving.add(place)
            self._changed.notify_all()
        try:
            yield time.monotonic() - began_at
        finally:
            with self._changed:
                self._used_bytes -= size_bytes
                self._moving.remove(place)
                self._changed.notify_all()

    def _may_go(self, place: int, size_bytes: int) -> bool:
        if any(earlier not in self._moving for earlier in self._line[: self._line.index(place)]):
            return False
        return self._used_bytes == 0 or self._used_bytes + size_bytes <= self._window.limit_bytes

    def arrived(self, size_bytes: int, took_s: float) -> None:
        """Adapt to a part that arrived."""
        with self._changed:
            self._window.arrived(size_bytes, took_s)
            self.arrived_at = time.monotonic()

    def lost(self) -> None:
        """Adapt to a part that did not arrive."""
        with self._changed:
            self._window.lost()


class LinkMonitor:
    """Tells a person while the link or the store keeps a transfer waiting. Shared by the threads of the transfer."""

    def __init__(self, notify: Callable[[str], None], *, clock: Callable[[], float] = time.monotonic) -> None:
        self._notify = notify
        self._clock = clock
        self._lock = threading.Lock()
        self._connections_lost = self._network_changes = self._resent_bytes = 0
        self._longest_outage_s = 0.0
        self._outage_since: float | None = None
        self._moved_at = float("-inf")
        self._notified_at: dict[str, float] = {}
        self._store_url: str | None = None
        self._troubled_files = 0

    def watch(self, stop: Stop, api_url: str, work: Callable[[], None]) -> None:
        """Do the work of a transfer while watching the network; explain and raise the failure that ended it."""
        failure: BaseException | None = None
        try:
            with NetworkMonitor(self.moved), contextlib.suppress(Stopped):
                work()
        except KleinkramError as error:
            failure = error
        stop.now()
        failure = failure or stop.failure
        if failure is None:
            return
        if isinstance(failure, ServerUnreachable | StoreUnreachable):
            self._notify(diagnose(api_url, self._store_url))
        if (advice := self.report().advice()) is not None:
            self._notify(advice)
        raise failure

    def report(self) -> LinkReport:
        """Return what happened so far."""
        with self._lock:
            return LinkReport(
                self._connections_lost, self._network_changes, round(self._longest_outage_s, 1), self._resent_bytes
            )

    def moved(self, address: str | None) -> None:
        """Report that this machine lost an address, or, for None, that its old connections get no answer."""
        with self._lock:
            self._network_changes += 1
            self._moved_at = self._clock()
        if address is not None:
            self._say("address", f"this machine no longer has the address {address} (another network?), reconnecting")
        else:
            self._say("path", "old connections get no answer and new ones do (another network?), reconnecting")

    def has_moved(self) -> bool:
        """Say whether a connection broke just now because the address changed."""
        return self._clock() - self._moved_at < _MOVED_S

    def pause(self, backoff: Backoff, stop: Stop) -> bool:
        """Wait before the next try, briefly where the address changed; return False when patience has run out."""
        if not self.has_moved():
            return backoff.pause()
        stop.wait(_RECONNECT_S)
        return True

    def give_up(self, url: str, path: str, result: StoreResult) -> KleinkramError:
        """Return the error for a file that the store refused for too long: the store's own after several files."""
        self._troubled_files += 1
        if result.is_store_wide or self._troubled_files > MAX_FAILED_FILES:
            return store_unreachable(url, result.why)
        return StoreTroubled(path=path, reason=result.why)

    def lost(self, url: str, backoff: Backoff, error: BaseException | None, reason: str, resent_bytes: int = 0) -> None:
        """Count a failed try, and report trouble that lasts. `error` is that of the connection, if any."""
        silent = is_silence(error)
        self._store_url = url
        with self._lock:
            self._resent_bytes += resent_bytes
            if error is not None:
                self._connections_lost += 1
            if self._outage_since is None:
                self._outage_since = self._clock() - (SILENCE_S if silent else 0.0)
        host = urlsplit(url).netloc
        if silent:
            self._say("silence", f"no answer for {SILENCE_S} s from {host}, reconnecting", _NOTIFY_AGAIN_S)
        elif backoff.lasting_s() < _NOTIFY_AFTER_S:
            return
        elif has_no_network(error):
            text = f"this machine cannot reach {host} ({reason}): it may have no network; trying again"
            self._say("network", text, _NOTIFY_AGAIN_S)
        else:
            text = (
                f"waiting for the store, which is away or full ({reason}): goes on by itself if that ends within "
                f"{PATIENCE_S / 60:.0f} minutes; `klein doctor` on the server's machine says what is wrong"
            )
            self._say("trouble", text, PATIENCE_S)

    def waits_for_server(self, url: str) -> None:
        """Report that the API does not answer."""
        with self._lock:
            if self._outage_since is None:
                self._outage_since = self._clock()
            lasting_s = self._clock() - self._outage_since
        if lasting_s >= _NOTIFY_AFTER_S:
            self._say("server", f"waiting for {url}, which does not answer", PATIENCE_S)

    def arrived(self, took_s: float = 0.0) -> None:
        """Note that bytes arrived, by a try that took so long."""
        self._troubled_files = 0
        if self._outage_since is None:
            return
        with self._lock:
            if self._outage_since is None:
                return
            outage_s = max(0.0, self._clock() - took_s - self._outage_since)
            self._longest_outage_s = max(self._longest_outage_s, outage_s)
            self._outage_since = None
        if outage_s >= _NOTIFY_AFTER_S:
            self._notify(f"connected again after {outage_s:.0f} s")
            self._notified_at.clear()

    def _say(self, kind: str, text: str, again_after_s: float = _NOTIFY_AFTER_S) -> None:
        with self._lock:
            now = self._clock()
            is_new = now - self._notified_at.get(kind, float("-inf")) >= again_after_s
            if is_new:
                self._notified_at[kind] = now
        if is_new:
            self._notify(text)


def is_silence(error: BaseException | None) -> bool:
    """Say whether a connection ended because the other side was silent, not because it closed or refused."""
    if has_no_network(error):
        return False
    for cause in _causes(error):
        is_refusal = isinstance(cause, urllib3.exceptions.NewConnectionError)  # for urllib3 a timeout, too
        if isinstance(cause, TimeoutError | urllib3.exceptions.TimeoutError) and not is_refusal:
            return True
        if isinstance(cause, OSError) and cause.errno in {errno.ETIMEDOUT, *_NO_ROUTE}:
            return True  # the kernel gave up
    return False


def has_no_network(error: BaseException | None) -> bool:
    """Say whether no connection could be made because this machine has no route, no address, or no name server."""
    causes = [*_causes(error)]
    return any(isinstance(cause, urllib3.exceptions.NewConnectionError) for cause in causes) and any(
        isinstance(cause, socket.gaierror) or (isinstance(cause, OSError) and cause.errno in _NO_ROUTE)
        for cause in causes
    )


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        inner = getattr(error, "reason", None) or error.__cause__ or error.__context__
        error = inner if isinstance(inner, BaseException) else None


def diagnose(api_url: str, store_url: str | None) -> str:
    """Return which part of the way to the server does not work, by trying it now: some seconds."""
    places = [("the server", api_url)] + ([("the store", store_url)] if store_url else [])
    reachability = [(what, urlsplit(url).netloc, _try_to_connect(url)) for what, url in places]
    failed = [f"{what} ({place}) cannot be reached: {reason}" for what, place, reason in reachability if reason]
    if not failed:
        again = "It can be reached" if len(places) == 1 else "Both can be reached"
        return f"{again} again now. Run the same command again; what has arrived stays."
    if len(failed) < len(reachability):
        works = ", ".join(f"{what} ({place}) answers" for what, place, reason in reachability if not reason)
        return f"{failed[0]}, while {works}. Ask an admin: a part of the server is down, or behind a firewall."
    return f"{'; '.join(failed)}. Look at this machine's network first: cable, Wi-Fi, VPN, name server."


def _try_to_connect(url: str) -> str | None:
    parts = urlsplit(url)
    host, port = parts.hostname or "", parts.port or (443 if parts.scheme == "https" else 80)
    try:
        socket.create_connection((host, port), timeout=_PROBE_S).close()
    except socket.gaierror:
        return f"the name {host!r} cannot be resolved"
    except OSError as error:
        return "this machine has no route to it" if error.errno in _NO_ROUTE else reason_of(error)
    return None
