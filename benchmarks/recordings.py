"""Rows about reading recordings: ours and the public readers' on one 1 GB file, each run a process of its own.

`python -m benchmarks.recordings` prints these rows alone; `make bench` prints them with all others.
"""

import statistics
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.arrows import arrow_row
from benchmarks.conversions import convert_bag_row, recompress_row
from benchmarks.measure import take_turns
from benchmarks.readings import raw_row, remote_row
from benchmarks.scans import scan_bag_row, scan_mcap_row, synthetic_row
from benchmarks.slices import cut_local_row, cut_mission_row, cut_remote_row
from kleinkram.recordings.sample import generate_mcap

Row = dict[str, object]
_SIDES = "benchmarks.recording_sides"
_DECODERS = {
    "decode_small_mcap": "small-mcap with mcap-ros2-support-fast",
    "decode_mcap": "mcap with mcap-ros2-support",
    "decode_rosbags": "rosbags",
}
_RUNS = 3
_MOST_MB = 200


def recording_rows(folder: Path) -> list[Row]:
    """Measure all rows; `folder` contains the files, which are created if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "large.mcap"
    if not path.exists():
        generate_mcap(path, size_bytes=1_000_000_000, seed=1)
    return [row(path) for row in ROWS]


def decode_row(path: Path) -> Row:
    """All messages of an MCAP to values, by every reader that does this."""
    runs = take_turns(["decode_ours", *_DECODERS], str(path), module=_SIDES, rounds=_RUNS)
    if len({run.facts["messages"] for side in runs.values() for run in side}) != 1:
        raise SystemExit(f"the sides decoded different numbers of messages of {path.name}")
    seconds = {name: statistics.median(run.seconds for run in side) for name, side in runs.items()}
    fastest = min(_DECODERS, key=seconds.__getitem__)
    ours = seconds["decode_ours"]
    ratio, peak_mb = seconds[fastest] / ours, max(run.peak_mb for run in runs["decode_ours"])
    timings = ", ".join(f"{name} {seconds[side]:.2f} s" for side, name in _DECODERS.items())
    return {
        "what": "all messages of a 1 GB MCAP decoded",
        "measured": f"{ours:.2f} s, {ratio:.2f}x of the fastest public reader ({_DECODERS[fastest]})",
        "also": f"{timings}; {peak_mb:.0f} MB (bar {_MOST_MB})",
        "bar": ">= 1.0x",
        "met": ratio >= 1 and peak_mb <= _MOST_MB,
        "ratio": ratio,
        "seconds": seconds,
    }


ROWS: tuple[Callable[[Path], Row], ...] = (
    scan_mcap_row,
    scan_bag_row,
    synthetic_row,
    decode_row,
    arrow_row,
    raw_row,
    remote_row,
    convert_bag_row,
    recompress_row,
    cut_remote_row,
    cut_local_row,
    cut_mission_row,
)


def main() -> None:
    """Print the rows."""
    with TemporaryDirectory() as folder:
        for row in recording_rows(Path(folder)):
            sys.stdout.write(f"{row['what']}: {row['measured']} (bar {row['bar']})\n")


if __name__ == "__main__":
    main()
