"""The state directory of a runner, which one process at a time uses. All state is written before it is acted upon.

id                    the permanent id of the runner
last-heartbeat        when the server last answered a heartbeat
runs/<run>-<attempt>/ the directory of each attempt, which is also the directory of its job
    state.json        the assignment and the stage
    log-upload.json   how much of the log is stored
cache/                inputs
"""

import contextlib
import enum
import fcntl
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.runners import RunAssignment
from kleinkram.contract.runs import Usage
from kleinkram.runner.executors.base import Ending
from kleinkram.runner.executors.limits import LOG
from kleinkram.runner.files import remove_tree, write_atomically, write_in_place

LOG_UPLOAD = "log-upload.json"
_STATE = "state.json"
# What stays when an attempt is started again: its log may be stored already.
_PRESERVED = {_STATE, LOG, LOG_UPLOAD}
_LAST_HEARTBEAT = "last-heartbeat"
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class StateDirectory:
    """The state directory of a runner."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.runs = path / "runs"
        self.runs.mkdir(mode=0o711, exist_ok=True)
        id_file = path / "id"
        if not id_file.exists():
            write_atomically(id_file, str(uuid.uuid4()))
        try:
            self.runner_id = uuid.UUID(id_file.read_text().strip())
        except ValueError:
            raise InvalidInput(what=str(id_file), reason="it holds no id of a runner") from None

    def record_heartbeat(self, at_s: float) -> None:
        """Record that the server answered a heartbeat sent at `at_s`, by the clock of leases."""
        write_in_place(self.path / _LAST_HEARTBEAT, f"{_boot_id()} {at_s}")

    def last_heartbeat_s(self) -> float:
        """Return the time of the last answered heartbeat; 0 where it is unknown, or before a restart of the machine."""
        with contextlib.suppress(OSError, ValueError):
            boot_id, at_s = (self.path / _LAST_HEARTBEAT).read_text().split()
            if boot_id == _boot_id():
                return float(at_s)
        return 0.0


@contextlib.contextmanager
def open_state_directory(path: Path) -> Iterator[StateDirectory]:
    """Lock the state directory of a runner, which is created where it does not exist.

    Raises:
        InvalidInput: another process uses it, or it cannot be used.
    """
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        lock = os.open(path / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise InvalidInput(what=f"The folder {path}", reason=error.strerror or str(error)) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield StateDirectory(path)
    except BlockingIOError:
        raise InvalidInput(what=f"The folder {path}", reason="another runner uses it") from None
    finally:
        os.close(lock)


def _boot_id() -> str:
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return "unknown"


class Stage(str, enum.Enum):
    """Next step of a run: prepare it, run it to its end, or collect its results."""

    preparing = "preparing"
    running = "running"
    collecting = "collecting"


class AttemptState(BaseModel):
    """The state of an attempt. `starts` counts how often its job was, or was about to be submitted.

    `image` is what the job runs on. `started_s` is by the clock of leases. `store_url` is the store for a job that
    reaches it.
    """

    model_config = ConfigDict(frozen=True)

    assignment: RunAssignment
    stage: Stage = Stage.preparing
    starts: int = 0
    started_s: float = 0
    image: str | None = None
    image_digest: str | None = None
    store_url: str = ""
    ending: Ending | None = None
    usage: Usage | None = None


class Attempt:
    """An attempt at a run. Only the thread of the run changes it."""

    def __init__(self, directory: Path, state: AttemptState) -> None:
        self.directory = directory
        self.state = state

    @property
    def key(self) -> str:
        """The key of its job."""
        return self.directory.name

    def change(self, **changes: object) -> None:
        """Change the state, on disk first."""
        state = self.state.model_copy(update=changes)
        write_atomically(self.directory / _STATE, state.model_dump_json())
        self.state = state

    def clear(self) -> None:
        """Remove what an earlier start left, except for its log."""
        for path in self.directory.iterdir():
            if path.name in _PRESERVED:
                continue
            if path.is_dir() and not path.is_symlink():
                remove_tree(path)
            else:
                path.unlink()


def create_attempt(runs: Path, assignment: RunAssignment) -> Attempt:
    """Create the directory of a new attempt."""
    directory = runs / f"{assignment.run_id}-{assignment.attempt}"
    directory.mkdir(mode=0o711, parents=True, exist_ok=True)
    attempt = Attempt(directory, AttemptState(assignment=assignment))
    attempt.change()
    return attempt


def find_attempts(runs: Path) -> list[Attempt | Path]:
    """Return the attempts of an earlier process; only the directory of those without state."""
    return [_read_attempt(directory) for directory in sorted(runs.iterdir())] if runs.is_dir() else []


def _read_attempt(directory: Path) -> Attempt | Path:
    try:
        return Attempt(directory, AttemptState.model_validate_json((directory / _STATE).read_bytes()))
    except (FileNotFoundError, NotADirectoryError, ValidationError):
        return directory
