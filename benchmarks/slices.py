"""Rows about slices: cut over HTTP, cut locally by us and by public pairs, and cut out of a large mission."""

import json
import statistics
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import SeekingReader

from benchmarks.conversions import compared, in_turn
from benchmarks.index_bytes import needed_bytes
from benchmarks.measure import Run, run_side
from benchmarks.range_server import serving
from kleinkram.recordings import Recording

_SIDES = "benchmarks.slice_sides"
_PUBLIC = {"cut_mcap": "mcap", "cut_small_mcap": "small-mcap"}
_IMU, _SECONDS = "/imu/data", 20
_MOST_MB, _MB = 200, 10**6
_REMOTE_ROUNDS = 5
_LINK_BYTES_PER_S = 125_000_000
_MOST_BYTES, _MOST_TIME = 1.2, 1.3
_MISSION_BYTES = 50 * 10**9
_RECORDINGS = 20
_WINDOW_MB = 0.25
"""Bytes of each recording that are read to find its index, and attachments behind its last chunk."""


def cut_remote_row(path: Path) -> dict[str, object]:
    """One topic of 20 s out of an MCAP behind a link of 1 Gbit/s, which is emulated, against the store alone.

    The store alone: the same chunks, fetched by as many connections and thrown away. Without a limit, a server on the
    same machine answers from memory, which no store behind a network does; that figure is shown, too.
    """
    with serving(path, _LINK_BYTES_PER_S) as url:
        linked = _cut_in_turn(path, url)
    with serving(path) as url:
        unlimited = _cut_in_turn(path, url)
    also = (
        f"{linked.needed_bytes / _MB:.0f} MB; {linked.peak_mb:.0f} MB of memory (bar {_MOST_MB}); without the limit, "
        f"from memory over loopback, {unlimited.seconds:.2f} s, {unlimited.time_ratio:.1f}x"
    )
    return _remote_row("behind a link of 1 Gbit/s (emulated)", linked, also)


def cut_stored_row(path: Path, url: str) -> dict[str, object]:
    """The same out of an object of the store.

    The time has no bar: store and client alone keep both of two processors busy, so that decompression, which a store
    on another machine leaves time for, comes on top. That store is what `cut_remote_row` emulates.
    """
    cut = _cut_in_turn(path, url)
    also = f"{cut.needed_bytes / _MB:.0f} MB; {cut.peak_mb:.0f} MB of memory (bar {_MOST_MB})"
    return _remote_row("in SeaweedFS on the same processors", cut, also, most_time=None)


@dataclass(frozen=True)
class _RemoteCut:
    """Runs of our side and of the store alone, in turn."""

    ours: list[Run]
    alone: list[Run]
    needed_bytes: int

    @property
    def seconds(self) -> float:
        return statistics.median(run.seconds for run in self.ours)

    @property
    def time_ratio(self) -> float:
        return self.seconds / statistics.median(run.seconds for run in self.alone)

    @property
    def peak_mb(self) -> float:
        return max(run.peak_mb for run in self.ours)


def _cut_in_turn(path: Path, url: str) -> _RemoteCut:
    """Cut a file, and fetch the chunks needed alone; `path`: where the bytes behind the URL are."""
    start_ns, end_ns = _middle(path, _SECONDS)
    ranges = json.dumps(_chunk_ranges(path, _IMU, start_ns, end_ns))
    target = path.with_name("cut.mcap")
    cut = _RemoteCut([], [], needed_bytes(path, _IMU, start_ns, end_ns))
    for _ in range(_REMOTE_ROUNDS):
        target.unlink(missing_ok=True)
        arguments = str(path.stat().st_size), str(target), _IMU, str(start_ns), str(end_ns)
        cut.ours.append(_side("cut_remote", url, *arguments))
        cut.alone.append(_side("fetch_alone", url, ranges))
    target.unlink()
    return cut


