"""Rows about reading recordings: ours and the fastest public reader on one 1 GB file, each run a process of its own.

`python -m benchmarks.recordings` prints these rows alone; `make bench` prints them with all others.
"""

import statistics
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measure import Run, pair, run_side
from benchmarks.readings import raw_row, remote_row
from benchmarks.scans import scan_bag_row, scan_mcap_row, synthetic_row
from kleinkram.recordings.sample import generate_mcap

Row = dict[str, object]
_RUNS = 3
_IMU = "/imu/data"


def recording_rows(folder: Path) -> list[Row]:
    """Measure all rows; `folder` holds the files, which are made where they are missing."""
    path = folder / "large.mcap"
    if not path.exists():
        generate_mcap(path, size_bytes=1_000_000_000, seed=1)
    return [row(path) for row in ROWS]


def decode_row(path: Path) -> Row:
    """All messages of an MCAP to values."""
    pairing = pair(lambda: side("decode_ours", path), lambda: side("decode_small_mcap", path), pairs=_RUNS)
    ours = pairing.median(lambda run: run.seconds)
    theirs = statistics.median(run.seconds for run in pairing.raw)
    same = {run.facts["messages"] for run in (*pairing.ours, *pairing.raw)}
    return {
        "what": "all messages of a 1 GB MCAP decoded",
        "measured": f"{pairing.ratio:.2f}x of small-mcap with mcap-ros2-support-fast ({ours:.2f} s, {theirs:.2f} s)",
        "also": f"{pairing.median(lambda run: run.peak_mb):.0f} MB (bar 200)",
        "bar": ">= 1.0x",
        "met": pairing.ratio >= 1 and len(same) == 1 and pairing.median(lambda run: run.peak_mb) <= 200,
        "ratio": pairing.ratio,
    }


def arrow_row(path: Path) -> Row:
    """An IMU topic to an Arrow table: all fields, from the file."""
    runs = [side("arrow_ours", path, _IMU) for _ in range(_RUNS)]
    rate = statistics.median(run.facts["messages"] / run.seconds for run in runs)
    alone = statistics.median(run.facts["table_messages_per_s"] for run in runs)
    return {
        "what": "the IMU topic of a 1 GB MCAP to Arrow",
        "measured": f"{alone:.0f} messages/s, {rate:.0f} with reading the file",
        "bar": ">= 300000 messages/s",
        "met": alone >= 300_000,
        "messages_per_s": alone,
    }


def side(name: str, *arguments: str | Path) -> Run:
    """Run one side on a recording."""
    return run_side(name, *map(str, arguments), environment={}, module="benchmarks.recording_sides")


ROWS: tuple[Callable[[Path], Row], ...] = (
    scan_mcap_row,
    scan_bag_row,
    synthetic_row,
    decode_row,
    arrow_row,
    raw_row,
    remote_row,
)


def main() -> None:
    """Print the rows."""
    with TemporaryDirectory() as folder:
        for row in recording_rows(Path(folder)):
            sys.stdout.write(f"{row['what']}: {row['measured']} (bar {row['bar']})\n")


if __name__ == "__main__":
    main()
