"""The transfers of a job whose compute node moves its files: what the node does before and after the job.

    transfers.json        what the node needs to know, written by the runner; without it, the runner moves the files
    transfer-status.json  what the download of the inputs does, and whether it is over
    finish.json           what the runner is to report, once the results are uploaded; of a job that may be started
                          several times, `finish-TOKEN.json`, with the token of the start

Each step is a process of its own, which has the runner's token; the job never sees it. Imports only the standard
library, like all that starts on a node before the job.
"""

import contextlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

ORDER, STATUS, FINISH = "transfers.json", "transfer-status.json", "finish.json"
_MODULE = "kleinkram.runner.node_transfers"
_CHECK_EVERY_S = 0.2
_TERM_S = 5.0
_SHOWN_ERROR = 500


class StepFailed(NamedTuple):
    """Why a job cannot start: the reason of its ending, and a sentence."""

    reason: str
    message: str


def node_moves_files(directory: Path) -> bool:
    """Whether this node is to move the files of the job in a directory."""
    return (directory / ORDER).exists()


def fetch_inputs(directory: Path, is_wanted: Callable[[], bool]) -> StepFailed | None:
    """Download the inputs of a job to `in/`; return why that failed, if so. Ends early once it is not wanted."""
    code, output = _run("fetch", directory, is_wanted)
    if code == 0:
        return None
    with contextlib.suppress(ValueError, IndexError, TypeError):
        return StepFailed(**json.loads(output.splitlines()[-1]))
    message = f"The program that downloads its inputs failed on its node (exit code {code}): {output[-_SHOWN_ERROR:]}"
    return StepFailed("inputs_unavailable", message)


def finish_file(directory: Path, start: str = "") -> Path:
    """Return where a node leaves what the runner is to report, of a start with this token."""
    return directory / (f"finish-{start}.json" if start else FINISH)


def upload_results(directory: Path, is_wanted: Callable[[], bool], start: str = "") -> bool:
    """Upload the results of an ended job; return whether that is complete. If not, the runner does the rest."""
    return finish_file(directory, start).exists() or _run("upload", directory, is_wanted, start)[0] == 0


def _run(step: str, directory: Path, is_wanted: Callable[[], bool], *arguments: str) -> tuple[int, str]:
    command = [sys.executable, "-I", "-m", _MODULE, step, str(directory), *arguments]
    output = directory / f"{step}.out"
    with output.open("wb") as stream:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=stream)
    terminated_s: float | None = None
    while process.poll() is None:
        if terminated_s is None and not is_wanted():
            terminated_s = time.monotonic()
            process.send_signal(signal.SIGTERM)
        elif terminated_s is not None and time.monotonic() - terminated_s > _TERM_S:
            process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_CHECK_EVERY_S)
    return process.returncode, output.read_text(errors="replace").strip()
