"""Many processes share one cache of inputs, and may be killed at any moment."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.runner_loop import cache_workers


def use_and_kill(folder: Path, seed: int, seconds: float) -> dict[str, int]:
    """Return what was seen, without problems."""
    command = [sys.executable, "-m", cache_workers.__name__, str(seed), str(seconds), str(folder)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    seen: dict[str, int] = json.loads(done.stdout)
    assert not seen.pop("problems"), f"seed {seed}: {done.stdout}"
    return seen


def test_processes_that_are_killed_leave_no_wrong_file_no_lock_and_no_rest(tmp_path: Path) -> None:
    seen = use_and_kill(tmp_path, seed=28, seconds=3)
    assert min(seen.values()) > 0


@pytest.mark.soak
def test_processes_that_are_killed_for_minutes_leave_no_wrong_file_no_lock_and_no_rest(tmp_path: Path) -> None:
    use_and_kill(tmp_path, seed=random.SystemRandom().randrange(2**32), seconds=180)
