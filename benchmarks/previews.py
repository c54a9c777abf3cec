"""The row about the shipped action `preview`: time and memory for a mission of 1 GB.

`python -m benchmarks.previews [FOLDER]` prints it alone; `make bench` prints it with all others.
"""

import statistics
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measure import run_side
from kleinkram.recordings.sample import generate_rig

Row = dict[str, object]
_RUNS, _MOST_S, _MOST_MB = 3, 30, 1000
_DURATION_S = 200  # of the legged robot, with 5 MB/s


def preview_row(folder: Path) -> Row:
    """Preview a mission of 1 GB (four computers, twelve cameras, two lidars, six IMUs) in `folder`, made if missing."""
    if not folder.exists():
        generate_rig(folder, duration_s=_DURATION_S)
    runs = [
        run_side("make_preview", str(folder), environment={}, module="benchmarks.preview_sides") for _ in range(_RUNS)
    ]
    seconds = statistics.median(run.seconds for run in runs)
    peak_mb = max(run.peak_mb for run in runs)
    return {
        "what": f"previews of a mission of {runs[0].facts['size'] / 1e9:.2f} GB, with copying its files",
        "measured": f"{seconds:.1f} s, {peak_mb:.0f} MB of memory",
        "also": f"{statistics.median(run.cpu_s for run in runs):.1f} s of CPU, {runs[0].facts['previews']:.0f} previews",
        "bar": f"<= {_MOST_S} s, <= {_MOST_MB} MB",
        "met": seconds <= _MOST_S and peak_mb <= _MOST_MB,
        "seconds": seconds,
    }


def main() -> None:
    """Print the row; the mission is in a folder that is named, or temporary."""
    with TemporaryDirectory(prefix="kleinkram-bench-") as temporary:
        folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(temporary)
        row = preview_row(folder / "rig")
        sys.stdout.write(f"{row['what']}: {row['measured']}; {row['also']} ({row['bar']}: {row['met']})\n")


if __name__ == "__main__":
    main()
