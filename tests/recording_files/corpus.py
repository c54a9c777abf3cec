"""The real recordings and what independent readers report about them (`manifest.json`)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import pytest

from tests.conftest import RECORDINGS

MESSAGE_FORMATS = "MCAP", "ROS1 bag 2.0", "ROS2 sqlite3 db3", "file-zstd of ROS2 sqlite3 db3", "file-zstd of MCAP"
"""Formats of which independent libraries read the messages."""


@dataclass(frozen=True)
class Entry:
    """One file of the manifest; `made_from`: the file that it is a changed copy of."""

    name: str
    broken: str | None
    expected: dict[str, Any]
    made_from: str | None = None

    @property
    def format(self) -> str:
        return str(self.expected.get("format", ""))


@cache
def entries() -> tuple[Entry, ...]:
    """All files of the manifest; none where the recordings are missing."""
    path = RECORDINGS / "manifest.json"
    if not path.is_file():
        return ()
    return tuple(
        Entry(item["file"], item.get("broken"), item.get("expected") or {}, item.get("derived_from"))
        for item in json.loads(path.read_text())["files"]
    )


def params(*formats: str, broken: bool = False, without: str = "") -> list[Any]:
    """Test parameters: the files of some formats, whole or broken; without recordings, one that will be skipped."""
    actual = [e for e in entries() if e.format in formats and (e.broken is not None) == broken and e.name != without]
    missing = Entry("recordings are missing", None, {})
    return [pytest.param(entry, id=entry.name) for entry in actual or [missing]]
