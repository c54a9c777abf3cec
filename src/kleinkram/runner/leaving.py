"""Sending what a run left, and its log, to the store: by the protocol that all uploads follow."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kleinkram.client.errors import StoreTroubled
from kleinkram.client.runners import ArtifactUploads
from kleinkram.client.transfer.plan import LocalFile, identity_of
from kleinkram.client.transfer.report import SilentObserver, TransferResult
from kleinkram.client.transfer.threads import RateLimit
from kleinkram.client.transfer.upload import Uploader
from kleinkram.contract.runners import LOG_PATH, RunAssignment
from kleinkram.runner.results import Artifact

_CONNECTIONS = 4


@dataclass(frozen=True)
class Refused:
    """A file that was not kept, and why."""

    path: str
    why: str
    # It was no refusal: the store is in trouble.
    may_pass: bool = False


class Leaving:
    """One run's files on their way. `end`, from another thread, has `send` return soon."""

    def __init__(self, uploads: ArtifactUploads, server: str, claim: RunAssignment, journals: Path) -> None:
        self._claim = claim
        self._results: list[TransferResult] = []
        self._lock = threading.Lock()
        self._uploader = Uploader(
            uploads,
            server,
            claim.run_id,
            pace=RateLimit(None),
            watcher=SilentObserver(),
            ended=self._ended,
            journals=journals,
        )

    def send(self, files: Sequence[LocalFile]) -> list[Refused]:
        """Send files; return those that could not be kept. What is in the store already is not sent again.

        Raises:
            RunGone: the run is not this runner's.
            ServerUnreachable, StoreUnreachable: one of them stayed away.
        """
        self._uploader.run(files, min(_CONNECTIONS, len(files)))
        return [
            Refused(result.path, str(result.error), may_pass=isinstance(result.error, StoreTroubled))
            for result in self._results
            if result.error is not None
        ]

    def end(self) -> None:
        """End it."""
        self._uploader.end()

    def _ended(self, result: TransferResult) -> None:
        with self._lock:
            self._results.append(result)


def artifact_file(out: Path, artifact: Artifact) -> LocalFile | None:
    """Return an artifact as a file to send, or None where no file has that name."""
    source = out / artifact.path
    try:
        return LocalFile(source, artifact.path, identity_of(source.lstat()))
    except FileNotFoundError:
        return None


def log_file(source: Path) -> LocalFile:
    """Return a run's whole log as a file to send."""
    return LocalFile(source, LOG_PATH, identity_of(source.stat()))
