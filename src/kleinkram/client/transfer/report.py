"""What a transfer reports: its progress while it runs, the result for each file, and trouble with the network."""

import enum
import errno
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import urllib3

from kleinkram.client._http import Backoff, reason_of
from kleinkram.client._network import SILENCE_S
from kleinkram.client.errors import ClientError
from kleinkram.client.transfer.store import TRANSFER_RETRY_S
from kleinkram.contract.errors import KleinkramError

CONNECTIONS = 4
_NOTIFY_AFTER_S, _NOTIFY_AGAIN_S = 5.0, 60.0
_PROBE_S = 3.0
_NETWORK_CHANGE_S = 1.0
_NO_ROUTE = frozenset({errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EADDRNOTAVAIL, errno.ENETDOWN})


class Watcher:
    """Receives the progress of a transfer, from any thread; does nothing with it. Sizes in bytes."""

    def began(self, files: int, size_bytes: int) -> None:
        """Receive how much the transfer has to do."""

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Receive that bytes of a file of `total_bytes` have moved; bytes that are sent again are not repeated."""

    def skipped(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Receive that bytes of a file need not move, because the other side has them."""

    def ended(self, path: str, outcome: str, reason: str | None) -> None:
        """Receive the end of a file."""

    def notify(self, text: str) -> None:
        """Receive a message for the user."""


class Outcome(str, enum.Enum):
    """How a file ended. `already_present`: the other side has this file; `deduplicated`: the server had these bytes."""

    uploaded = "uploaded"
    already_present = "already_present"
    deduplicated = "deduplicated"
    downloaded = "downloaded"
    refused = "refused"


@dataclass(frozen=True)
class TransferResult:
    """The result for one file: its path in the mission, the bytes that this run moved, and why it failed.

    `losses`: of a slice of a damaged recording, what could not be read.
    """

    path: str
    local: Path
    size_bytes: int
    outcome: Outcome
    moved_bytes: int = 0
    file_id: uuid.UUID | None = None
    sha256: str | None = None
    error: KleinkramError | None = None
    losses: Sequence[str] = ()


@dataclass(frozen=True)
class LinkReport:
    """How the network was during a transfer.

    `network_changes`: how often this machine, or a router in front of it, got another address. `longest_outage_s`: the
    longest time in which nothing arrived. `resent_bytes`: bytes that had to be sent again.
    """

    connections_lost: int = 0
    network_changes: int = 0
    longest_outage_s: float = 0.0
    resent_bytes: int = 0

    def advice(self) -> str | None:
        """Return what happened and what to try; None where there was no trouble."""
        if self.connections_lost == 0:
            return None
        facts = [_count(self.connections_lost, "connection was lost", "connections were lost")]
        if self.network_changes:
            facts.append(f"this machine's network changed {_count(self.network_changes, 'time', 'times')}")
        if self.longest_outage_s >= 1:
            facts.append(f"the longest outage was {self.longest_outage_s:.0f} s")
        if self.resent_bytes:
            facts.append(f"{self.resent_bytes / 1e6:.1f} MB had to be sent again")
        if self.network_changes:
            remedy = "the robot moves between networks: a cable, or one access point for the upload, avoids this"
        else:
            remedy = "a cable, a spot nearer to the access point, or --connections 1 may help"
        return f"The network was unsteady: {', '.join(facts)}. If this is frequent: {remedy}."


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


@dataclass(frozen=True)
class TransferReport:
    """The results of all files, what was left out before the transfer began, and how the network was."""

    results: Sequence[TransferResult]
    left_out: Sequence[ClientError] = field(default_factory=list)
    link: LinkReport = field(default_factory=LinkReport)

    @property
    def failures(self) -> list[KleinkramError]:
        """Why files were refused, in order."""
        return [result.error for result in self.results if result.error is not None]


