"""What a runner knows of one attempt at a run, written down before it acts, so that a kill loses nothing.

runs/<run>-<attempt>/
    state.json      the claim, and what it is at
    in out tmp log  the executor's
    log.json        how much of the log is in the store
"""

import enum
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.contract.runners import RunAssignment
from kleinkram.contract.runs import EndReason, Usage
from kleinkram.runner.disk import remove_tree, write_whole
from kleinkram.runner.logs import LOG, LOG_STATE
from kleinkram.runner.work import Ending

_STATE = "state.json"
_KEPT = {_STATE, LOG, LOG_STATE}


class Stage(str, enum.Enum):
    """What is to be done: get it ready, see it to its end, or keep what it left."""

    preparing = "preparing"
    running = "running"
    collecting = "collecting"


class EndingNoted(BaseModel):
    """How a run ended, as it is written down."""

    model_config = ConfigDict(frozen=True)

    reason: EndReason
    message: str
    exit_code: int | None

    def ending(self) -> Ending:
        """Return it as executors say it."""
        return Ending(self.reason, self.message, self.exit_code)


class AttemptState(BaseModel):
    """All of it. `starts` counts how often the run was, or was about to be started; `image` is what it runs on.

    `started_s` is when, by the clock of leases. `store_url` is where the store is for a run that reaches it.
    """

    model_config = ConfigDict(frozen=True)

    claim: RunAssignment
    stage: Stage = Stage.preparing
    starts: int = 0
    started_s: float = 0
    image: str | None = None
    image_digest: str | None = None
    store_url: str = ""
    ending: EndingNoted | None = None
    usage: Usage | None = None


class Attempt:
    """One attempt's folder. Only its run's thread changes it."""

    def __init__(self, folder: Path, state: AttemptState) -> None:
        self.folder = folder
        self.state = state

    @property
    def key(self) -> str:
        """Its name on this machine."""
        return self.folder.name

    def change(self, **changes: object) -> None:
        """Change what is known, on disk first."""
        state = self.state.model_copy(update=changes)
        write_whole(self.folder / _STATE, state.model_dump_json())
        self.state = state

    def clear(self) -> None:
        """Remove what an earlier start left, but for what it wrote: that may be in the store already."""
        for path in self.folder.iterdir():
            if path.name in _KEPT:
                continue
            if path.is_dir() and not path.is_symlink():
                remove_tree(path)
            else:
                path.unlink()


def begin(runs: Path, claim: RunAssignment) -> Attempt:
    """Make the folder of a claim that just came."""
    folder = runs / f"{claim.run_id}-{claim.attempt}"
    folder.mkdir(mode=0o711, parents=True, exist_ok=True)
    attempt = Attempt(folder, AttemptState(claim=claim))
    attempt.change()
    return attempt


def left_over(runs: Path) -> list[Attempt | Path]:
    """Return what an earlier runner was at; of what it had not even written down, or had finished, only the folder."""
    return [_read(folder) for folder in sorted(runs.iterdir())] if runs.is_dir() else []


def _read(folder: Path) -> Attempt | Path:
    try:
        return Attempt(folder, AttemptState.model_validate_json((folder / _STATE).read_bytes()))
    except (FileNotFoundError, NotADirectoryError, ValidationError):
        return folder
