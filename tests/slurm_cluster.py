"""A private Slurm of one node, with its own configuration, folders, socket and ports."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.ports import choose_port
from tests.requirements import path_of
from tests.slurm_accounts import Accounting

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scancel", "scontrol", "sinfo")
_START_S = 60.0
_BOOT_TIME_S = 1_000_000
_CONFIGURATION = """\
ClusterName=kleinkram-tests
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller_port}
SlurmdPort={node_port}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket,cred_expire=5
CredType=cred/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SchedulerType=sched/backfill
SchedulerParameters=batch_sched_delay=0,sched_min_interval=0,bf_interval=1
ReturnToService=2
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=1
{accounting}
JobCompType=jobcomp/none
JobRequeue=1
KillWait=2
SlurmdTimeout=10
SlurmctldTimeout=10
InactiveLimit=0
SlurmdParameters=config_overrides
MessageTimeout=2
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
Prolog={folder}/prolog
TaskProlog={folder}/task-prolog
GresTypes=gpu
NodeName=node1 NodeHostname={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory=16000 Features=fast Gres=gpu:2
PartitionName=main Nodes=node1 Default=YES MaxTime=1-00:00:00 State=UP
PartitionName=short Nodes=node1 MaxTime=00:02:00 State=UP
"""
_NO_ACCOUNTING = "AccountingStorageType=accounting_storage/none"
# Files that stand for the two devices: nothing can be computed on them, but Slurm hands them out.
_GPUS = "NodeName=node1 Name=gpu File=/dev/null\nNodeName=node1 Name=gpu File=/dev/zero\n"


class SlurmCluster:
    """The services of one cluster. `environment` is for commands and runners that use it."""

    def __init__(
        self,
        folder: Path,
        cpus: int = 8,
        *,
        has_accounting: bool = False,
        node_variables: Mapping[str, str] | None = None,
    ) -> None:
        self.folder = folder
        self._node_variables = node_variables or {}
        self._accounting = Accounting(folder) if has_accounting else None
        self._services: dict[str, subprocess.Popen[bytes]] = {}
        self.unshared = folder / "unshared"
        for name in ("state", "spool", "munge", "unshared"):
            (folder / name).mkdir(mode=0o700)
        self.fail_starts(fails=False)
        exports = "".join(f"echo export {name}={value}\n" for name, value in self._node_variables.items())
        (folder / "task-prolog").write_text(f"#!/bin/sh\n{exports}")
        (folder / "task-prolog").chmod(0o755)
        # munged serves every user.
        folder.chmod(0o755)
        (folder / "munge" / "key").write_bytes(os.urandom(128))
        (folder / "munge" / "key").chmod(0o400)
        configuration = _CONFIGURATION.format(
            host=socket.gethostname(),
            folder=folder,
            controller_port=choose_port(),
            node_port=choose_port(),
            cpus=cpus,
            accounting=self._accounting.settings if self._accounting else _NO_ACCOUNTING,
        )
        (folder / "slurm.conf").write_text(configuration)
        (folder / "gres.conf").write_text(_GPUS)
        (folder / "cgroup.conf").write_text("CgroupPlugin=cgroup/v1\n")

    @property
    def environment(self) -> Mapping[str, str]:
        """The variables by which Slurm's commands find it."""
        return {"SLURM_CONF": str(self.folder / "slurm.conf")}

    def start(self) -> None:
        """Start all services, and wait until the node accepts jobs."""
        self.start_munge()
        if self._accounting is not None:
            self._start_accounting(self._accounting)
        self.start_controller()
        self.start_node()
        self.wait_until_idle()

    def start_munge(self) -> None:
        """Start the service that authenticates the others."""
        own = self.folder / "munge"
        files = {name: own / name for name in ("key", "pid", "log", "seed")}
        options = [f"--{name}-file={path}" for name, path in files.items()]
        self._start("munged", "--foreground", "--force", f"--socket={self.folder}/munge.socket", *options)
        _wait_for((self.folder / "munge.socket").exists)

    def _start_accounting(self, accounting: Accounting) -> None:
        """Start slurmdbd with a database of its own; root has the accounts `rich` and `poor`, which may use nothing."""
        accounting.create_database()
        self._start("mariadbd", *accounting.database_command())
        _wait_for(accounting.is_database_ready)
        self._start("slurmdbd", "-D")
        _wait_for(lambda: self.command("sacctmgr", "--noheader", "show", "cluster", check=False).returncode == 0)
        for words in (
            "cluster kleinkram-tests",
            "account rich cluster=kleinkram-tests",
            "account poor cluster=kleinkram-tests GrpTRESMins=cpu=0",
            "user root account=rich,poor defaultaccount=rich",
        ):
            self.command("sacctmgr", "--immediate", "add", *words.split())

    def set_budget(self, account: str, core_minutes: int) -> None:
        """Change what an account may use; -1: no limit."""
        limit = f"GrpTRESMins=cpu={core_minutes}"
        self.command("sacctmgr", "--immediate", "modify", "account", account, "set", limit)

    def start_controller(self) -> None:
        """Start slurmctld, and wait until it answers."""
        self._start("slurmctld", "-D", "-f", str(self.folder / "slurm.conf"))
        _wait_for(lambda: self.command("scontrol", "ping", check=False).returncode == 0)
        if "slurmd" in self._services:  # it introduces itself now, not at the next ping
            os.kill(int((self.folder / "slurmd.pid").read_text()), signal.SIGHUP)

    def start_node(self) -> None:
        """Start slurmd as on another machine: with a boot clock of its own, and without the folder `unshared`."""
        slurmd = f"{path_of('slurmd')} -D -f {self.folder}/slurm.conf"
        script = f"mount -t tmpfs none {self.unshared} && exec {slurmd}"
        self._start(
            "slurmd",
            *("--mount", "--time", f"--boottime={_BOOT_TIME_S}", "--fork", "--kill-child=KILL", "sh", "-c", script),
            program="unshare",
            variables=self._node_variables,
        )

    def fail_starts(self, *, fails: bool) -> None:
        """Have the node fail to start jobs, or start them again."""
        (self.folder / "prolog").write_text(f"#!/bin/sh\nexit {int(fails)}\n")
        (self.folder / "prolog").chmod(0o755)

    def wait_until_idle(self) -> None:
        """Wait until the node accepts jobs."""
        states = ["sinfo", "--noheader", "--partition=main", "--format=%T"]
        _wait_for(lambda: self.command(*states, check=False).stdout.strip() in {"idle", "mixed", "allocated"})

    def kill(self, program: str) -> None:
        """Kill a service: `slurmctld` or `slurmd`. Jobs of a killed node go on."""
        process = self._services.pop(program)
        process.kill()
        process.wait()

    def repair(self) -> None:
        """Cancel all jobs, and make everything run again."""
        for program, start in (("slurmctld", self.start_controller), ("slurmd", self.start_node)):
            if program not in self._services:
                start()
        self.fail_starts(fails=False)
        self.command("scancel", f"--user={os.geteuid()}", check=False)
        self.command("scontrol", "update", "PartitionName=main", "State=UP")
        self.resume_node()
        self.wait_until_idle()

    def resume_node(self) -> None:
        """Have the node accept jobs again, as an administrator does.

        A controller that is killed forgets the last seconds and uses their job ids again. If a forgotten job is still
        on the node, Slurm drains the node ("Duplicate jobid on nodes").
        """
        self.command("scontrol", "update", "NodeName=node1", "State=RESUME", check=False)

    def command(self, *command: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        """Run one of Slurm's commands."""
        environment = {"PATH": os.environ["PATH"], **self.environment}
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, check=check, timeout=60, stdin=subprocess.DEVNULL
        )

    def close(self) -> None:
        """End all jobs and services."""
        if "slurmctld" in self._services and "slurmd" in self._services:
            with contextlib.suppress(subprocess.SubprocessError):
                self.command("scancel", f"--user={os.geteuid()}", check=False)
                _wait_for(lambda: not self.command("squeue", "--noheader", check=False).stdout.strip(), 20)
        if "slurmd" in self._services:  # unshare ignores SIGTERM
            self.kill("slurmd")
        for process in reversed(self._services.values()):
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._services.clear()

    def _start(
        self,
        service: str,
        *arguments: str,
        program: str | None = None,
        variables: Mapping[str, str] | None = None,
    ) -> None:
        log = (self.folder / f"{service}.out").open("ab")
        path = path_of(program or service)
        assert path is not None
        with log:
            self._services[service] = subprocess.Popen(
                ["setpriv", "--pdeathsig=KILL", path, *arguments],  # however the tests end
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={"PATH": os.environ["PATH"] + ":/usr/sbin", **self.environment, **(variables or {})},
                cwd=self.folder,
            )


def _wait_for(condition: object, timeout_s: float = _START_S) -> None:
    assert callable(condition)
    until = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until, "Slurm did not get ready in time"
        time.sleep(0.05)


@contextlib.contextmanager
def slurm_cluster(
    cpus: int = 8, *, has_accounting: bool = False, node_variables: Mapping[str, str] | None = None
) -> Iterator[SlurmCluster]:
    """Run a cluster in a folder of its own, whose path is short: those of sockets are limited.

    `node_variables` are those of the node's service and of its jobs.
    """
    with tempfile.TemporaryDirectory(prefix="slurm-") as folder:
        cluster = SlurmCluster(Path(folder), cpus, has_accounting=has_accounting, node_variables=node_variables)
        try:
            cluster.start()
            yield cluster
        finally:
            cluster.close()
