"""Log texts: rosout, Foxglove's logs, diagnostics and strings; the first and the most severe ones."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

from kleinkram.recordings.decoding.values import part
from kleinkram.recordings.previews.model import LogLine, LogSeverity

LOG_TYPES = frozenset(("Log", "DiagnosticArray", "String"))
"""Types of texts, without their package."""

MAX_FIRST_LINES, MAX_SEVERE_LINES = 200, 400
MAX_TEXT = 500
_MAX_STATUSES = 2_000  # diagnostic statuses whose last level and text are remembered
_RANKS = {severity: rank for rank, severity in enumerate(LogSeverity)}
# rosgraph_msgs/Log has powers of two, rcl_interfaces/Log tens, foxglove.Log 1 to 5.
_ROS1 = {1: "debug", 2: "info", 4: "warning", 8: "error", 16: "fatal"}
_ROS2 = {10: "debug", 20: "info", 30: "warning", 40: "error", 50: "fatal"}
_FOXGLOVE = {1: "debug", 2: "info", 3: "warning", 4: "error", 5: "fatal"}
_FOXGLOVE_NAMES = {"DEBUG": "debug", "INFO": "info", "WARNING": "warning", "ERROR": "error", "FATAL": "fatal"}
_DIAGNOSTIC = {0: "info", 1: "warning", 2: "error", 3: "error"}  # 3 is "stale"


class LogLines:
    """Lines of all log topics. Of diagnostics, only statuses that are not OK and differ from the one before."""

    def __init__(self) -> None:
        self.count = 0
        self._first: list[LogLine] = []
        self._severe: list[tuple[int, int, LogLine]] = []
        self._statuses: dict[tuple[str, str], tuple[int, str]] = {}

    def add(self, topic: str, time_ns: int, value: object) -> None:
        """Add the lines of a decoded message."""
        for severity, source, text in self._lines(topic, value):
            line = LogLine(time_ns, topic, severity, _short(source), _short(text))
            self.count += 1
            if len(self._first) < MAX_FIRST_LINES:
                self._first.append(line)
            elif _RANKS[severity] >= _RANKS[LogSeverity.warning]:
                # Of equal severity, the earliest.
                entry = _RANKS[severity], -self.count, line
                if len(self._severe) < MAX_SEVERE_LINES:
                    heapq.heappush(self._severe, entry)
                else:
                    heapq.heappushpop(self._severe, entry)

    def lines(self) -> tuple[LogLine, ...]:
        """Return the lines by time."""
        return tuple(sorted([*self._first, *(line for _, _, line in self._severe)], key=lambda line: line.time_ns))

    def _lines(self, topic: str, value: object) -> Iterator[tuple[LogSeverity, str, str]]:
        statuses = part(value, "status")
        if isinstance(statuses, list):
            for status in statuses:
                yield from self._changed_status(topic, status)
        elif part(value, "msg") is not None:
            levels = _ROS2 if part(value, "stamp") is not None else _ROS1
            yield _severity(levels, part(value, "level")), str(part(value, "name") or ""), str(part(value, "msg"))
        elif part(value, "message") is not None and part(value, "level") is not None:
            yield (
                _severity(_FOXGLOVE, part(value, "level")),
                str(part(value, "name") or ""),
                str(part(value, "message")),
            )
        elif isinstance(part(value, "data"), str):
            yield LogSeverity.unknown, "", str(part(value, "data"))

    def _changed_status(self, topic: str, status: object) -> Iterator[tuple[LogSeverity, str, str]]:
        level, name, text = part(status, "level"), str(part(status, "name") or ""), str(part(status, "message") or "")
        level = level[0] if isinstance(level, bytes) and level else level
        if not isinstance(level, int):
            return
        status_id, current = (topic, _short(name)), (level, _short(text))
        if self._statuses.get(status_id) == current:
            return
        if status_id in self._statuses or len(self._statuses) < _MAX_STATUSES:
            self._statuses[status_id] = current
        if level:
            yield _severity(_DIAGNOSTIC, level), name, text


def _severity(levels: dict[int, str], level: object) -> LogSeverity:
    if isinstance(level, str):
        return LogSeverity(_FOXGLOVE_NAMES.get(level, "unknown"))
    return LogSeverity(levels.get(level, "unknown")) if isinstance(level, int) else LogSeverity.unknown


def _short(text: str) -> str:
    """Return a text that UTF-8 can express, of bounded length."""
    return text[:MAX_TEXT].encode("utf-8", "replace").decode()
