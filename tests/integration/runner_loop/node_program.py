"""A cluster of one node for tests: jobs are processes, and a program on their node moves their files.

`python -m tests.integration.runner_loop.node_program DIRECTORY LOCK` is that program.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import subprocess
import sys
from pathlib import Path

from kleinkram.contract.runners import RunFinish
from kleinkram.contract.runs import EndReason
from kleinkram.environments.cache import Show
from kleinkram.environments.uv import Wait
from kleinkram.runner.executors import process_supervisor, transfer_steps
from kleinkram.runner.executors.base import UPLOADING, Ending, RunJob, StoredResults, read_finish
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.executors.supervision import ENDING, write_atomically
from kleinkram.runner.input_cache import InputCache


class NodeExecutor(ProcessExecutor):
    """Runs jobs as processes whose program moves their files."""

    @property
    def node_cache(self) -> InputCache:
        """The cache of this machine."""
        return self._required_machine().cache

    def poll(self, job: RunJob) -> Ending | None:
        """Return the ending as soon as there is one: the program then uploads the results."""
        with contextlib.suppress(FileNotFoundError):
            ending = json.loads((job.directory / ENDING).read_text())
            return Ending(EndReason(ending["reason"]), ending["message"], ending["exit_code"])
        return super().poll(job)

    def upload_results(self, job: RunJob, plain: RunFinish, wait: Wait, show: Show) -> StoredResults | None:
        """Wait while the program still runs."""
        while self._supervisor_pid(job) is not None:
            show(UPLOADING, 1.0)
            wait(0.1)
        finish = read_finish(job.directory, plain.attempt)
        return StoredResults(finish, has_log=True) if finish is not None else None

    def _start_supervisor(self, job: RunJob) -> None:
        lock = os.open(job.directory / process_supervisor.LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        fcntl.flock(lock, fcntl.LOCK_EX)
        with (job.directory / "supervisor.log").open("ab") as errors:
            child = subprocess.Popen(
                [sys.executable, "-m", __name__, str(job.directory), str(lock)],
                stdin=subprocess.DEVNULL,
                stdout=errors,
                stderr=errors,
                pass_fds=[lock],
                start_new_session=True,
            )
        self._children[job.key] = child
        process_supervisor.write_pid(lock, child.pid)
        os.close(lock)


def main(directory: Path, lock: int) -> None:
    """Run a job between its transfers."""
    os.set_inheritable(lock, False)
    failure = transfer_steps.fetch_inputs(directory, lambda: True)
    if failure is not None:
        write_atomically(directory / ENDING, json.dumps({**failure._asdict(), "exit_code": None}))
        return
    job = json.loads((directory / process_supervisor.JOB).read_text())
    process_supervisor.JobSupervisor(directory, lock, job).run()
    transfer_steps.upload_results(directory, lambda: True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