class OutageReporter:
    """Notifies the user while the network or the store delays a transfer. Safe to share between threads."""

    def __init__(self, notify: Callable[[str], None], *, clock: Callable[[], float] = time.monotonic) -> None:
        self._notify = notify
        self._clock = clock
        self._lock = threading.Lock()
        self._connections_lost = self._network_changes = self._resent_bytes = 0
        self._longest_outage_s = 0.0
        self._outage_since: float | None = None
        self._network_changed_at = float("-inf")
        self._notified_at: dict[str, float] = {}
        self.store_url: str | None = None

    def report(self) -> LinkReport:
        """Return what happened so far."""
        with self._lock:
            return LinkReport(
                self._connections_lost, self._network_changes, round(self._longest_outage_s, 1), self._resent_bytes
            )

    def network_changed(self, address: str | None) -> None:
        """Report that this machine lost an address; None: its old connections get no answer."""
        with self._lock:
            self._network_changes += 1
            self._network_changed_at = self._clock()
        if address is not None:
            text = f"this machine no longer has the address {address} (another network?), reconnecting"
            self._notify_once("address", text)
        else:
            self._notify_once("path", "old connections get no answer and new ones do (another network?), reconnecting")

    def is_network_changed(self) -> bool:
        """Return whether the network changed less than a second ago."""
        return self._clock() - self._network_changed_at < _NETWORK_CHANGE_S

    def lost(self, url: str, backoff: Backoff, error: BaseException | None, reason: str, resent_bytes: int = 0) -> None:
        """Count a failed request to the store, and report trouble that lasts. `error`: that of the connection."""
        silent = is_silence(error)
        self.store_url = url
        with self._lock:
            self._resent_bytes += resent_bytes
            if error is not None:
                self._connections_lost += 1
            if self._outage_since is None:
                self._outage_since = self._clock() - (SILENCE_S if silent else 0.0)
        host = urlsplit(url).netloc
        if silent:
            self._notify_once("silence", f"no answer for {SILENCE_S} s from {host}, reconnecting", _NOTIFY_AGAIN_S)
        elif backoff.lasting_s() < _NOTIFY_AFTER_S:
            return
        elif has_no_network(error):
            text = f"this machine cannot reach {host} ({reason}): it may have no network; trying again"
            self._notify_once("network", text, _NOTIFY_AGAIN_S)
        else:
            text = (
                f"the store is unreachable or full ({reason}); retrying for up to "
                f"{TRANSFER_RETRY_S / 60:.0f} minutes; `klein doctor` on the server's machine says what is wrong"
            )
            self._notify_once("trouble", text, TRANSFER_RETRY_S)

    def server_unavailable(self, url: str) -> None:
        """Report that the API does not answer."""
        with self._lock:
            if self._outage_since is None:
                self._outage_since = self._clock()
            lasting_s = self._clock() - self._outage_since
        if lasting_s >= _NOTIFY_AFTER_S:
            self._notify_once("server", f"waiting for {url}, which does not answer", TRANSFER_RETRY_S)

    def arrived(self, took_s: float = 0.0) -> None:
        """Record that bytes arrived, by a request that took so long."""
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

    def _notify_once(self, kind: str, text: str, again_after_s: float = _NOTIFY_AFTER_S) -> None:
        with self._lock:
            now = self._clock()
            is_new = now - self._notified_at.get(kind, float("-inf")) >= again_after_s
            if is_new:
                self._notified_at[kind] = now
        if is_new:
            self._notify(text)


def is_silence(error: BaseException | None) -> bool:
    """Return whether a connection ended because the other side was silent, rather than closed or refused it."""
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
    """Return whether no connection could be made because this machine has no route, address or name server."""
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
    """Connect to the server and the store, and return which of them cannot be reached; takes some seconds."""
    urls = [("the server", api_url)] + ([("the store", store_url)] if store_url else [])
    probes = [(what, urlsplit(url).netloc, _probe(url)) for what, url in urls]
    failed = [f"{what} ({host}) cannot be reached: {reason}" for what, host, reason in probes if reason]
    if not failed:
        again = "It can be reached" if len(urls) == 1 else "Both can be reached"
        return f"{again} again now. Run the same command again; what has arrived stays."
    if len(failed) < len(probes):
        works = ", ".join(f"{what} ({host}) answers" for what, host, reason in probes if not reason)
        return f"{failed[0]}, while {works}. Ask an admin: a part of the server is down, or behind a firewall."
    return f"{'; '.join(failed)}. Look at this machine's network first: cable, Wi-Fi, VPN, name server."


def _probe(url: str) -> str | None:
    """Connect to a URL; return why that failed, or None."""
    parts = urlsplit(url)
    host, port = parts.hostname or "", parts.port or (443 if parts.scheme == "https" else 80)
    try:
        socket.create_connection((host, port), timeout=_PROBE_S).close()
    except socket.gaierror:
        return f"the name {host!r} cannot be resolved"
    except OSError as error:
        return "this machine has no route to it" if error.errno in _NO_ROUTE else reason_of(error)
    return None
