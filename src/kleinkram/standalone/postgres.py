"""Life-cycle of a private PostgreSQL: made once, reached over loopback TCP with passwords, stopped fast, recovered.

Never removes or upgrades a database cluster. Whoever calls `start` must hold the data directory's lock: a stale
`postmaster.pid` is removed on the strength of that, after looking for processes that still use the cluster.
"""

import contextlib
import os
import pwd
import shutil
import signal
import subprocess
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from kleinkram.runner.executors.local import memory_bytes
from kleinkram.standalone.binaries import PostgresBinaries
from kleinkram.standalone.child import CALLER, Command, Identity, namespace_allowed, spawn
from kleinkram.standalone.errors import DataDirUnusable, PartFailed, VersionMismatch
from kleinkram.standalone.procs import users_of_folder

ADMIN = "kleinkram_admin"
MIGRATE = "kleinkram_migrate"
SERVE = "kleinkram_serve"
DATABASE = "kleinkram"
STOP_SIGNAL = signal.SIGINT
"""PostgreSQL's "fast shutdown": ends sessions, writes what is due, leaves nothing to recover."""

_SETTINGS = {
    "listen_addresses": "127.0.0.1",
    "unix_socket_directories": "",
    "max_connections": "40",
    "io_method": "sync",
    "jit": "off",
    # What is not in memory is on a flash disk: looking up a mission's files one by one beats reading those of all.
    "random_page_cost": "1.1",
    "autovacuum_max_workers": "1",
    "max_parallel_workers": "0",
    "max_parallel_workers_per_gather": "0",
    "max_wal_size": "256MB",
    "min_wal_size": "32MB",
    "log_timezone": "UTC",
    "timezone": "UTC",
    "password_encryption": "scram-sha-256",
    "log_min_messages": "warning",
}

# Of the machine's memory, for the database's own cache of its files: taken only as far as there is data to fill it.
_BUFFERS_SHARE, _LEAST_BUFFERS_MB, _MOST_BUFFERS_MB = 1 / 16, 128, 1024
_PSQL_OPTIONS = ["-X", "-q", "-A", "-t", "-v", "ON_ERROR_STOP=1", "-f", "-", "-h", "127.0.0.1", "-U", ADMIN]


@dataclass(frozen=True)
class PostgresPasswords:
    """One password per role."""

    admin: str
    migrate: str
    serve: str


@dataclass(frozen=True)
class PostgresCluster:
    """Where one private PostgreSQL lives, and how it is reached."""

    binaries: PostgresBinaries
    data_dir: Path
    folder: Path
    log: Path
    port: int
    passwords: PostgresPasswords

    def url(self, role: str, database: str = DATABASE) -> str:
        """`postgresql://` URL of a database for one of the three roles."""
        password = {ADMIN: self.passwords.admin, MIGRATE: self.passwords.migrate, SERVE: self.passwords.serve}[role]
        return role_url(role, password, self.port, database)


def role_url(role: str, password: str, port: int, database: str = DATABASE) -> str:
    """`postgresql://` URL of a private PostgreSQL on this machine."""
    return f"postgresql://{role}:{password}@127.0.0.1:{port}/{database}"


def initialise(cluster: PostgresCluster) -> None:
    """Make the cluster unless it is there. A creation that was interrupted is done anew.

    Raises:
        VersionMismatch: it is there, of another major version than the programs.
        DataDirUnusable: PostgreSQL cannot be run on this folder by this user.
        PartFailed: initdb failed.
    """
    version = cluster.folder / "PG_VERSION"
    if version.exists():
        _refuse_other_version(cluster, version.read_text().strip())
        return
    unfinished = cluster.folder.with_name(cluster.folder.name + ".new")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(mode=0o700)
    password_file = cluster.data_dir / ".initdb-password"
    password_file.touch(mode=0o600)
    try:
        password_file.write_text(cluster.passwords.admin)
        _run_initdb(cluster, unfinished, password_file)
    finally:
        password_file.unlink()
    unfinished.rename(cluster.folder)


def start(cluster: PostgresCluster, *, extra: Mapping[str, str] | None = None) -> "subprocess.Popen[bytes]":
    """Start the server, `extra` settings last; it recovers by itself what a crash left. Returns before it is ready.

    Raises:
        PartFailed: processes of an earlier start still use the cluster.
    """
    _clear_stale_lock(cluster)
    buffers_mb = min(max(int(memory_bytes() * _BUFFERS_SHARE / 1e6), _LEAST_BUFFERS_MB), _MOST_BUFFERS_MB)
    own = {"shared_buffers": f"{buffers_mb}MB", "port": str(cluster.port)}
    settings = {**_SETTINGS, **own, **(extra or {})}
    if cluster.binaries.major < 18:
        del settings["io_method"]
    arguments = [str(cluster.binaries.folder / "postgres"), "-D", str(cluster.folder)]
    for name, value in settings.items():
        arguments += ["-c", f"{name}={value}"]
    return spawn(_as_child(cluster, arguments, death_signal=STOP_SIGNAL))


def is_ready(cluster: PostgresCluster, child: "subprocess.Popen[bytes]") -> bool:
    """Whether this very server has finished recovery and accepts connections."""
    try:
        lines = (cluster.folder / "postmaster.pid").read_text().splitlines()
    except OSError:
        return False
    # Source: PostgreSQL, src/include/utils/pidfile.h: line 1 the pid, line 8 the status.
    return len(lines) >= 8 and lines[0].strip() == str(child.pid) and lines[7].strip() == "ready"


