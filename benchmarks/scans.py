"""Rows about scanning recordings, and about summaries of very large ones; all sides of a row run in turn."""

import os
import statistics
from pathlib import Path

from benchmarks.measure import run_side, take_turns
from kleinkram.recordings.sample import generate_bag

ROUNDS = int(os.environ.get("KLEINKRAM_BENCH_ROUNDS", "3"))
_SIDES = "benchmarks.scan_sides"
_MB = 1_000_000
_GB = 1_000_000_000

Row = dict[str, object]


def scan_mcap_row(path: Path) -> Row:
    """Every record and every CRC of an MCAP in zstd chunks.

    All sides check the CRCs of chunks, of the data section and of attachments; only ours that of the summary, too.
    """
    return _scan_row(path, ["scan_ours", "scan_mcap", "scan_small_mcap"], least_mb_s=250)


def scan_bag_row(path: Path) -> Row:
    """Every record of a bag in lz4 chunks, made beside `path`, and the checksums of its chunks.

    rosbags needs the index of the bag, and reads what it lists; ours compares the two.
    """
    bag = path.with_suffix(".bag")
    if not bag.exists():
        generate_bag(bag, size_bytes=_GB, seed=2)
    return _scan_row(bag, ["scan_ours", "scan_rosbags"], least_mb_s=0)


def synthetic_row(_path: Path) -> Row:
    """Summaries of 10 GB and 1 TB, of which only the index exists."""
    costs = []
    for size_bytes in (10 * _GB, 1000 * _GB):
        run = run_side("summary_synthetic", str(size_bytes), environment={}, module=_SIDES)
        costs.append((run.seconds, run.facts["bytes_read"] / _MB, run.facts["index_bytes"] / _MB, run.peak_mb))
    costs_text = (f"{s:.1f} s, {read:.1f} MB of {index:.1f} MB index, {peak:.0f} MB" for s, read, index, peak in costs)
    return {
        "what": "summary of a synthetic 10 GB MCAP; of 1 TB (read; memory)",
        "measured": "; ".join(costs_text),
        "bar": "<= index + 1 MB, <= 100 MB of memory",
        "met": all(read <= index + 1 and peak <= 100 for _seconds, read, index, peak in costs),
    }


def _scan_row(path: Path, names: list[str], *, least_mb_s: int) -> Row:
    runs = take_turns(names, str(path), module=_SIDES, rounds=ROUNDS)
    if len({run.facts["messages"] for side in runs.values() for run in side}) != 1:
        raise SystemExit(f"the sides found different numbers of messages in {path.name}")
    size_mb = path.stat().st_size / _MB
    speeds = {name: size_mb / statistics.median(run.seconds for run in side) for name, side in runs.items()}
    ours, peak = speeds["scan_ours"], max(run.peak_mb for run in runs["scan_ours"])
    cpu_s = {name: statistics.median(run.cpu_s for run in side) for name, side in runs.items()}
    fastest = max(names[1:], key=speeds.__getitem__)
    costs_text = ", ".join(f"{name} {seconds:.2f}" for name, seconds in cpu_s.items())
    least = f">= {least_mb_s} MB/s, " if least_mb_s else ""
    return {
        "what": f"scan of a {size_mb / 1000:.1f} GB {path.suffix[1:]} with all checksums",
        "measured": f"{ours:.0f} MB/s (fastest other: {fastest}, {speeds[fastest]:.0f} MB/s)",
        "also": f"each in one thread; CPU s: {costs_text}; {peak:.0f} MB (bar 200)",
        "bar": f"{least}>= the fastest public reader",
        "met": ours >= max(least_mb_s, speeds[fastest]) and peak <= 200,
        "mb_per_s": speeds,
        "cpu_s": cpu_s,
    }
