"""Rows about reading messages as bytes: all of a file, and a span of one topic over a network."""

from pathlib import Path

from benchmarks.measure import Run, pair, run_side

_MB = 10**6
_MOST_MB = 200
_SPAN_S = "8"
"""Seconds of the sample that its chunks hold in a little less than 50 MB."""

_LONG_SPAN_S = "20"


def raw_row(path: Path) -> dict[str, object]:
    """All messages of an MCAP as bytes, in the order of log time."""
    pairing = pair(lambda: _side("raw_ours", path), lambda: _side("raw_small_mcap", path), pairs=3)
    peak_mb = pairing.median(lambda run: run.peak_mb)
    same = {run.facts["bytes"] for run in (*pairing.ours, *pairing.raw)}
    return {
        "what": "all messages of a 1 GB MCAP as bytes",
        "measured": f"{pairing.ratio:.2f}x of small-mcap, which checks no CRC",
        "also": f"{peak_mb:.0f} MB (bar {_MOST_MB})",
        "bar": ">= 1.0x",
        "met": pairing.ratio >= 1 and len(same) == 1 and peak_mb <= _MOST_MB,
        "ratio": pairing.ratio,
    }


def remote_row(path: Path) -> dict[str, object]:
    """One topic of a span out of a large file over HTTP ranges."""
    run = _side("remote_span", path, "/imu/data", _SPAN_S)
    longer = _side("remote_span", path, "/imu/data", _LONG_SPAN_S)
    fetched_mb = run.facts["bytes"] / _MB
    peak_mb = max(run.peak_mb, longer.peak_mb)
    return {
        "what": f"one topic of {_SPAN_S} s out of a 1 GB MCAP over HTTP, opening included",
        "measured": f"{run.seconds:.2f} s, {fetched_mb:.0f} MB fetched",
        "also": (
            f"{_LONG_SPAN_S} s: {longer.seconds:.2f} s, {longer.facts['bytes'] / _MB:.0f} MB fetched; "
            f"{peak_mb:.0f} MB of memory with the server's (bar {_MOST_MB})"
        ),
        "bar": "<= 1 s for <= 50 MB",
        "met": run.seconds <= 1 and fetched_mb <= 50 and peak_mb <= _MOST_MB,
        "seconds": run.seconds,
    }


def _side(name: str, *arguments: str | Path) -> Run:
    return run_side(name, *map(str, arguments), environment={}, module="benchmarks.reading_sides")
