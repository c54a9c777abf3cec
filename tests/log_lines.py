"""What processes log as JSON, for tests."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from kleinkram.json_logs import JsonLines


class _Collector(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.DEBUG)
        self.setFormatter(JsonLines("test"))
        self.lines: list[dict[str, Any]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(json.loads(self.format(record)))


@contextmanager
def logged_lines(level: int = logging.INFO) -> Iterator[list[dict[str, Any]]]:
    """Collect the lines that our code logs meanwhile, from a level on."""
    collector, ours = _Collector(), logging.getLogger("kleinkram")
    before = ours.level
    ours.addHandler(collector)
    ours.setLevel(level)
    try:
        yield collector.lines
    finally:
        ours.removeHandler(collector)
        ours.setLevel(before)
