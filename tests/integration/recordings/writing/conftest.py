"""Fixtures of the tests of written files."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.recordings.sample import generate_bag, generate_mcap

_LARGE_BYTES = 150_000_000


@pytest.fixture(scope="module")
def large_mcap(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An MCAP that would take more memory than is allowed if it were held."""
    path: Path = tmp_path_factory.mktemp("large") / "drive"
    generate_mcap(path, size_bytes=_LARGE_BYTES)
    yield path
    path.unlink()


@pytest.fixture(scope="module")
def large_bag(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A bag of the same size."""
    path: Path = tmp_path_factory.mktemp("large") / "drive"
    generate_bag(path, size_bytes=_LARGE_BYTES)
    yield path
    path.unlink()


@pytest.fixture(autouse=True)
def _no_sync(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the disk, which takes most of the time of a thousand small files."""
    monkeypatch.setattr(os, "fsync", lambda _descriptor: None)
