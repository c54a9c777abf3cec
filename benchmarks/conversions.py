"""Rows about conversion: bags and MCAPs, with and without re-encoding, by us and by public readers and writers."""

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
    return _row("a 1 GB bag converted to MCAP (zstd)", bag, ("convert_ours", "convert_rosbags"), "rosbags with mcap")


def reencode_bag_row(path: Path) -> dict[str, object]:
    """A bag to MCAP, with ROS 1 messages re-encoded as CDR; `path`: as above."""
    bag = path.with_suffix(".bag")
    if not bag.exists():
        generate_bag(bag, size_bytes=_BAG_BYTES, seed=2)
    sides = "reencode_ours", "reencode_rosbags"
    return _row("a 1 GB bag converted to MCAP for ROS 2 (zstd)", bag, sides, "rosbags with mcap")


def bag_of_mcap_row(path: Path) -> dict[str, object]:
    """An MCAP of ROS 2 to a bag."""
    return _row("a 1 GB MCAP converted to a bag (lz4)", path, ("bag_ours", "bag_rosbags"), "mcap with rosbags")


def recompress_row(path: Path) -> dict[str, object]:
    """An MCAP written anew."""
    return _row("a 1 GB MCAP written anew (zstd)", path, ("convert_ours", "convert_mcap"), "mcap")


def _row(what: str, source: Path, sides: tuple[str, str], name: str) -> dict[str, object]:
    target = source.with_name("converted")

    def run(one: str) -> Run:
        target.unlink(missing_ok=True)
        return run_side(one, str(source), str(target), environment={}, module=_SIDES)

    pairing = pair(lambda: run(sides[0]), lambda: run(sides[1]), pairs=min(PAIRS, 3))
    target.unlink(missing_ok=True)
    if len({one.facts["messages"] for one in (*pairing.ours, *pairing.raw)}) != 1:
        raise SystemExit(f"the sides wrote different numbers of messages of {source.name}")
    seconds, peak_mb = pairing.median(lambda one: one.seconds), max(one.peak_mb for one in pairing.ours)
    theirs = statistics.median(one.seconds for one in pairing.raw)
    return {
        "what": what,
        "measured": f"{seconds:.2f} s, {pairing.ratio:.2f}x of {name} ({theirs:.2f} s)",
        "also": f"{peak_mb:.0f} MB (bar {_MOST_MB})",
        "bar": f">= 1.0x, <= {_MOST_MB} MB",
        "met": pairing.ratio >= 1 and peak_mb <= _MOST_MB,
        "ratio": pairing.ratio,
        "peak_mb": peak_mb,
    }
