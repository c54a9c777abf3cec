"""What a transfer reports: its progress while it runs, and how each file ended."""

import enum
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from kleinkram.client.errors import ClientError
from kleinkram.client.transfer.link import LinkReport
from kleinkram.contract.errors import KleinkramError


class Watcher(Protocol):
    """What a transfer tells. Sizes in bytes."""

    def began(self, files: int, size_bytes: int) -> None:
        """The whole is known."""

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """So many more bytes of a file of `total_bytes` have moved; those that must move again count once."""

    def skipped(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """So many bytes of a file need not move: the other side has them."""

    def ended(self, path: str, outcome: str, reason: str | None) -> None:
        """A file is done, well or not."""

    def notify(self, text: str) -> None:
        """Something a person should know while waiting."""


class SilentObserver:
    """A watcher that looks away."""

    def began(self, files: int, size_bytes: int) -> None:
        """Do nothing."""

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Do nothing."""

    def skipped(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Do nothing."""

    def ended(self, path: str, outcome: str, reason: str | None) -> None:
        """Do nothing."""

    def notify(self, text: str) -> None:
        """Do nothing."""


class Outcome(str, enum.Enum):
    """What became of one file. `present`: the other side has this very file; `linked`: the server had the bytes."""

    uploaded = "uploaded"
    present = "present"
    linked = "linked"
    downloaded = "downloaded"
    refused = "refused"


@dataclass(frozen=True)
class TransferResult:
    """One file's end. `path` is the one in the mission, `moved_bytes` what this run moved; `error` says why refused."""

    path: str
    local: Path
    size_bytes: int
    outcome: Outcome
    moved_bytes: int = 0
    file_id: uuid.UUID | None = None
    sha256: str | None = None
    error: KleinkramError | None = None


@dataclass(frozen=True)
class TransferReport:
    """All files' ends, what was left out before anything began, and how the network was meanwhile."""

    results: Sequence[TransferResult]
    left_out: Sequence[ClientError] = field(default_factory=list)
    link: LinkReport = field(default_factory=LinkReport)

    @property
    def failures(self) -> list[KleinkramError]:
        """Why files were refused, in order."""
        return [result.error for result in self.results if result.error is not None]
