"""The data directory of one instance: its layout, version, lock, secrets, ports and runtime information.

It belongs to one user and is closed to others. Files are written atomically.
"""

import contextlib
import fcntl
import json
import os
import re
import secrets
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import kleinkram
from kleinkram.contract.token_format import SecretKind, with_checksum
from kleinkram.standalone.errors import AlreadyRunning, DataDirUnusable, VersionMismatch
from kleinkram.standalone.processes import start_ticks

LAYOUT = 1
"""Incremented when older versions cannot read a newer layout."""


class DataDir:
    """Paths of one instance below its folder `root`."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.version_file = root / "VERSION"  # layout number and version of the Kleinkram that last used the folder
        self.lock_file = root / "lock"  # locked by the supervisor, whose pid it contains
        self.runtime_file = root / "instance.json"  # a RuntimeInfo, while the instance runs
        self.token_file = root / "owner-token"
        self.runner_token_file = root / "runner-token"
        self.runner = root / "runner"  # state directory of the instance's own runner
        self.certificates_file = root / "certificates.pem"  # with TLS: certificates that the runner trusts
        self.secrets_file = root / "secrets.json"
        self.ports_file = root / "ports.json"
        self.restoring_file = root / "RESTORING"  # the location of the backup, until a restore has finished
        self.schema_file = root / "schema"  # which migrations the database has seen
        self.postgres = root / "postgres"
        self.store = root / "store"

    def log(self, service: str) -> Path:
        """Return the log of one service."""
        return self.root / "logs" / f"{service}.log"


@dataclass(frozen=True)
class RuntimeInfo:
    """Information about the running instance for other programs of this user: the content of `instance.json`.

    `services`: pids by name; None while a service is down.
    """

    url: str
    data_dir: str
    token_file: str
    store_url: str
    local_url: str
    version: str
    started_at: str
    pid: int
    ports: dict[str, int]
    services: dict[str, int | None]


@dataclass(frozen=True)
class LockHolder:
    """The process that holds the lock; its start time tells it from a later process with the same pid."""

    pid: int
    start_ticks: int


@dataclass(frozen=True)
class Secrets:
    """Random hexadecimal secrets, safe in URLs and SQL literals, generated once."""

    postgres_admin: str
    postgres_migrate: str
    postgres_serve: str
    s3_access_key: str
    s3_secret_key: str


def create(data_dir: DataDir) -> None:
    """Create the folder, closed to other users, unless it exists.

    Raises:
        DataDirUnusable: it cannot be created or written, or contains something else.
    """
    root = data_dir.root
    try:
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        if any(root.iterdir()) and not data_dir.lock_file.exists():
            raise DataDirUnusable(f"{root} is not empty and no data directory of Kleinkram: name an empty one.")
        if root.stat().st_uid != os.geteuid():
            raise DataDirUnusable(f"{root} belongs to another user: start Kleinkram as that user, or name another.")
        (root / "logs").mkdir(mode=0o700, exist_ok=True)
        data_dir.store.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise DataDirUnusable(
            f"The data directory {root} cannot be used ({error.strerror}): choose another with --data-dir."
        ) from error


@contextlib.contextmanager
def exclusive(data_dir: DataDir) -> Iterator[None]:
    """Hold the data directory's lock; the kernel releases it however the process ends.

    Raises:
        AlreadyRunning: another process holds it.
    """
    descriptor = os.open(data_dir.lock_file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = read_holder(data_dir)
            raise AlreadyRunning(
                f"Kleinkram already runs on {data_dir.root}{f' (pid {holder.pid})' if holder else ''}: "
                "use it, end it with `klein down`, or name another --data-dir."
            ) from None
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, json.dumps(asdict(LockHolder(os.getpid(), start_ticks(os.getpid()) or 0))).encode(), 0)
        yield
    finally:
        os.close(descriptor)


def is_locked(data_dir: DataDir) -> bool:
    """Whether a supervisor holds the lock."""
    try:
        descriptor = os.open(data_dir.lock_file, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def read_holder(data_dir: DataDir) -> LockHolder | None:
    """Return the process that last took the lock, if it still runs."""
    try:
        stored = json.loads(data_dir.lock_file.read_text())
        holder = LockHolder(int(stored["pid"]), int(stored["start_ticks"]))
    except (OSError, ValueError, KeyError):
        return None
    return holder if start_ticks(holder.pid) == holder.start_ticks else None


def refuse_newer(data_dir: DataDir) -> None:
    """Refuse a folder that a newer Kleinkram has used.

    Raises:
        VersionMismatch: it is newer, or its VERSION file cannot be read.
    """
    try:
        layout, version = data_dir.version_file.read_text().split()
        newer = int(layout) > LAYOUT or _numbers(version) > _numbers(kleinkram.__version__)
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        raise VersionMismatch(
            f"{data_dir.version_file} cannot be read: put it back from a backup, or name another --data-dir."
        ) from error
    if newer:
        raise VersionMismatch(
            f"{data_dir.root} was last used by Kleinkram {version}, and this is {kleinkram.__version__}: "
            f"install {version} or later (`pip install 'open-kleinkram[up]>={version}'`), or name another "
            "--data-dir."
        )


def refuse_half_restored(data_dir: DataDir) -> None:
    """Refuse a folder into which a restore has not finished: it would show an empty instance.

    Raises:
        DataDirUnusable: the restore has not finished.
    """
    if data_dir.restoring_file.exists():
        source = data_dir.restoring_file.read_text().strip()
        raise DataDirUnusable(
            f"A restore into {data_dir.root} was not finished: run the same command again (`klein restore {source} "
            f"--data-dir {data_dir.root}`), and it continues; or remove the folder."
        )


def note_version(data_dir: DataDir) -> None:
    """Record that this version has used the folder."""
    write_private(data_dir.version_file, f"{LAYOUT} {kleinkram.__version__}\n")


def load_secrets(data_dir: DataDir) -> Secrets:
    """Return the instance's passwords and keys; the first call generates them.

    Raises:
        DataDirUnusable: the file is damaged.
    """
    if not data_dir.secrets_file.exists():
        sizes = {"postgres_admin": 16, "postgres_migrate": 16, "postgres_serve": 16}
        sizes |= {"s3_access_key": 10, "s3_secret_key": 20}
        generated = {name: secrets.token_hex(size_bytes) for name, size_bytes in sizes.items()}
        write_private(data_dir.secrets_file, json.dumps(generated, indent=2))
    try:
        return Secrets(**json.loads(data_dir.secrets_file.read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise DataDirUnusable(f"{data_dir.secrets_file} is damaged ({error}): put it back from a backup.") from error


def ensure_owner_token(data_dir: DataDir) -> None:
    """Generate the local owner's token unless it exists."""
    if not data_dir.token_file.exists():
        write_private(
            data_dir.token_file, with_checksum(f"klein_{SecretKind.personal.value}_{secrets.token_urlsafe(32)}") + "\n"
        )


def load_ports(data_dir: DataDir) -> dict[str, int]:
    """Return the ports of the last start by name; empty before the first."""
    try:
        stored = json.loads(data_dir.ports_file.read_text())
        return {str(name): int(port) for name, port in stored.items()}
    except (OSError, ValueError, AttributeError):
        return {}


def load_runtime_info(data_dir: DataDir) -> RuntimeInfo | None:
    """Return what the supervisor last wrote; None while it has not finished starting."""
    try:
        return RuntimeInfo(**json.loads(data_dir.runtime_file.read_text()))
    except (OSError, ValueError, TypeError):
        return None


def write_private(path: Path, text: str) -> None:
    """Write a file of mode 0600 atomically."""
    unfinished = path.with_name(path.name + ".new")
    unfinished.unlink(missing_ok=True)
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with os.fdopen(descriptor, "w") as file:
        file.write(text)
        file.flush()
        os.fsync(descriptor)
    unfinished.rename(path)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])
