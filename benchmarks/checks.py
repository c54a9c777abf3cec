"""Rows about checks: the content of a mission of 1 GB, the indexes of one of 50 GB, and many missions again.

`python -m benchmarks.checks` prints these rows alone; `make bench` prints them with all others.
"""

import statistics
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.check_missions import index_only_mission, payload_mission
from benchmarks.measure import Run, run_side

Row = dict[str, object]
_SIDES = "benchmarks.check_sides"
_GB, _MB = 10**9, 10**6
_RUNS, _MOST_MB, _MISSIONS, _TOPICS = 3, 250, 1000, 40


def check_rows(folder: Path) -> list[Row]:
    """Measure all rows; `folder` contains the missions, which are created if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    return [content_row(folder / "payload"), index_row(folder / "indexes"), reevaluation_row()]


def content_row(folder: Path) -> Row:
    """Check a mission of 1 GB (four computers, twelve cameras of 1280 x 720, two lidars, five IMUs) by content."""
    if not folder.exists():
        payload_mission(folder, _GB)
    runs = _runs("check_content", str(folder))
    seconds = statistics.median(run.seconds for run in runs)
    peak_mb = max(run.peak_mb for run in runs)
    share = max(run.facts["read"] / run.facts["size"] for run in runs)
    good = runs[0].facts["good"]
    failed = max(run.facts["bad"] + run.facts["not_made"] for run in runs)
    cpu_s = statistics.median(run.cpu_s for run in runs)
    return {
        "what": "content checks of a mission of 1 GB, index included, warm cache",
        "measured": f"{seconds:.1f} s, {share:.1%} of the bytes read",
        "also": (
            f"{cpu_s:.1f} s of CPU with reading all files before; {peak_mb:.0f} MB of memory (bar {_MOST_MB}); "
            f"{good:.0f} checks pass, {failed:.0f} not"
        ),
        "bar": "<= 10 s, <= 5 %, no false alarm",
        "met": seconds <= 10 and share <= 0.05 and peak_mb <= _MOST_MB and failed == 0,
        "seconds": seconds,
    }


def index_row(folder: Path) -> Row:
    """Check a folder of 50 GB by its indexes; its chunks are holes in sparse files, its indexes are true."""
    if not folder.exists():
        index_only_mission(folder, 50 * _GB)
    runs = _runs("check_indexes", str(folder))
    seconds = statistics.median(run.seconds for run in runs)
    run = runs[0]
    return {
        "what": "index checks of a folder of 50 GB (synthetic: sparse MCAPs with true indexes)",
        "measured": f"{seconds:.1f} s, {run.facts['read'] / _MB:.0f} MB read",
        "also": f"{run.cpu_s:.1f} s of CPU; {max(item.peak_mb for item in runs):.0f} MB of memory",
        "bar": "<= 10 s",
        "met": seconds <= 10 and run.facts["bad"] == 0,
        "seconds": seconds,
    }


def reevaluation_row() -> Row:
    """Evaluate the index checks of all missions of a project again, without database."""
    runs = _runs("reevaluate", str(_MISSIONS), str(_TOPICS))
    seconds = statistics.median(run.seconds for run in runs)
    return {
        "what": f"index checks of {_MISSIONS} missions x {_TOPICS} topics again, without database",
        "measured": f"{seconds:.1f} s for {runs[0].facts['rows']:.0f} checks",
        "also": f"{runs[0].cpu_s:.1f} s of CPU",
        "bar": "<= 5 s",
        "met": seconds <= 5,
        "seconds": seconds,
    }


def _runs(side: str, *arguments: str) -> list[Run]:
    return [run_side(side, *arguments, environment={}, module=_SIDES) for _ in range(_RUNS)]


def main() -> None:
    """Print the rows; the missions are in a folder that is named, or temporary."""
    with TemporaryDirectory(prefix="kleinkram-bench-") as temporary:
        folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(temporary)
        for row in check_rows(folder):
            also = f"; {row['also']}" if "also" in row else ""
            sys.stdout.write(
                f"{row['what']}: {row['measured']}{also} ({row['bar']}: {'yes' if row['met'] else 'NO'})\n"
            )


if __name__ == "__main__":
    main()
