"""Rows about reading messages as bytes: all of a file, and a span of one topic over a network."""

from pathlib import Path

from benchmarks.index_bytes import needed_bytes
from benchmarks.measure import Run, pair, run_side
from kleinkram.recordings import Recording

_MB = 10**6
_MOST_MB = 200
_IMU = "/imu/data"
_SPAN_S = 8
"""Seconds of the sample that its chunks hold in a little less than 50 MB."""

_LONG_SPAN_S = 20
_MORE_MB = 0.5
"""Bytes between chunks that are fetched together, and at both ends to find the index."""


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
    """Read one topic of a time span of a large file over HTTP ranges: a span of nearly 50 MB, and one of 20 s."""
    spans = [_remote_span(path, seconds) for seconds in (_SPAN_S, _LONG_SPAN_S)]
    (run, needed_mb), (longer, longer_needed_mb) = spans
    peak_mb = max(span.peak_mb for span, _ in spans)
    fetched_mb, longer_fetched_mb = (span.facts["bytes"] / _MB for span, _ in spans)
    return {
        "what": f"one topic of {_SPAN_S} s out of a 1 GB MCAP over HTTP, opening included",
        "measured": (
            f"{run.seconds:.2f} s; {fetched_mb:.1f} MB fetched, where the chunks that hold it and the index "
            f"have {needed_mb:.1f} MB"
        ),
        "also": (
            f"{_LONG_SPAN_S} s: {longer.seconds:.2f} s, {longer_fetched_mb:.1f} MB where these have "
            f"{longer_needed_mb:.1f} MB; {peak_mb:.0f} MB of memory with the server's (bar {_MOST_MB})"
        ),
        "bar": f"no more than these and {_MORE_MB} MB; <= 1 s where they are <= 50 MB",
        "met": (
            all(span.facts["bytes"] / _MB <= needed + _MORE_MB for span, needed in spans)
            and run.seconds <= 1
            and needed_mb <= 50
            and peak_mb <= _MOST_MB
        ),
        "seconds": [span.seconds for span, _ in spans],
        "bytes": [span.facts["bytes"] for span, _ in spans],
    }


def _remote_span(path: Path, seconds: int) -> tuple[Run, float]:
    """Return the cost of reading a span in the middle of a file, and the minimum number of MB."""
    with Recording.open(path) as recording:
        start_ns = ((recording.start_ns or 0) + (recording.end_ns or 0)) // 2
    end_ns = start_ns + seconds * 10**9
    needed = needed_bytes(path, _IMU, start_ns, end_ns)
    return _side("remote_span", path, _IMU, str(start_ns), str(end_ns)), needed / _MB


def _side(name: str, *arguments: str | Path) -> Run:
    return run_side(name, *map(str, arguments), environment={}, module="benchmarks.reading_sides")
