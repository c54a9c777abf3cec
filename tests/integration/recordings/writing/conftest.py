"""Fixtures of the tests of written files."""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.recordings.sample import generate_bag, generate_mcap
from kleinkram.recordings.sample.motion import MotionState
from kleinkram.recordings.sample.scene import LidarView

_LARGE_BYTES = 150_000_000
_SCANS = 8


@pytest.fixture(scope="module")
def _repeated_scans() -> Iterator[None]:
    """Let a lidar repeat its first scans: computing each anew takes most of the time of a large recording."""
    scans: dict[tuple[LidarView, int], array[float]] = {}
    scan = LidarView.scan

    def remembered(view: LidarView, number: int, state: MotionState) -> array[float]:
        key = (view, number % _SCANS)
        if key not in scans:
            scans[key] = scan(view, number, state)
        return scans[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LidarView, "scan", remembered)
        yield


@pytest.fixture(scope="module")
def large_mcap(_repeated_scans: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An MCAP that would take more memory than is allowed if it were held."""
    path: Path = tmp_path_factory.mktemp("large") / "drive"
    generate_mcap(path, size_bytes=_LARGE_BYTES)
    yield path
    path.unlink()


@pytest.fixture(scope="module")
def large_bag(_repeated_scans: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A bag of the same size."""
    path: Path = tmp_path_factory.mktemp("large") / "drive"
    generate_bag(path, size_bytes=_LARGE_BYTES)
    yield path
    path.unlink()


@pytest.fixture(autouse=True)
def _no_sync(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the disk, which takes most of the time of a thousand small files."""
    monkeypatch.setattr(os, "fsync", lambda _descriptor: None)
