"""How a transfer ended, file by file."""

import enum
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.client.errors import ClientError
from kleinkram.client.transfer.link import LinkReport
from kleinkram.contract.errors import KleinkramError


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
