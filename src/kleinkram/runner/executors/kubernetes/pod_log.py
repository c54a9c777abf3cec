"""Copies the output of a pod to the file of a job while it runs, and continues after a break where it was.

The cluster gives each line a time. A cursor records the last time, how many lines had it, and the size of the copy; it
is written after the lines, and what is beyond it is copied again: the same bytes at the same place.
"""

import contextlib
import datetime
import json
import logging
import os
import threading
from pathlib import Path
from typing import NamedTuple

from kleinkram.contract.runs import LOG_BYTES
from kleinkram.runner.executors.kubernetes.cluster import Cluster, ClusterError
from kleinkram.runner.executors.supervision import LOG, LOG_IS_FULL, write_all, write_in_place

_log = logging.getLogger("kleinkram.runner")
LOG_CURSOR = "log.cursor"
_RETRY_S = 0.5
# Lines are asked for from this long before the last one, since clocks of nodes differ.
_CLOCK_MARGIN_S = 300
_GAP = b"\n[kleinkram] lines may be missing here: the cluster does not have all of the output any more\n"
_LONGEST_TIME = 40


class _Cursor(NamedTuple):
    """Lines up to `time`, of which `lines` had that time, are the first `size_bytes` of the copy."""

    time: str = ""
    lines: int = 0
    size_bytes: int = 0


class PodLog:
    """The copy of one pod's output. `is_gone`: the cluster has no more of it."""

    def __init__(self, cluster: Cluster, pod: str, directory: Path) -> None:
        self._cluster = cluster
        self._pod = pod
        self._path = directory / LOG
        self._cursor_path = directory / LOG_CURSOR
        self._is_closed = threading.Event()
        self._has_ended = threading.Event()
        self._thread: threading.Thread | None = None
        self.is_complete = False
        self.is_gone = False
        self.has_space = True

    def follow(self) -> None:
        """Begin to copy."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="log", daemon=True)
            self._thread.start()

    def finish(self) -> None:
        """Have the copy end with the output that is there: the pod has ended."""
        self._has_ended.set()

    def give_up(self) -> None:
        """Note in the copy that some output is lost: the pod is gone."""
        self.close()
        with contextlib.suppress(OSError), self._path.open("ab") as stream:
            stream.write(_GAP)

    def close(self) -> None:
        """End the thread soon."""
        self._is_closed.set()

    def _run(self) -> None:
        try:
            cursor = self._read_cursor()
            while not self._is_closed.is_set():
                was_over = self._has_ended.is_set()
                try:
                    cursor, is_whole = self._copy(cursor)
                except ClusterError as error:
                    if error.is_missing:
                        self.is_gone = True
                        return
                    is_whole = False
                if is_whole and was_over:
                    self.is_complete = True
                    return
                self._is_closed.wait(_RETRY_S)
        except OSError as error:
            self.has_space = False
            _log.warning("the output of %s is not copied any more: %s", self._pod, error)

    def _read_cursor(self) -> _Cursor:
        try:
            return _Cursor(*json.loads(self._cursor_path.read_text()))
        except (FileNotFoundError, ValueError, TypeError):
            # Before it are the lines of an earlier start of the job.
            cursor = _Cursor(size_bytes=self._path.stat().st_size if self._path.exists() else 0)
            write_in_place(self._cursor_path, json.dumps(cursor))
            return cursor

    def _copy(self, cursor: _Cursor) -> tuple[_Cursor, bool]:
        """Copy lines until the stream ends; return the new cursor, and whether the stream was whole."""
        log = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        copy = _Copy(cursor)
        try:
            os.lseek(log, cursor.size_bytes, os.SEEK_SET)
            for lines in self._cluster.follow_log(self._pod, _seconds_since(cursor.time)):
                if self._is_closed.is_set():
                    return copy.cursor, False
                before = copy.cursor
                write_all(log, b"".join([copy.add(line) for line in lines]))
                if copy.cursor != before:
                    write_in_place(self._cursor_path, json.dumps(copy.cursor))
        except ClusterError as error:
            if error.is_missing:
                raise
            return copy.cursor, False
        finally:
            os.close(log)
        return copy.cursor, not copy.is_broken


class _Copy:
    """One pass through the lines of a pod, of which those before the cursor are left out.

    `is_broken`: the node could not read all of them.
    """

    def __init__(self, cursor: _Cursor) -> None:
        self.cursor = cursor
        self._resumed = cursor
        self._same_time = 0
        self._time = ""
        self._size_bytes = cursor.size_bytes
        self._is_line_start = True
        self._is_of_node = False
        self.is_broken = False
        # Until the first line after the cursor: later ones may have earlier times, if the clock of the node is set.
        self._is_left_out = True

    def add(self, line: bytes) -> bytes:
        """Return what is to be written of a line, or of a piece of one."""
        text = line
        if self._is_line_start:
            self._time, text = _split(line)
            # Nodes write there, without a time, what goes wrong while they read.
            self._is_of_node = not self._time
            self.is_broken = self.is_broken or self._is_of_node
            if not self._is_of_node and self._is_left_out and not self._is_before_cursor():
                self._is_left_out = False
                if self._same_time < self._resumed.lines:
                    # The node has begun a new file since, and deletes the older ones.
                    text = _GAP + text
        self._is_line_start = line.endswith(b"\n")
        if self._is_left_out or self._is_of_node:
            return b""
        free_bytes = LOG_BYTES - self._size_bytes
        if free_bytes < 0:
            text = b""
        elif len(text) > free_bytes:
            text = text[:free_bytes] + LOG_IS_FULL
        self._size_bytes += len(text)
        if self._is_line_start:
            lines = self.cursor.lines + 1 if self._time == self.cursor.time else 1
            self.cursor = _Cursor(self._time, lines, self._size_bytes)
        return text

    def _is_before_cursor(self) -> bool:
        if self._time != self._resumed.time:
            return self._time < self._resumed.time
        self._same_time += 1
        return self._same_time <= self._resumed.lines


def _split(line: bytes) -> tuple[str, bytes]:
    """Return the time of a line, in a form that sorts, and its text."""
    time, space, text = line.partition(b" ")
    if not space or len(time) > _LONGEST_TIME or b"T" not in time:
        return "", line
    seconds, _, fraction = time.decode(errors="replace").removesuffix("Z").partition(".")
    return f"{seconds}.{fraction:0<9}", text


def _seconds_since(time: str) -> int | None:
    if not time:
        return None
    at = datetime.datetime.fromisoformat(time.partition(".")[0]).replace(tzinfo=datetime.timezone.utc)
    return int((datetime.datetime.now(datetime.timezone.utc) - at).total_seconds()) + _CLOCK_MARGIN_S
