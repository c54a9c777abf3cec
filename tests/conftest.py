"""Fixtures that every kind of test shares."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadFileScheduling

from tests import slurm_cluster
from tests.requirements import missing, need
from tests.slurm_cluster import SlurmCluster
from tests.template_instance import share_template

MakeCase = Callable[[str], Path]

RECORDINGS = Path(os.environ.get("KLEINKRAM_RECORDINGS") or Path(__file__).parents[2] / "shared" / "recordings")

# Scripts that make small inputs which once failed, one folder each.
CASES = RECORDINGS.parent / "cases"

# Files that need a browser, the longest first. They run one after the other in two groups: on two cores, four browsers
# and their servers at once make each other time out.
_BROWSERS = "system/web/"
_BROWSER_GROUPS = 2
_BROWSER_FILES = (
    "test_every_page.py",
    "test_contents.py",
    "test_mission_viewer.py",
    "test_events.py",
    "test_people.py",
    "test_upload.py",
    "test_layouts.py",
    "test_runs.py",
    "test_previews.py",
    "test_library.py",
    "test_scene.py",
    "test_checks.py",
    "test_account.py",
    "test_viewer_panels.py",
    "test_missions.py",
    "test_viewer.py",
    "test_search.py",
    "test_missions_changed.py",
    "test_unsaved_input.py",
    "test_metrics.py",
    "test_isolation.py",
    "test_every_page_pictures.py",
)
# The longest of the others start first. Those that use the CPU alternate with those that mostly wait, for rates,
# timeouts or leases.
_LONGEST = (
    "system/test_bad_link.py",
    "integration/access/test_matrix.py",
    "system/test_store_trouble.py",
    "acceptance/test_slam.py",
    "integration/runner/test_executors.py",
    "integration/backup/test_keeping.py",
    "system/test_kills.py",
    "integration/backup/test_drill.py",
    "integration/runner_loop/test_slurm.py",
    "system/test_lying_store.py",
    "integration/library/test_lidar_odometry.py",
    "integration/runner_loop/test_faults.py",
    "system/test_backup.py",
    "acceptance/test_workflows.py",
    "integration/uploads/test_state_machine.py",
    "system/test_clocks.py",
    "integration/access/test_visibility.py",
    "integration/server/test_traces.py",
    "integration/standalone/test_lifecycle.py",
    "integration/access/test_api_description.py",
)

# A shell that runs the tests in the background ignores these signals, and child processes would inherit that.
for _sign in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(_sign) is signal.SIG_IGN:
        signal.signal(_sign, signal.default_int_handler if _sign is signal.SIGINT else signal.SIG_DFL)

# The width of the terminal must not change what commands print.
os.environ.pop("COLUMNS", None)

# Examples are the same in every run, except in `make soak`. Their time depends on the machine and its load.
settings.register_profile("fixed", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("soak", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fixed"))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Return the scheduler of `--dist loadfile`: a worker runs the tests of a group, not only of a file, in turn."""
    scheduling = LoadFileScheduling(config, log)
    scheduling._split_scope = _group
    return scheduling


def _group(nodeid: str) -> str:
    name = _file_name(nodeid)
    return f"browsers {_browser_order(name) % _BROWSER_GROUPS}" if _needs_browser(name) else name


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long rounds have no timeout: a history that is cut off in the middle looks like a flaky test."""
    # Workers take groups in this order; the long ones come first, so that no worker has one left at the end.
    items.sort(key=_start_order)
    for item in items:
        if item.get_closest_marker("soak") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(0))


def _file_name(nodeid: str) -> str:
    return nodeid.partition("::")[0].removeprefix("tests/")


def _needs_browser(name: str) -> bool:
    return name.startswith(_BROWSERS)


def _browser_order(name: str) -> int:
    place = name.removeprefix(_BROWSERS)
    return _BROWSER_FILES.index(place) if place in _BROWSER_FILES else len(_BROWSER_FILES)


def _start_order(item: pytest.Item) -> tuple[int, int]:
    name = _file_name(item.nodeid)
    if _needs_browser(name):
        return 0, _browser_order(name)
    if name in _LONGEST:
        return 1, _LONGEST.index(name)
    return 2, not name.startswith("system/")


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    """Import the tests without garbage collection, as the server does with its modules."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Collect garbage again from here on, but not what importing all tests has allocated."""
    gc.freeze()
    gc.set_threshold(10_000)
    gc.enable()


@pytest.fixture(scope="session")
def slurm() -> Iterator[SlurmCluster]:
    """A Slurm cluster of one node."""
    if os.geteuid() != 0:
        missing("a Slurm of the tests' own needs root")
    need(*slurm_cluster.PROGRAMS)
    with slurm_cluster.slurm_cluster() as made:
        yield made


@pytest.fixture(scope="session", autouse=True)
def _run_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Let instances share a template in the folder of this test run. A worker's own folder is below it."""
    folder = tmp_path_factory.getbasetemp()
    share_template(folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder)


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
