"""Backups of the instance in a data directory: `python -m kleinkram.standalone.backup ERRAND`.

ERRAND is the JSON of `Errand`. What is done, the server's own process does (`kleinkram.server.backup`), by the settings
that the instance's parts have. Where the instance does not run, its database and store are started for as long as
that takes, and nothing else of it.
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
from kleinkram.standalone import child
from kleinkram.standalone.data_dir import (
    DataDir,
    create,
    exclusive,
    is_held,
    load_secrets,
    note_version,
    refuse_half_restored,
    refuse_newer,
    write_private,
)
from kleinkram.standalone.errors import DataDirUnusable, NotRunning, StandaloneError
from kleinkram.standalone.leftovers import end_leftovers
from kleinkram.standalone.plan import Plan, UpOptions, data_environment, make_plan
from kleinkram.standalone.postgres import MIGRATE, SERVE, role_url
from kleinkram.standalone.s3 import StoreAccess
from kleinkram.standalone.supervisor import StopAsked, Supervisor, pause, watch_signals

WORKER = (sys.executable, "-m", "kleinkram.server.backup")
_INTERRUPTED = 130
_BYTES_DIFFER = 9


@dataclass(frozen=True)
class Errand:
    """What is to be done with which data directory: `order` is the server's, `fills` whether it is a new one."""

    data_dir: str
    order: dict[str, object]
    fills: bool

    def command(self) -> list[str]:
        """The command line that does it."""
        return [sys.executable, "-m", "kleinkram.standalone.backup", json.dumps(asdict(self))]


def main() -> None:
    """Do the errand, and end as the server's process did; what cannot be started is a sentence and exit code 1."""
    errand = Errand(**json.loads(sys.argv[1]))
    watch_signals()
    try:
        code = _fill(errand) if errand.fills else _copy(errand)
    except StopAsked:
        code = _INTERRUPTED
    except StandaloneError as error:
        as_json = bool(errand.order.get("as_json"))
        sys.exit(failure_line(str(error), code=code_of(error), exit_code=1, as_json=as_json))
    sys.exit(code)


def _copy(errand: Errand) -> int:
    data_dir = DataDir(Path(errand.data_dir))
    if not data_dir.secrets_file.exists():
        raise NotRunning(f"{data_dir.root} holds no instance of Kleinkram: name its folder by --data-dir.")
    if is_held(data_dir):
        return _do(errand, _running_environment(data_dir))
    with exclusive(data_dir):
        refuse_half_restored(data_dir)
        refuse_newer(data_dir)
        with _parts(data_dir) as plan:
            return _do(errand, plan.data_environment())


def _fill(errand: Errand) -> int:
    data_dir = DataDir(Path(errand.data_dir))
    if data_dir.root.exists() and any(data_dir.root.iterdir()) and not data_dir.restoring_file.exists():
        raise DataDirUnusable(f"{data_dir.root} is not empty: a backup is restored into a new folder.")
    create(data_dir)
    with exclusive(data_dir):
        write_private(data_dir.restoring_file, f"{errand.order['place']}\n")
        with _parts(data_dir) as plan:
            code = _do(errand, plan.data_environment())
        # Lost objects are shown as such by a site that is whole otherwise.
        if code in (0, _BYTES_DIFFER):
            note_version(data_dir)
            data_dir.restoring_file.unlink()
    return code


@contextlib.contextmanager
def _parts(data_dir: DataDir) -> Iterator[Plan]:
    """Run database and store alone. The caller holds the lock."""
    end_leftovers(data_dir)
    supervisor = Supervisor(make_plan(UpOptions(data_dir.root, with_runner=False)))
    try:
        supervisor.start_data()
        yield supervisor.plan
    finally:
        supervisor.stop()


def _running_environment(data_dir: DataDir) -> dict[str, str]:
    """How the parts of the instance that runs here are reached, by what it tells of itself.

    Raises:
        NotRunning: it is only just starting.
    """
    try:
        told = json.loads(data_dir.instance_file.read_text())
    except FileNotFoundError:
        raise NotRunning(f"Kleinkram on {data_dir.root} is only just starting: try again once it answers.") from None
    ports, kept = told["ports"], load_secrets(data_dir)
    port = ports["s3" if "door" in told["parts"] else "store"]
    return data_environment(
        serve=role_url(SERVE, kept.postgres_serve, ports["postgres"]),
        migrate=role_url(MIGRATE, kept.postgres_migrate, ports["postgres"]),
        access=StoreAccess(f"http://127.0.0.1:{port}", kept.s3_access_key, kept.s3_secret_key),
    )


def _do(errand: Errand, environment: dict[str, str]) -> int:
    """Let the server's process do it, with our own voice; ended where this one is asked to end."""
    command = [*WORKER, json.dumps(errand.order)]
    process = child.speak_for_us(command, {**os.environ, **environment})
    try:
        while process.poll() is None:
            pause(1.0)
    except StopAsked:
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
