"""Backups of the instance in a data directory: `python -m kleinkram.standalone.backup TASK`.

TASK is the JSON of `BackupTask`. Starts `kleinkram.server.backup` with the settings of the instance's services. Where
the instance does not run, only its database and store are started for that time.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from kleinkram.failures import code_of, failure_line
from kleinkram.standalone.data_dir import (
    DataDir,
    create,
    exclusive,
    is_locked,
    load_runtime_info,
    load_secrets,
    note_version,
    refuse_half_restored,
    refuse_newer,
    write_private,
)
from kleinkram.standalone.errors import DataDirUnusable, NotRunning, StandaloneError
from kleinkram.standalone.processes import end_marked_processes, spawn_in_terminal
from kleinkram.standalone.services import UpOptions, backup_environment, make_plan
from kleinkram.standalone.supervisor import EndRequested, Supervisor, pause, watch_signals

_WORKER = (sys.executable, "-m", "kleinkram.server.backup")
_INTERRUPTED = 130
_DAMAGED = 9


@dataclass(frozen=True)
class BackupTask:
    """A request to `kleinkram.server.backup` about a data directory; `restores`: into a new one."""

    data_dir: str
    request: dict[str, object]
    restores: bool

    def command(self) -> list[str]:
        """Return the command line that carries it out."""
        return [sys.executable, "-m", "kleinkram.standalone.backup", json.dumps(asdict(self))]


def main() -> None:
    """Carry out the task, and end with the exit code of the server's process, or with 1 and a sentence."""
    task = BackupTask(**json.loads(sys.argv[1]))
    data_dir = DataDir(Path(task.data_dir))
    watch_signals()
    try:
        sys.exit(_restore(task, data_dir) if task.restores else _use_existing(task, data_dir))
    except EndRequested:
        sys.exit(_INTERRUPTED)
    except StandaloneError as error:
        as_json = bool(task.request.get("as_json"))
        sys.exit(failure_line(str(error), code=code_of(error), exit_code=1, as_json=as_json))


def _use_existing(task: BackupTask, data_dir: DataDir) -> int:
    if not data_dir.secrets_file.exists():
        raise NotRunning(f"{data_dir.root} holds no instance of Kleinkram: name its folder by --data-dir.")
    if is_locked(data_dir):
        return _run(task, _running_environment(data_dir))
    with exclusive(data_dir):
        refuse_half_restored(data_dir)
        refuse_newer(data_dir)
        with _data_services(data_dir) as environment:
            return _run(task, environment)


def _restore(task: BackupTask, data_dir: DataDir) -> int:
    if data_dir.root.exists() and any(data_dir.root.iterdir()) and not data_dir.restoring_file.exists():
        raise DataDirUnusable(f"{data_dir.root} is not empty: a backup is restored into a new folder.")
    create(data_dir)
    with exclusive(data_dir):
        write_private(data_dir.restoring_file, f"{task.request['location']}\n")
        with _data_services(data_dir) as environment:
            code = _run(task, environment)
        if code in (0, _DAMAGED):  # an instance with lost objects is complete otherwise
            note_version(data_dir)
            data_dir.restoring_file.unlink()
    return code


@contextlib.contextmanager
def _data_services(data_dir: DataDir) -> Iterator[dict[str, str]]:
    """Run database and store; yields their settings. The caller holds the lock."""
    end_marked_processes(data_dir.root)
    supervisor = Supervisor(make_plan(UpOptions(data_dir.root, with_runner=False)))
    try:
        supervisor.start_data_services()
        plan = supervisor.plan
        yield backup_environment(
            load_secrets(data_dir), postgres_port=plan.postgres.port, store_port=plan.store.ports["s3"]
        )
    finally:
        supervisor.stop()


def _running_environment(data_dir: DataDir) -> dict[str, str]:
    """Return the settings of the database and store of the running instance.

    Raises:
        NotRunning: it has not finished starting.
    """
    info = load_runtime_info(data_dir)
    if info is None:
        raise NotRunning(f"Kleinkram on {data_dir.root} is still starting: try again once it answers.")
    store_port = info.ports["s3" if "proxy" in info.services else "store"]
    return backup_environment(load_secrets(data_dir), postgres_port=info.ports["postgres"], store_port=store_port)


def _run(task: BackupTask, environment: dict[str, str]) -> int:
    """Run the server's process in this terminal until it ends, or the end is requested."""
    process = spawn_in_terminal([*_WORKER, json.dumps(task.request)], {**os.environ, **environment})
    try:
        while process.poll() is None:
            pause(1.0)
    except EndRequested:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(10)
        raise
    finally:
        process.kill()
        process.wait()
    return process.returncode if process.returncode >= 0 else 1


if __name__ == "__main__":
    main()
