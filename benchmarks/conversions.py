"""Rows about writing MCAP: a bag converted, and an MCAP compressed anew, by us and by public readers and writers."""

import statistics
from pathlib import Path

from benchmarks.measure import Run, run_side
from kleinkram.recordings.sample import generate_bag

_SIDES = "benchmarks.conversion_sides"
_ROUNDS = 3
_MOST_MB = 200
_BAG_BYTES = 1_000_000_000


def convert_bag_row(path: Path) -> dict[str, object]:
    """A bag to MCAP; `path`: an MCAP, beside which the bag is."""
    bag = path.with_suffix(".bag")
    if not bag.exists():
        generate_bag(bag, size_bytes=_BAG_BYTES, seed=2)
    pairs = {"convert_rosbags": "rosbags with mcap", "convert_rosbags_small": "rosbags with small-mcap"}
    return _row("a 1 GB bag converted to MCAP (zstd)", bag, pairs)


def recompress_row(path: Path) -> dict[str, object]:
    """An MCAP written anew."""
    pairs = {"convert_mcap": "mcap", "convert_small_mcap": "small-mcap"}
    return _row("a 1 GB MCAP written anew (zstd)", path, pairs)


def _row(what: str, source: Path, pairs: dict[str, str]) -> dict[str, object]:
    target = source.with_name("converted.mcap")
    runs = in_turn(target, _SIDES, ["convert_ours", *pairs], str(source), str(target))
    if len({run.facts["messages"] for side in runs.values() for run in side}) != 1:
        raise SystemExit(f"the sides wrote different numbers of messages of {source.name}")
    return compared(what, runs, "convert_ours", pairs)


def in_turn(target: Path, module: str, names: list[str], *arguments: str) -> dict[str, list[Run]]:
    """Run sides that write a file, each three times, one after the other; the file is removed after each."""
    runs: dict[str, list[Run]] = {name: [] for name in names}
    target.unlink(missing_ok=True)
    for number in range(_ROUNDS):
        for name in names[number % len(names) :] + names[: number % len(names)]:
            runs[name].append(run_side(name, *arguments, environment={}, module=module))
            target.unlink()
    return runs


def compared(what: str, runs: dict[str, list[Run]], ours: str, pairs: dict[str, str]) -> dict[str, object]:
    """Return a row that compares our side with the fastest of the public pairs, by their names."""
    seconds = {name: statistics.median(run.seconds for run in side) for name, side in runs.items()}
    fastest = min(pairs, key=seconds.__getitem__)
    ratio, peak_mb = seconds[fastest] / seconds[ours], max(run.peak_mb for run in runs[ours])
    timings = ", ".join(f"{name} {seconds[side]:.2f} s" for side, name in pairs.items())
    return {
        "what": what,
        "measured": f"{seconds[ours]:.2f} s, {ratio:.2f}x of the fastest public pair ({pairs[fastest]})",
        "also": f"{timings}; {peak_mb:.0f} MB (bar {_MOST_MB})",
        "bar": ">= 1.0x",
        "met": ratio >= 1 and peak_mb <= _MOST_MB,
        "ratio": ratio,
        "peak_mb": peak_mb,
        "seconds": seconds,
    }
