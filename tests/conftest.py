"""Fixtures that every kind of test shares."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.requirements import missing

MakeCase = Callable[[str], Path]

RECORDINGS = Path(os.environ.get("KLEINKRAM_RECORDINGS") or Path(__file__).parents[2] / "shared" / "recordings")

# Makers of small inputs that once failed, one folder each, beside the recordings.
CASES = RECORDINGS.parent / "cases"

# Run in the background or under nohup, tests would hand on to what they start that these are ignored.
for _sign in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(_sign) is signal.SIG_IGN:
        signal.signal(_sign, signal.default_int_handler if _sign is signal.SIGINT else signal.SIG_DFL)

# How wide the terminal is that tests are started from is not what commands are asked to print for.
os.environ.pop("COLUMNS", None)

# How long an example takes is the machine's business, and that of others on it.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long rounds end when they end; cut off in the middle of a history, they would only seem to be flaky."""
    for item in items:
        if item.get_closest_marker("soak") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(0))


@pytest.fixture(scope="session")
def recordings_dir() -> Path:
    """The folder of real recordings, with manifest.json; tests that need it are skipped where it is missing."""
    if not (RECORDINGS / "manifest.json").is_file():
        missing(f"no recordings at {RECORDINGS}: set KLEINKRAM_RECORDINGS")
    return RECORDINGS


@pytest.fixture(scope="session")
def make_case(tmp_path_factory: pytest.TempPathFactory) -> MakeCase:
    """A function that runs the maker of a case, by its number as in "02A", and returns the folder with what it made."""
    made: dict[str, Path] = {}

    def make(number: str) -> Path:
        if number not in made:
            made[number] = run_case(number, tmp_path_factory.mktemp(f"case-{number}"))
        return made[number]

    return make


def run_case(number: str, folder: Path) -> Path:
    """Run the maker of one case; what it makes is in the returned folder, and what it prints in `printed.txt` there."""
    maker = next(CASES.glob(f"{number}-*/make.py"), None)
    if maker is None:
        missing(f"no case {number} at {CASES}: set KLEINKRAM_RECORDINGS")
    made = subprocess.run(
        [sys.executable, maker, folder], check=True, cwd=folder, capture_output=True, text=True, timeout=60
    )
    (folder / "printed.txt").write_text(made.stdout)
    return folder
