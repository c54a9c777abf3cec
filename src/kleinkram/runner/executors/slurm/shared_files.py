"""The files of a job by which its login node and its compute node talk, over a folder that both see.

    slurm.json   the name and id of its job in Slurm: a job of another name does nothing
    start.json   which start of the job has the directory, and what it has: an earlier one ends itself
    request      what the login node asks for: `run` or `cancel`
    ending-TOKEN.json
                 how the start with this token ended: a late one of an earlier start does not count
    lease        how many seconds it may go on, counted from when the node sees the file change

No clock of one machine is compared with that of another. Imports only the standard library: nodes start faster.
"""

import contextlib
import json
import os
import uuid
from pathlib import Path
from typing import Any, NamedTuple

from kleinkram.runner.executors.supervision import LEASE, write_atomically, write_in_place

SUBMISSION, START, REQUEST = "slurm.json", "start.json", "request"
_RUN, _CANCEL = "run", "cancel"


class Submission(NamedTuple):
    """A submission of a job, recorded before it is made. `job_id` is empty until Slurm has answered.

    `name` is that of the job in Slurm; of a task of a job array, with its number. `number` counts the submissions of
    the job, `forgotten` not among them: those that Slurm had, and then did not know any more.
    """

    name: str
    job_id: str = ""
    number: int = 1
    forgotten: int = 0


class NodeStart(NamedTuple):
    """A start of a job on a node. `token` is unique; `restarts` counts the starts before it."""

    token: str
    node: str
    restarts: int
    gpus: list[str]


def write_submission(directory: Path, submission: Submission) -> None:
    """Record a submission."""
    write_atomically(directory / SUBMISSION, json.dumps(submission._asdict()))


def read_submission(directory: Path) -> Submission | None:
    """Return the current submission; None where there is none, or the job was removed.

    Raises:
        OSError: the folder cannot be read at the moment.
    """
    values = _read(directory / SUBMISSION)
    return None if values is None else Submission(**values)


def write_start(directory: Path, start: NodeStart) -> None:
    """Record which start has the directory."""
    write_atomically(directory / START, json.dumps(start._asdict()))


def read_start(directory: Path) -> NodeStart | None:
    """Return the start that has the directory; None where there was none."""
    values = _read(directory / START)
    return None if values is None else NodeStart(**values)


def _read(path: Path) -> dict[str, Any] | None:
    try:
        values: dict[str, Any] = json.loads(path.read_text())
    except (FileNotFoundError, ValueError):
        return None
    return values


def write_request(directory: Path, *, is_cancelled: bool, create: bool = False) -> None:
    """Ask the node to run a job, or to end it.

    Raises:
        OSError: it was not submitted, or the file cannot be written.
    """
    write_in_place(directory / REQUEST, _CANCEL if is_cancelled else _RUN, create=create)


def is_cancel_requested(directory: Path) -> bool:
    """Whether the login node asked to end a job."""
    try:
        return (directory / REQUEST).read_text().strip() == _CANCEL
    except OSError:
        return False


def write_lease(directory: Path, remaining_s: float, *, create: bool) -> None:
    """Have a job go on for so long. Each text differs, so that the node notices the change.

    Raises:
        OSError: it has no lease, or that cannot be written.
    """
    write_in_place(directory / LEASE, f"{remaining_s:.3f} {uuid.uuid4().hex[:16]}", create=create)


def read_lease(directory: Path) -> tuple[str, float] | None:
    """Return the text of a lease and its seconds; None where the job has none.

    Raises:
        OSError: the folder cannot be read at the moment.
    """
    try:
        text = (directory / LEASE).read_text()
        return text, float(text.split()[0])
    except (FileNotFoundError, ValueError, IndexError):
        return None


def refresh(directory: Path) -> None:
    """Have the client of a network file system read a directory anew, by changing it."""
    mark = directory / ".refresh"
    with contextlib.suppress(OSError):
        os.close(os.open(mark, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600))
        mark.unlink()
