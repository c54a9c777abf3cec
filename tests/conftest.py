"""Fixtures that every kind of test shares."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

RECORDINGS = Path(os.environ.get("KLEINKRAM_RECORDINGS") or Path(__file__).parents[2] / "shared" / "recordings")


@pytest.fixture(scope="session")
def recordings_dir() -> Path:
    """The folder of real recordings, with manifest.json; tests that need it are skipped where it is missing."""
    if not (RECORDINGS / "manifest.json").is_file():
        message = f"no recordings at {RECORDINGS}: set KLEINKRAM_RECORDINGS"
        if os.environ.get("KLEINKRAM_REQUIRE_ALL") == "1":
            pytest.fail(message)
        pytest.skip(message)
    return RECORDINGS
