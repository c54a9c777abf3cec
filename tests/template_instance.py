"""Data directories that begin with a migrated database, for tests that start `klein up` on a new one.

initdb and the migrations take 1.8 s of CPU time for each instance. Here they run once per test run, and each instance
copies the result, before its first start. It has passwords of PostgreSQL and S3, but no ports, no token, no owner, no
store and no logs: those are of each instance. `tests/integration/standalone` tests starts without a template.
"""

import fcntl
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from kleinkram.standalone import postgres, processes
from kleinkram.standalone.address import Listening
from kleinkram.standalone.data_dir import DataDir, create, exclusive
from kleinkram.standalone.services import UpOptions, make_plan
from tests.ports import choose_port

_TIMEOUT_S = 60
_template: Path | None = None


def share_template(folder: Path) -> None:
    """Choose the folder in which all workers of this test run share the template."""
    global _template
    _template = folder / "template"


def copy_template(data_dir: Path) -> None:
    """Create the data directory as a copy of the template. No effect if it exists, or without a test run."""
    if _template is None or data_dir.exists():
        return
    with _template.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not _template.exists():
            _make_template(_template)
    # With owners: as root, PostgreSQL's files may belong to another user.
    subprocess.run(["cp", "--archive", "--reflink=auto", _template, data_dir], check=True)


def _make_template(template: Path) -> None:
    """Create the template in a process without the `KLEINKRAM_` variables of this machine, as instances have none."""
    unfinished = template.with_suffix(".new")
    shutil.rmtree(unfinished, ignore_errors=True)
    inherited = {key: value for key, value in os.environ.items() if not key.startswith("KLEINKRAM_")}
    command = [sys.executable, "-m", "tests.template_instance", str(unfinished)]
    subprocess.run(command, env=inherited, cwd=Path(__file__).parents[1], check=True, timeout=2 * _TIMEOUT_S)
    unfinished.rename(template)


def _create_database(root: Path) -> None:
    """Create a data directory whose database has all migrations, and keep only what its copies share."""
    data_dir = DataDir(root)
    create(data_dir)
    with exclusive(data_dir):
        plan = make_plan(UpOptions(root, Listening(port=choose_port(), s3_port=choose_port()), with_runner=False))
        cluster = plan.postgres
        postgres.initialise(cluster)
        server = postgres.start(cluster, extra={"fsync": "off"})
        try:
            deadline = time.monotonic() + _TIMEOUT_S
            while not postgres.is_ready(cluster, server):
                assert server.poll() is None, cluster.log.read_text()
                assert time.monotonic() < deadline, cluster.log.read_text()
                time.sleep(0.02)
            postgres.prepare_database(cluster)
            migrate = plan.server_command("migrate")
            assert processes.spawn(migrate).wait(_TIMEOUT_S) == 0, migrate.log.read_text()
            postgres.record_migrations(data_dir, cluster)
        finally:
            processes.stop(server, sign=postgres.STOP_SIGNAL, timeout_s=_TIMEOUT_S)
    data_dir.ports_file.unlink()
    data_dir.token_file.unlink()
    shutil.rmtree(data_dir.log("postgres").parent)


if __name__ == "__main__":
    _create_database(Path(sys.argv[1]))
