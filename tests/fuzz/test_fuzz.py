"""A short fuzzing run with fixed seeds; `make soak` runs the long one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def run(*arguments: str) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.fuzz", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr + done.stdout


def test_random_files_never_crash_the_readers() -> None:
    run("--cases", "200")


@pytest.mark.slow
def test_a_thousand_random_files_never_crash_the_readers() -> None:
    run("--cases", "1000", "--start", "5000")


@pytest.mark.soak
@pytest.mark.usefixtures("recordings_dir")
def test_twenty_minutes_of_random_files_never_crash_the_readers() -> None:
    run("--minutes", "20", "--start", "1000000", "--real")
