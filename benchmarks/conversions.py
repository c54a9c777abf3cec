"""Rows about writing MCAP: a bag converted, and an MCAP compressed anew, by us and by public readers and writers."""

import statistics
from pathlib import Path

from benchmarks.measure import PAIRS, Run, pair, run_side
from kleinkram.recordings.sample import generate_bag

_SIDES = "benchmarks.conversion_sides"
_MOST_MB = 200
_BAG_BYTES = 1_000_000_000


def convert_bag_row(path: Path) -> dict[str, object]:
    """A bag to MCAP; `path`: an MCAP, beside which the bag is."""
    bag = path.with_suffix(".bag")
    if not bag.exists():
        generate_bag(bag, size_bytes=_BAG_BYTES, seed=2)
    return _row("a 1 GB bag converted to MCAP (zstd)", bag, "convert_rosbags", "rosbags with mcap")


def recompress_row(path: Path) -> dict[str, object]:
    """An MCAP written anew."""
    return _row("a 1 GB MCAP written anew (zstd)", path, "convert_mcap", "mcap")


def _row(what: str, source: Path, side: str, name: str) -> dict[str, object]:
    def run(one: str) -> Run:
        target = source.with_name("converted.mcap")
        target.unlink(missing_ok=True)
        return run_side(one, str(source), str(target), environment={}, module=_SIDES)

    pairing = pair(lambda: run("convert_ours"), lambda: run(side), pairs=min(PAIRS, 3))
    source.with_name("converted.mcap").unlink(missing_ok=True)
    if len({one.facts["messages"] for one in (*pairing.ours, *pairing.raw)}) != 1:
        raise SystemExit(f"the sides wrote different numbers of messages of {source.name}")
    seconds, peak_mb = pairing.median(lambda one: one.seconds), max(one.peak_mb for one in pairing.ours)
    theirs = statistics.median(one.seconds for one in pairing.raw)
    return {
        "what": what,
        "measured": f"{seconds:.2f} s, {pairing.ratio:.2f}x of {name} ({theirs:.2f} s)",
        "also": f"{peak_mb:.0f} MB (bar {_MOST_MB})",
        "bar": f"<= {_MOST_MB} MB",
        "met": peak_mb <= _MOST_MB,
        "ratio": pairing.ratio,
        "peak_mb": peak_mb,
    }
