"""Rows about the shipped action `preview`: time and memory for missions of 1 GB.

`python -m benchmarks.previews [FOLDER]` prints them alone; `make bench` prints them with all others.
"""

import statistics
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.check_missions import payload_mission
from benchmarks.measure import run_side
from kleinkram.recordings.sample import generate_rig

Row = dict[str, object]
_RUNS, _MOST_S, _MOST_MB = 3, 30, 1000
_MISSIONS: Mapping[str, Callable[[Path], object]] = {
    "legged robot: many small frames, dense lidars": partial(generate_rig, duration_s=270),
    "payload: twelve cameras of 1280 x 720, two lidars": partial(payload_mission, size_bytes=10**9),
}


def preview_rows(folder: Path) -> Iterator[Row]:
    """Measure each mission; `folder` contains them, and they are made if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, make in _MISSIONS.items():
        mission = folder / name.partition(":")[0].replace(" ", "-")
        if not mission.exists():
            make(mission)
        yield preview_row(name, mission)


def preview_row(name: str, mission: Path) -> Row:
    """Measure the previews of one mission."""
    runs = [
        run_side("make_preview", str(mission), environment={}, module="benchmarks.preview_sides") for _ in range(_RUNS)
    ]
    seconds = statistics.median(run.seconds for run in runs)
    peak_mb = max(run.peak_mb for run in runs)
    cpu_s = statistics.median(run.cpu_s for run in runs)
    facts = runs[0].facts
    return {
        "what": f"previews of a mission of {facts['size'] / 1e9:.2f} GB ({name}), with copying its files",
        "measured": f"{seconds:.1f} s, {peak_mb:.0f} MB of memory",
        "also": f"{cpu_s:.1f} s of CPU; {facts['previews']:.0f} previews",
        "bar": f"<= {_MOST_S} s, <= {_MOST_MB} MB",
        "met": seconds <= _MOST_S and peak_mb <= _MOST_MB,
        "seconds": seconds,
    }


def main() -> None:
    """Print the rows; the missions are in a folder that is named, or temporary."""
    with TemporaryDirectory(prefix="kleinkram-bench-") as temporary:
        folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(temporary)
        for row in preview_rows(folder):
            met = "yes" if row["met"] else "NO"
            sys.stdout.write(f"{row['what']}: {row['measured']}; {row['also']} ({row['bar']}: {met})\n")


if __name__ == "__main__":
    main()
