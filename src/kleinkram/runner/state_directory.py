"""The state directory of a runner: its attempts at runs; also what the threads of runs share.

One process at a time uses the directory. All state is written before it is acted upon.

id                    the permanent id of the runner
last-heartbeat        when the server last answered a heartbeat
runs/<run>-<attempt>/ the directory of each attempt, which is also the directory of its job
    state.json        the assignment and the stage
    log-upload.json   how much of the log is stored
cache/                inputs
environments/         packages of scripts
images/               images, of a runner without a container engine
slurm-site.json       what a cluster offers, for a runner on Slurm
"""

import contextlib
import enum
import fcntl
import math
import os
import shutil
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client.errors import InvalidInput
from kleinkram.client.runs import Runners
from kleinkram.client.server import Service
from kleinkram.client.transfer.store import StoreClient
from kleinkram.contract.runners import RunAssignment
from kleinkram.contract.runs import RunPlacement, RunState, Usage
from kleinkram.runner.executors.base import Ending, Executor
from kleinkram.runner.executors.supervision import LOG, boot_id, boot_time_s, write_atomically, write_in_place
from kleinkram.runner.run_requests import RunRequests
from kleinkram.runner.statistics import RunnerStatistics

LOG_UPLOAD = "log-upload.json"
_STATE = "state.json"
# What stays when an attempt is started again: its log may be stored already.
_PRESERVED = {_STATE, LOG, LOG_UPLOAD}
_PRIVATE = ("runs", "cache", "environments", "images")
_LAST_HEARTBEAT = "last-heartbeat"
# A run is stopped this long before its lease ends, so that two runners never run it at once.
LEASE_MARGIN_S = 10.0


