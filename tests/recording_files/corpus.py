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


_LIKE_OTHERS = {
    "derived/metadata_wrong_counts/SO_bag_0.mcap",
    "ros1/kleinkram_imu_lz4.bag",
    "ros1/robot_localization_test1_imu_odom_gps_bz2.bag",
    "ros1/turtlesim_bz2.bag",
    "ros1/turtlesim_none.bag",
}
"""Recordings with the messages of another in another compression or format, or with many more of the same types."""


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


def params_to_write(*formats: str) -> list[Any]:
    """`params` for tests that write recordings anew; those that are like others are written in the soak.

    Tests of reading read all of them in every round.
    """
    return [
        pytest.param(*one.values, id=one.id, marks=pytest.mark.soak) if one.id in _LIKE_OTHERS else one
        for one in params(*formats)
    ]
