"""What an executor is asked to do, and how it ends. The only words that runner and executors share.

A run has a folder, which outlives the process of the runner:

    in/       what the run is given; read-only for it
    out/      what it leaves
    tmp/      its scratch
    log       what it wrote to stdout and stderr, up to `LOG_BYTES`
    ...       and what the executor keeps beside
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.runners import ExecutorAbilities
from kleinkram.contract.runs import EndReason, Usage

GRACE_S = 3.0


@dataclass(frozen=True)
class Door:
    """A way out for a run with the network `api`: what it reaches as `host` and `port` is the target, and only that.

    A run sees `host` and `port` as they stand in the URL of the API or of the store; the target is from the runner.
    """

    host: str
    port: int
    target_host: str
    target_port: int


@dataclass(frozen=True)
class ImagePinned:
    """An image at hand. `reference` names it for `Work.image` on this machine, `digest` (`sha256:…`) everywhere."""

    reference: str
    digest: str


@dataclass(frozen=True)
class Work:
    """One attempt at a run. `key` is its name on this machine: unique among all attempts, of letters, digits, `-`.

    `command` empty: the image's own. Otherwise it is what `docker run` would be given after the image.
    """

    key: str
    folder: Path
    command: Sequence[str]
    image: str | None
    resources: Resources
    network: Network
    environment: Mapping[str, str] = field(default_factory=dict)
    doors: tuple[Door, ...] = ()


@dataclass(frozen=True)
class Ending:
    """How a run came to its end: why, with which exit code where the command had one, and what people are told."""

    reason: EndReason
    message: str
    exit_code: int | None = None


class CannotStart(Exception):
    """A run could not be started, for a reason that another attempt here would meet again."""

    def __init__(self, ending: Ending) -> None:
        super().__init__(ending.message)
        self.ending = ending


class Executor(Protocol):
    """Starts runs, watches them, ends them, and finds them again after a restart of the runner."""

    @property
    def abilities(self) -> ExecutorAbilities:
        """What it can do on this machine."""

    def prepare(self, image: str) -> ImagePinned:
        """Have an image at hand, fetched where that is needed and allowed, which may take long.

        Raises:
            CannotStart: it cannot be had.
        """

    def start(self, work: Work) -> None:
        """Start a run and return while it lasts.

        Raises:
            CannotStart: it cannot be started.
        """

    def wait(self, work: Work, timeout_s: float) -> Ending | None:
        """Return how a run ended, or None if it goes on for longer than `timeout_s`."""

    def stop(self, work: Work) -> None:
        """Ask a run to end, and kill it `GRACE_S` later; return at once. Nothing happens to one that is over.

        Raises:
            OSError: this machine does not let it be asked now; it may be tried again.
        """

    def usage(self, work: Work) -> Usage | None:
        """Return what a run uses, or None where it is over or unknown."""

    def remove(self, work: Work) -> None:
        """Kill what is left of a run and forget it; its folder stays."""

    def sweep(self, known: Collection[str]) -> None:
        """Kill what is left of this runner's runs, but for those with a known key."""
