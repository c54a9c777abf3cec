"""The accounting of a private Slurm: slurmdbd and its MariaDB, with their own configuration, folders and ports."""

from __future__ import annotations

import socket
import subprocess
from pathlib import Path

from tests.ports import choose_port
from tests.requirements import path_of

PROGRAMS = ("slurmdbd", "mariadbd", "sacctmgr", "sacct")
_TABLES = Path("/usr/share/mysql")
_TABLE_FILES = ("system_tables", "performance_tables", "system_tables_data")
_CLUSTER = """\
AccountingStorageType=accounting_storage/slurmdbd
AccountingStorageHost=127.0.0.1
AccountingStoragePort={port}
AccountingStoragePass={folder}/munge.socket
AccountingStorageEnforce=associations,limits
"""
_DAEMON = """\
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
DbdHost={host}
DbdAddr=127.0.0.1
DbdPort={port}
SlurmUser=root
StorageType=accounting_storage/mysql
StorageHost=127.0.0.1
StoragePort={database_port}
StorageUser=root
StorageLoc=slurm
PidFile={folder}/slurmdbd.pid
LogFile={folder}/slurmdbd.log
"""


class Accounting:
    """The files and command lines of the accounting of the cluster in `folder`; `settings` are those of the cluster."""

    def __init__(self, folder: Path) -> None:
        port = choose_port()
        self.settings = _CLUSTER.format(folder=folder, port=port)
        self._data = folder / "mariadb"
        self._socket = folder / "mariadb.socket"
        self._database_port = choose_port()
        self._options = ["--no-defaults", "--user=root", f"--datadir={self._data}"]
        text = _DAEMON.format(folder=folder, host=socket.gethostname(), port=port, database_port=self._database_port)
        (folder / "slurmdbd.conf").touch(0o600)
        (folder / "slurmdbd.conf").write_text(text)

    def create_database(self) -> None:
        """Create the files of an empty MariaDB, which lets everybody in who reaches its port on this machine."""
        (self._data / "mysql").mkdir(parents=True)
        tables = "".join((_TABLES / f"mysql_{name}.sql").read_text() for name in _TABLE_FILES)
        command = [str(path_of("mariadbd")), *self._options, "--bootstrap"]
        subprocess.run(command, input=f"use mysql;\n{tables}", text=True, check=True, capture_output=True)

    def database_command(self) -> list[str]:
        """Return the arguments of mariadbd."""
        return [
            *self._options,
            "--skip-grant-tables",
            f"--socket={self._socket}",
            f"--port={self._database_port}",
            "--bind-address=127.0.0.1",
            f"--pid-file={self._data}/pid",
        ]

    def is_database_ready(self) -> bool:
        """Whether MariaDB accepts connections."""
        with socket.socket() as probe:
            probe.settimeout(1)
            return probe.connect_ex(("127.0.0.1", self._database_port)) == 0
