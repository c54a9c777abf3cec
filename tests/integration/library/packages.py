"""Packages that shipped actions need and Kleinkram does not, in a folder that is made once a machine."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import platformdirs
import pytest

from kleinkram.client.actions import read_manifest
from kleinkram.library import slam_evaluate
from tests.requirements import missing

LIBRARY = Path(slam_evaluate.__file__).parent
SLAM_EVALUATE, LIDAR_ODOMETRY = LIBRARY / "slam_evaluate.py", LIBRARY / "lidar_odometry.py"
_TIMEOUT_S = 480
Test = TypeVar("Test", bound=Callable[..., None])


def slow_with_packages(test: Test) -> Test:
    """Mark a test that may fetch packages first."""
    marked: Test = pytest.mark.slow(pytest.mark.timeout(_TIMEOUT_S + 120)(test))
    return marked


def with_packages(monkeypatch: pytest.MonkeyPatch, script: Path) -> None:
    """Let scripts import the dependencies of one; skip the test, or fail it, where they cannot be fetched."""
    folder = _folder_with(sorted({*read_manifest(script).dependencies} - {"open-kleinkram"}))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([*filter(None, sys.path), str(folder)]))


def _folder_with(requirements: list[str]) -> Path:
    text = "\n".join([*requirements, sys.implementation.cache_tag, platform.machine()])
    mark = hashlib.sha256(text.encode()).hexdigest()[:16]
    folder = platformdirs.user_cache_path("kleinkram-tests") / f"packages-{mark}"
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f"{folder.name}-") as building:
            _install(requirements, Path(building) / "packages")
            with suppress(OSError):  # another process was first
                (Path(building) / "packages").rename(folder)
    return folder


def _install(requirements: list[str], folder: Path) -> None:
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:"]
    command = [*pip, "--target", str(folder), *requirements]
    try:
        subprocess.run(command, check=True, timeout=_TIMEOUT_S, capture_output=True, text=True)
    except subprocess.TimeoutExpired:
        missing(f"{' '.join(requirements)} cannot be fetched from the package index within {_TIMEOUT_S} s")
    except subprocess.CalledProcessError as error:
        missing(f"{' '.join(requirements)} cannot be fetched from the package index: {str(error.stderr)[-300:]}")