def _remote_row(where: str, cut: _RemoteCut, also: str, most_time: float | None = _MOST_TIME) -> dict[str, object]:
    bytes_ratio = max(run.facts["bytes"] for run in cut.ours) / cut.needed_bytes
    is_fast = most_time is None or cut.time_ratio <= most_time
    time_bar = "no bar for the time" if most_time is None else f"<= {most_time}x of the time"
    return {
        "what": f"cut one topic of {_SECONDS} s out of a 1 GB MCAP {where}, opening included",
        "measured": (
            f"{bytes_ratio:.2f}x of the bytes of the chunks needed and the index; {cut.seconds:.2f} s, "
            f"{cut.time_ratio:.2f}x of plain requests for these chunks"
        ),
        "also": also,
        "bar": f"<= {_MOST_BYTES}x of the bytes, {time_bar}",
        "met": bytes_ratio <= _MOST_BYTES and is_fast and cut.peak_mb <= _MOST_MB,
        "bytes_ratio": bytes_ratio,
        "time_ratio": cut.time_ratio,
        "ours_s": [run.seconds for run in cut.ours],
        "alone_s": [run.seconds for run in cut.alone],
    }


def cut_local_row(path: Path) -> dict[str, object]:
    """The middle half of an MCAP with all topics, by us and by public readers and writers."""
    with Recording.open(path) as recording:
        first_ns, last_ns = recording.start_ns or 0, recording.end_ns or 0
    quarter = (last_ns - first_ns) // 4
    target = path.with_name("cut.mcap")
    arguments = str(path), str(target), str(first_ns + quarter), str(last_ns - quarter), "*"
    runs = in_turn(target, _SIDES, ["cut_ours", *_PUBLIC], *arguments)
    if len({run.facts["messages"] for side in runs.values() for run in side}) != 1:
        raise SystemExit(f"the sides cut different numbers of messages out of {path.name}")
    return compared("the middle half of a 1 GB MCAP cut, all topics (zstd)", runs, "cut_ours", _PUBLIC)


def cut_mission_row(path: Path) -> dict[str, object]:
    """A slice of a mission of 20 recordings and 50 GB, which are made as they are read."""
    target = path.with_name("cut.mcap")
    target.unlink(missing_ok=True)
    run = _side("cut_mission", str(target), str(_MISSION_BYTES // _RECORDINGS))
    target.unlink()
    facts = run.facts
    allowed = _MOST_BYTES * facts["needed_bytes"] + facts["index_bytes"] + _RECORDINGS * _WINDOW_MB * _MB
    return {
        "what": f"{_SECONDS} s of one topic out of {_RECORDINGS} recordings of {facts['total_bytes'] / 1e9:.0f} GB "
        "(synthetic), merged",
        "measured": (
            f"{facts['bytes'] / _MB:.0f} MB read: chunks needed {facts['needed_bytes'] / _MB:.0f} MB, "
            f"indexes {facts['index_bytes'] / _MB:.0f} MB"
        ),
        "also": f"{run.seconds:.1f} s; {run.peak_mb:.0f} MB of memory (bar {_MOST_MB})",
        "bar": f"indexes and {_MOST_BYTES}x of the chunks needed; <= {_MOST_MB} MB",
        "met": facts["bytes"] <= allowed and run.peak_mb <= _MOST_MB,
        "bytes": facts["bytes"],
        "peak_mb": run.peak_mb,
    }


def _middle(path: Path, seconds: int) -> tuple[int, int]:
    with Recording.open(path) as recording:
        start_ns = ((recording.start_ns or 0) + (recording.end_ns or 0)) // 2
    return start_ns, start_ns + seconds * 10**9


def _chunk_ranges(path: Path, topic: str, start_ns: int, end_ns: int) -> list[tuple[int, int]]:
    """Return start and length of the chunks that hold a topic in [start, end), adjacent ones joined to 4 MB."""
    with path.open("rb") as stream:
        summary = SeekingReader(stream).get_summary()
    if summary is None:
        raise ValueError(f"{path} has no summary")
    channels = {number for number, channel in summary.channels.items() if channel.topic == topic}
    ranges: list[tuple[int, int]] = []
    for chunk in sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset):
        is_inside = chunk.message_start_time < end_ns and chunk.message_end_time >= start_ns
        if not is_inside or not channels & chunk.message_index_offsets.keys():
            continue
        start, length = chunk.chunk_start_offset, chunk.chunk_length
        if ranges and start - sum(ranges[-1]) < 2**16 and start + length - ranges[-1][0] <= 4 * 2**20:
            ranges[-1] = ranges[-1][0], start + length - ranges[-1][0]
        else:
            ranges.append((start, length))
    return ranges


def _side(name: str, *arguments: str) -> Run:
    return run_side(name, *arguments, environment={}, module=_SIDES)