class StateDirectory:
    """The state directory of a runner."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.runs = path / "runs"
        for name in _PRIVATE:
            _make_private(path / name)
        id_file = path / "id"
        if not id_file.exists():
            write_atomically(id_file, str(uuid.uuid4()))
        try:
            self.runner_id = uuid.UUID(id_file.read_text().strip())
        except ValueError:
            raise InvalidInput(what=str(id_file), reason="it contains no runner id") from None

    def create_attempt(self, assignment: RunAssignment) -> "Attempt":
        """Create the directory of a new attempt."""
        directory = self.runs / f"{assignment.run_id}-{assignment.attempt}"
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        attempt = Attempt(directory, AttemptState(assignment=assignment))
        attempt.change()
        return attempt

    def find_attempts(self) -> "list[Attempt | Path]":
        """Return the attempts of an earlier process; only the directory of those without state."""
        entries: list[Attempt | Path] = []
        for directory in sorted(self.runs.iterdir()):
            try:
                entries.append(read_attempt(directory))
            except (FileNotFoundError, NotADirectoryError, ValidationError):  # noqa: PERF203  each by itself
                entries.append(directory)
        return entries

    def record_heartbeat(self, at_s: float) -> None:
        """Record that the server answered a heartbeat sent at `at_s`, by the clock of leases."""
        wall_time_s = time.time() - (boot_time_s() - at_s)
        write_in_place(self.path / _LAST_HEARTBEAT, f"{boot_id()} {at_s} {wall_time_s:.3f}")

    def last_heartbeat_s(self) -> float:
        """Return when the server last answered a heartbeat, by the clock of leases; -inf where that is unknown.

        After a restart of the machine, or on another one, it is known by the time of day.
        """
        with contextlib.suppress(OSError, ValueError):
            of_boot, at_s, wall_time_s = (self.path / _LAST_HEARTBEAT).read_text().split()
            if of_boot == boot_id():
                return float(at_s)
            return boot_time_s() - max(0.0, time.time() - float(wall_time_s))
        return -math.inf


def _make_private(directory: Path) -> None:
    """Create a folder that only its user can look into, wherever it is: it has inputs and results."""
    try:
        directory.mkdir(mode=0o700, exist_ok=True)
        if directory.stat().st_mode & 0o077:
            directory.chmod(0o700)
    except OSError as error:
        reason = f"it cannot be kept from other users: {error.strerror or error}"
        raise InvalidInput(what=f"The folder {directory}", reason=reason) from error


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


class AttemptState(BaseModel):
    """The state of an attempt. `stage` is its next step; `starts` counts the submissions of its job.

    `image` is what the job runs on, `packages` the folder of what its script imports. `started_s` is by the clock of
    leases. `store_url` is the store for a job that reaches it.
    """

    model_config = ConfigDict(frozen=True)

    assignment: RunAssignment
    stage: RunState = RunState.preparing
    starts: int = 0
    started_s: float = 0
    image: str | None = None
    image_digest: str | None = None
    store_url: str = ""
    packages: Path | None = None
    ending: Ending | None = None
    placement: RunPlacement | None = None
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


def read_attempt(directory: Path) -> Attempt:
    """Return the attempt of a directory.

    Raises:
        FileNotFoundError, NotADirectoryError, ValidationError: it has none.
    """
    return Attempt(directory, AttemptState.model_validate_json((directory / _STATE).read_bytes()))


def remove_tree(directory: Path) -> None:
    """Remove a directory and its content, including directories without permissions for their owner.

    Raises:
        OSError: something cannot be removed, such as files of another user.
    """
    try:
        shutil.rmtree(directory)
    except FileNotFoundError:
        return
    except PermissionError:
        directory.chmod(0o700)
        for parent, names, _ in os.walk(directory):
            for name in names:
                # A link to a directory is listed as one, and is only removed.
                if not (Path(parent) / name).is_symlink():
                    (Path(parent) / name).chmod(0o700)
        shutil.rmtree(directory)


@dataclass(frozen=True)
class RunnerContext:
    """Context shared by all runs of a runner. `on_change` is called when the state of a run changes.

    `log_every_s`: how often each run may upload a part of its log.
    """

    executor: Executor
    runners: Runners
    requests: RunRequests
    store: StoreClient
    url: str
    token: str
    token_file: Path | None
    service: Service
    default_image: str | None
    on_change: Callable[[], None]
    statistics: RunnerStatistics = field(default_factory=RunnerStatistics)
    log_every_s: Callable[[], float] = lambda: 0


class StopRequest(str, enum.Enum):
    """Why a run is to stop; later members take precedence.

    `cancel`: a person cancelled it; its end is reported. `abandon`: another runner has it; nothing is reported.
    `detach`: this runner process ends, and the next one continues the run.
    """

    cancel = "cancel"
    abandon = "abandon"
    detach = "detach"


_PRECEDENCE = [None, *StopRequest]


@dataclass(eq=False)
class StopRequested(Exception):
    """Raised in the thread of a run that is to stop."""

    request: StopRequest


class StopSignal:
    """The stop requests of one run; `request` is the current one."""

    def __init__(self) -> None:
        self.request: StopRequest | None = None
        self._pending = threading.Event()

    def send(self, request: StopRequest) -> None:
        """Request a stop."""
        if _PRECEDENCE.index(request) > _PRECEDENCE.index(self.request):
            self.request = request
            self._pending.set()

    def acknowledge(self) -> None:
        """Clear a request, so that it does not interrupt the remaining steps."""
        self._pending.clear()

    def is_pending(self) -> bool:
        """Whether there is a request that was not acknowledged."""
        return self._pending.is_set()

    def check(self) -> None:
        """Raise `StopRequested` if a request is pending."""
        if self.request is not None and self._pending.is_set():
            raise StopRequested(self.request)

    def wait(self, seconds: float) -> None:
        """Wait, or raise `StopRequested` as soon as there is a request."""
        self._pending.wait(seconds)
        self.check()


class Lease:
    """Lease of a run, by the clock of `boot_time_s`."""

    def __init__(self, until_s: float) -> None:
        self.until_s = until_s

    def renew(self, requested_s: float, lease_s: float) -> None:
        """Extend it: the server renewed it by the reply to a request sent at `requested_s`."""
        self.until_s = max(self.until_s, requested_s + lease_s - LEASE_MARGIN_S)

    def is_over(self) -> bool:
        """Whether another runner may soon have the run."""
        return boot_time_s() > self.until_s
