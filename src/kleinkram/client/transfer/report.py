"""What a transfer reports: its progress while it runs, how each file ended, and how the network was."""

import enum
import threading
import uuid
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.client.errors import ClientError
from kleinkram.contract.errors import KleinkramError

CONNECTIONS = 4


class Watcher:
    """Receives the progress of a transfer, from any thread; does nothing with it. Sizes in bytes."""

    def began(self, files: int, size_bytes: int) -> None:
        """Receive the size of the whole."""

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Receive that more bytes of a file of `total_bytes` have moved. Bytes that move again count once."""

    def skipped(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Receive that bytes of a file need not move: the other side has them."""

    def ended(self, path: str, outcome: str, reason: str | None) -> None:
        """Receive the end of a file."""

    def notify(self, text: str) -> None:
        """Receive a message for the person who waits."""


class Outcome(str, enum.Enum):
    """How a file ended. `already_present`: the other side has this file; `deduplicated`: the server had these bytes."""

    uploaded = "uploaded"
    already_present = "already_present"
    deduplicated = "deduplicated"
    downloaded = "downloaded"
    refused = "refused"


@dataclass(frozen=True)
class TransferResult:
    """The end of one file: its path in the mission, the bytes that this run moved, and why it failed."""

    path: str
    local: Path
    size_bytes: int
    outcome: Outcome
    moved_bytes: int = 0
    file_id: uuid.UUID | None = None
    sha256: str | None = None
    error: KleinkramError | None = None


class ResultCollector:
    """Collects the results of a transfer by key. Safe to share between threads."""

    def __init__(self, watcher: Watcher) -> None:
        self._watcher = watcher
        self._lock = threading.Lock()
        self._results: dict[Hashable, TransferResult] = {}

    def add(self, key: Hashable, result: TransferResult) -> None:
        """Keep a result, and pass it to the watcher."""
        with self._lock:
            self._results[key] = result
        self._watcher.ended(result.path, result.outcome.value, str(result.error) if result.error else None)

    def in_order(self, keys: Sequence[Hashable]) -> list[TransferResult]:
        """Return the results of these keys."""
        return [self._results[key] for key in keys]


@dataclass(frozen=True)
class LinkReport:
    """How the network was during a transfer.

    `network_changes`: how often this machine got another address, or a router before it did. `longest_outage_s` is the
    longest time in which nothing arrived. `resent_bytes` were given to the network and had to be sent again.
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
            remedy = "a cable, a place nearer to the access point, or --connections 1 may help"
        return f"The network was unsteady: {', '.join(facts)}. If this is frequent: {remedy}."


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


@dataclass(frozen=True)
class TransferReport:
    """The ends of all files, what was left out before anything began, and how the network was."""

    results: Sequence[TransferResult]
    left_out: Sequence[ClientError] = field(default_factory=list)
    link: LinkReport = field(default_factory=LinkReport)

    @property
    def failures(self) -> list[KleinkramError]:
        """Why files were refused, in order."""
        return [result.error for result in self.results if result.error is not None]
