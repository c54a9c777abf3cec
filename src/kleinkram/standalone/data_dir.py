"""The folder that holds one instance: its layout, its version, its lock, its secrets and what it tells the CLI.

Everything in it belongs to one user and is closed to others. Files are written whole, under another name first.
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
from kleinkram.contract.tokens import SecretKind, with_checksum
from kleinkram.standalone.errors import AlreadyRunning, DataDirUnusable, VersionMismatch
from kleinkram.standalone.procs import start_ticks

LAYOUT = 1
"""Raised when a newer Kleinkram lays the folder out so that an older one cannot read it."""


@dataclass(frozen=True)
class DataDir:
    """Paths of one instance."""

    root: Path

    @property
    def version_file(self) -> Path:
        """Layout number and version of the Kleinkram that last used the folder."""
        return self.root / "VERSION"

    @property
    def lock_file(self) -> Path:
        """Held locked by the supervisor; names it."""
        return self.root / "lock"

    @property
    def instance_file(self) -> Path:
        """What the CLI and other programs of this user may know of the running instance."""
        return self.root / "instance.json"

    @property
    def token_file(self) -> Path:
        """The local owner's token."""
        return self.root / "owner-token"

    @property
    def runner_token_file(self) -> Path:
        """The token of the instance's own runner."""
        return self.root / "runner-token"

    @property
    def runner(self) -> Path:
        """What the instance's own runner keeps: its runs and their inputs."""
        return self.root / "runner"

    @property
    def certificates_file(self) -> Path:
        """With TLS, whom the instance's own runner believes."""
        return self.root / "certificates.pem"

    @property
    def secrets_file(self) -> Path:
        """Passwords and keys of the parts."""
        return self.root / "secrets.json"

    @property
    def ports_file(self) -> Path:
        """The ports chosen, so that a restart finds them again."""
        return self.root / "ports.json"

    @property
    def restoring_file(self) -> Path:
        """There while a backup is being restored into the folder: from where."""
        return self.root / "RESTORING"

    @property
    def schema_file(self) -> Path:
        """Which migrations the database has seen."""
        return self.root / "schema"

    @property
    def postgres(self) -> Path:
        """PostgreSQL's cluster."""
        return self.root / "postgres"

    @property
    def store(self) -> Path:
        """The store's objects and settings."""
        return self.root / "store"

    def log(self, part: str) -> Path:
        """The log of one part."""
        return self.root / "logs" / f"{part}.log"


@dataclass(frozen=True)
class Holder:
    """The process that holds the lock: a pid alone may have been given to another process since."""

    pid: int
    start_ticks: int


@dataclass(frozen=True)
class Secrets:
    """Random, made once, hexadecimal: safe in URLs, SQL literals and files."""

    postgres_admin: str
    postgres_migrate: str
    postgres_serve: str
    s3_access_key: str
    s3_secret_key: str


def create(data_dir: DataDir) -> None:
    """Make the folder unless it is there, and see that it can be used and is closed to others.

    Raises:
        DataDirUnusable: it cannot be made or written, or is not a data directory but has other things in it.
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
    """Hold the data directory's lock; the kernel gives it back however the holder ends.

    Raises:
        AlreadyRunning: somebody else holds it.
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
        os.pwrite(descriptor, json.dumps(asdict(Holder(os.getpid(), start_ticks(os.getpid()) or 0))).encode(), 0)
        yield
    finally:
        os.close(descriptor)


def is_held(data_dir: DataDir) -> bool:
    """Whether a supervisor holds the lock now."""
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


def read_holder(data_dir: DataDir) -> Holder | None:
    """The process that last took the lock, if it still lives."""
    try:
        noted = json.loads(data_dir.lock_file.read_text())
        holder = Holder(int(noted["pid"]), int(noted["start_ticks"]))
    except (OSError, ValueError, KeyError):
        return None
    return holder if start_ticks(holder.pid) == holder.start_ticks else None


def refuse_newer(data_dir: DataDir) -> None:
    """Refuse a folder that a newer Kleinkram has used; its database may hold what this one would spoil.

    Raises:
        VersionMismatch: it is newer, or its VERSION file says nothing.
    """
    try:
        layout, version = data_dir.version_file.read_text().split()
        newer = int(layout) > LAYOUT or _numbers(version) > _numbers(kleinkram.__version__)
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        raise VersionMismatch(
            f"{data_dir.version_file} cannot be understood: put it back from a backup, or name another --data-dir."
        ) from error
    if newer:
        raise VersionMismatch(
            f"{data_dir.root} was last used by Kleinkram {version}, and this is {kleinkram.__version__}: "
            f"install {version} or later (`pip install 'open-kleinkram[up]>={version}'`), or name another "
            "--data-dir."
        )


def refuse_half_restored(data_dir: DataDir) -> None:
    """Refuse a folder into which a restore did not get to its end: it would show an empty site, and let people fill it.

    Raises:
        DataDirUnusable: it is one.
    """
    if data_dir.restoring_file.exists():
        source = data_dir.restoring_file.read_text().strip()
        raise DataDirUnusable(
            f"A restore into {data_dir.root} was not finished: run the same command again (`klein restore {source} "
            f"--data-dir {data_dir.root}`), and it goes on; or remove the folder."
        )


def note_version(data_dir: DataDir) -> None:
    """Note that this version has used the folder."""
    write_private(data_dir.version_file, f"{LAYOUT} {kleinkram.__version__}\n")


def load_secrets(data_dir: DataDir) -> Secrets:
    """The instance's passwords and keys, made at the first call.

    Raises:
        DataDirUnusable: the file is damaged.
    """
    if not data_dir.secrets_file.exists():
        made = Secrets(
            postgres_admin=secrets.token_hex(16),
            postgres_migrate=secrets.token_hex(16),
            postgres_serve=secrets.token_hex(16),
            s3_access_key=secrets.token_hex(10),
            s3_secret_key=secrets.token_hex(20),
        )
        write_private(data_dir.secrets_file, json.dumps(asdict(made), indent=2))
    try:
        return Secrets(**json.loads(data_dir.secrets_file.read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise DataDirUnusable(f"{data_dir.secrets_file} is damaged ({error}): put it back from a backup.") from error


def ensure_owner_token(data_dir: DataDir) -> None:
    """Make the local owner's token at the first call."""
    if not data_dir.token_file.exists():
        write_private(
            data_dir.token_file, with_checksum(f"klein_{SecretKind.personal.value}_{secrets.token_urlsafe(32)}") + "\n"
        )


def load_ports(data_dir: DataDir) -> dict[str, int]:
    """The ports of the last start, by name; empty where there was none."""
    try:
        noted = json.loads(data_dir.ports_file.read_text())
        return {str(name): int(port) for name, port in noted.items()}
    except (OSError, ValueError, AttributeError):
        return {}


def write_private(path: Path, text: str) -> None:
    """Write a file of mode 0600 whole, or not at all."""
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
