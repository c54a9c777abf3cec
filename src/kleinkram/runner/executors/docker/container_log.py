"""Copies the output of a container to the log of its job."""

import contextlib
import json
import os
import threading
import time
from collections.abc import Iterable, Iterator
from itertools import groupby

from kleinkram.contract.runs import LOG_BYTES
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.docker.client import (
    ContainerInfo,
    DockerClient,
    EngineError,
    EngineUnavailable,
    OutputPiece,
)
from kleinkram.runner.executors.docker.container import LOG_LABEL, container_name
from kleinkram.runner.executors.limits import LOG, LOG_IS_FULL
from kleinkram.runner.files import write_all

LOG_CURSOR = "log.cursor"
_GAP = b"\n[kleinkram] lines may be missing here: the engine did not keep all of the output\n"
_FIRST_OUTPUT_BYTES = 2**12
_LONGEST_LINE_BYTES = 2**16
_RETRY_EVERY_S = 0.2


class ContainerLog:
    """Copies the output of a container in a thread.

    The engine stores the output as well. An interrupted copy continues after as many bytes of each stream as it has
    (the order of the two streams may change between reads): nothing is missing or duplicated. These numbers are written
    before each append, so that a partial append counts, too. Without `can_follow` (Podman) the stored output is read
    repeatedly.
    """

    def __init__(self, client: DockerClient, job: RunJob, *, can_follow: bool = True) -> None:
        self._client = client
        self._can_follow = can_follow
        self._name = container_name(job)
        self._path = job.directory / LOG
        self._cursor_path = job.directory / LOG_CURSOR
        self._thread: threading.Thread | None = None
        self._is_closed = threading.Event()
        self._has_exited = threading.Event()
        self._offset = 0
        self._cursor = -1
        self._copied = {1: 0, 2: 0}
        self.is_complete = False
        self.has_space = True

    def follow(self, container: ContainerInfo) -> None:
        """Start copying, if that has not started."""
        if self._thread is None:
            self._offset = int(container.labels.get(LOG_LABEL, 0))
            self._thread = threading.Thread(target=self._copy, name="container log", daemon=True)
            self._thread.start()

    def finish(self) -> None:
        """Note that the container has exited: nothing follows the stored output."""
        self._has_exited.set()

    def close(self) -> None:
        """Stop copying soon."""
        self._is_closed.set()
        self._has_exited.set()

    def first_output(self) -> bytes:
        """Return the beginning of what this container wrote."""
        with contextlib.suppress(FileNotFoundError), self._path.open("rb") as stream:
            stream.seek(self._offset)
            return stream.read(_FIRST_OUTPUT_BYTES)
        return b""

    def _copy(self) -> None:
        log = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
        self._cursor = os.open(self._cursor_path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        if text := os.pread(self._cursor, 4096, 0):
            cursor = json.loads(text)
            self._copied = {1: cursor["copied"][0], 2: cursor["copied"][1]}
            self._copied[cursor["next"]] += os.fstat(log).st_size - cursor["size"]
        try:
            while not self._is_closed.is_set():
                had_exited = self._has_exited.is_set()
                # The stream of a follower may end before the last output: the stored output is read once more.
                is_whole = False
                started_s = time.monotonic()
                with contextlib.suppress(EngineUnavailable, EngineError):
                    is_whole = self._copy_missing(log, is_final=had_exited)
                if os.fstat(log).st_size >= LOG_BYTES or (had_exited and is_whole):
                    break
                # Reading all of it takes at most a tenth of the time.
                read_s = 0.0 if self._can_follow else time.monotonic() - started_s
                self._has_exited.wait(max(_RETRY_EVERY_S, 10 * read_s))
                if had_exited:
                    self._is_closed.wait(_RETRY_EVERY_S)
        except OSError:
            self.has_space = False
        finally:
            os.close(log)
            os.close(self._cursor)
            self.is_complete = True

    def _copy_missing(self, log: int, *, is_final: bool) -> bool:
        """Append what is missing of the stored output; return whether that came to its end."""
        skip = dict(self._copied)
        since_ns = 0
        if any(skip.values()) and not self._begins_alike(log):
            since_ns, skip = os.fstat(log).st_mtime_ns, {1: 0, 2: 0}
            write_all(log, _GAP)
        stored = self._client.log(self._name, follow=self._can_follow and not is_final, since_ns=since_ns)
        for stream, data in _complete_lines(stored, is_final=is_final):
            known = min(skip[stream], len(data))
            skip[stream] -= known
            if known < len(data) and not self._append(log, stream, data[known:]):
                return True
            if self._is_closed.is_set():
                return True
        return True

    def _begins_alike(self, log: int) -> bool:
        """Whether the engine still stores the beginning of the output, which it drops of a very long one."""
        pieces = next(iter(self._client.log(self._name, follow=False)), [])
        if not pieces:
            return True
        first = pieces[0].data[: self._copied[pieces[0].stream]]
        return first in os.pread(log, _FIRST_OUTPUT_BYTES + len(first), self._offset)

    def _append(self, log: int, stream: int, data: bytes) -> bool:
        """Append data up to the limit; return whether more is wanted."""
        size = os.fstat(log).st_size
        data = data[: LOG_BYTES - size]
        cursor = {"size": size, "copied": [self._copied[1], self._copied[2]], "next": stream}
        # A single write of constant length is atomic.
        os.pwrite(self._cursor, json.dumps(cursor).ljust(120).encode(), 0)
        write_all(log, data)
        self._copied[stream] += len(data)
        if size + len(data) < LOG_BYTES:
            return True
        write_all(log, LOG_IS_FULL)
        return False


def _complete_lines(batches: Iterable[list[OutputPiece]], *, is_final: bool) -> Iterator[OutputPiece]:
    """Yield output so that lines of one stream do not cut those of the other: Podman stores parts of lines."""
    pending = {1: b"", 2: b""}
    for pieces in batches:
        for stream, same in groupby(pieces, key=lambda piece: piece.stream):
            data = pending[stream] + b"".join(piece.data for piece in same)
            end = data.rfind(b"\n") + 1 if len(data) < _LONGEST_LINE_BYTES else len(data)
            pending[stream] = data[end:]
            if end:
                yield OutputPiece(stream, data[:end])
    if is_final:
        yield from (OutputPiece(stream, data) for stream, data in pending.items() if data)