def prepare_database(cluster: PostgresCluster) -> None:
    """Bring roles, passwords, database and grants to what they should be; does nothing where they are.

    Raises:
        PartFailed: PostgreSQL refused.
    """
    passwords = cluster.passwords
    # Names are constants, passwords are of our own making (hexadecimal): nothing here can end a literal.
    script = f"""
        DO $$ BEGIN
          IF NOT EXISTS (SELECT FROM pg_roles WHERE rolname = '{MIGRATE}') THEN CREATE ROLE {MIGRATE} LOGIN; END IF;
          IF NOT EXISTS (SELECT FROM pg_roles WHERE rolname = '{SERVE}') THEN CREATE ROLE {SERVE} LOGIN; END IF;
        END $$;
        ALTER ROLE {MIGRATE} PASSWORD '{passwords.migrate}';
        ALTER ROLE {SERVE} PASSWORD '{passwords.serve}';
        SELECT 'CREATE DATABASE {DATABASE} OWNER {MIGRATE}'
          WHERE NOT EXISTS (SELECT FROM pg_database WHERE datname = '{DATABASE}') \\gexec
        REVOKE ALL ON DATABASE {DATABASE} FROM PUBLIC;
        GRANT CONNECT ON DATABASE {DATABASE} TO {SERVE};
        \\connect {DATABASE}
        ALTER SCHEMA public OWNER TO {MIGRATE};
        GRANT USAGE ON SCHEMA public TO {SERVE};
    """  # noqa: S608  (see above)
    run_sql(cluster, script)


def run_sql(cluster: PostgresCluster, script: str, *, database: str = "postgres") -> str:
    """Run a psql script as the administrator; returns its output, unaligned, tuples only.

    Raises:
        PartFailed: a statement failed; the message carries PostgreSQL's.
    """
    done = subprocess.run(
        [cluster.binaries.folder / "psql", *_PSQL_OPTIONS, "-p", str(cluster.port), "-d", database],
        input=script,
        capture_output=True,
        text=True,
        check=False,
        env={"PGPASSWORD": cluster.passwords.admin, "PGCONNECT_TIMEOUT": "10"},
    )
    if done.returncode != 0:
        raise PartFailed(f"PostgreSQL on port {cluster.port} refused: {done.stderr.strip()} (log: {cluster.log})")
    return done.stdout.strip()


def _run_initdb(cluster: PostgresCluster, folder: Path, password_file: Path) -> None:
    locale = ["--locale=C", "--locale-provider=builtin", "--builtin-locale=C.UTF-8"]
    if cluster.binaries.major < 17:
        locale = ["--locale=C.UTF-8"]
    arguments = [str(cluster.binaries.folder / "initdb"), "-D", str(folder), "-U", ADMIN, "-A", "scram-sha-256"]
    arguments += ["--encoding=UTF8", "--data-checksums", f"--pwfile={password_file}", *locale]
    command = _as_child(cluster, arguments, death_signal=signal.SIGKILL)
    if command.identity.uid is not None and command.identity.gid is not None:
        for path in (folder, password_file):
            os.chown(path, command.identity.uid, command.identity.gid)
    if spawn(command).wait() != 0:
        raise PartFailed(f"PostgreSQL's database could not be made in {cluster.folder}: see {cluster.log}.")


def _as_child(cluster: PostgresCluster, arguments: list[str], *, death_signal: signal.Signals) -> Command:
    return Command(
        arguments=arguments,
        data_dir=cluster.data_dir,
        log=cluster.log,
        directory=Path("/"),
        death_signal=death_signal,
        identity=_identity(cluster),
    )


def _identity(cluster: PostgresCluster) -> Identity:
    """Root may not run PostgreSQL: it becomes another number in a user namespace, else another user."""
    if os.geteuid() != 0:
        return CALLER
    owner = cluster.folder.stat().st_uid if cluster.folder.exists() else 0
    if owner == 0 and namespace_allowed():
        return Identity(in_namespace=True)
    return _other_user(cluster)


def _other_user(cluster: PostgresCluster) -> Identity:
    user = next((entry for entry in pwd.getpwall() if entry.pw_name == "postgres"), None) or pwd.getpwnam("nobody")
    closed = [parent for parent in cluster.folder.parents if not parent.stat().st_mode & 0o001]
    for parent in closed:
        if parent == cluster.data_dir:
            parent.chmod(0o711)
            continue
        raise DataDirUnusable(
            f"PostgreSQL may not run as root, and user '{user.pw_name}' cannot enter {parent}: "
            "run `klein up` as an ordinary user, or choose a --data-dir that others may enter, as /var/lib/kleinkram."
        )
    return Identity(uid=user.pw_uid, gid=user.pw_gid)


def _refuse_other_version(cluster: PostgresCluster, found: str) -> None:
    if found != str(cluster.binaries.major):
        raise VersionMismatch(
            f"The database in {cluster.folder} was made by PostgreSQL {found}, but the programs in "
            f"{cluster.binaries.folder} are of version {cluster.binaries.major}. Nothing was changed. With the "
            f"Kleinkram that used it last, or a folder of programs of version {found} in KLEINKRAM_POSTGRES_BIN, run "
            f"`klein backup create BACKUPS --data-dir {cluster.data_dir}`; then, with this one, "
            "`klein restore BACKUPS --data-dir NEW`."
        )


def _clear_stale_lock(cluster: PostgresCluster) -> None:
    """Remove the pid file that a crash left: if its number belongs to anybody by now, PostgreSQL would not start."""
    deadline = time.monotonic() + 5
    while users := users_of_folder(cluster.folder, program="postgres"):
        if time.monotonic() > deadline:
            raise PartFailed(
                f"PostgreSQL processes {', '.join(map(str, users))} of an earlier start still use {cluster.folder}: "
                "end them, then start again."
            )
        time.sleep(0.02)
    with contextlib.suppress(FileNotFoundError):
        (cluster.folder / "postmaster.pid").unlink()
