"""Rows about previews of recordings: what making one adds to the verification of 1 GB, and how large it is."""

import statistics
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.check_missions import payload_mission
from benchmarks.measure import run_side, take_turns
from kleinkram.recordings.previews import preview_max_bytes
from kleinkram.recordings.sample import generate_bag, generate_mcap

Row = dict[str, object]
_GB = 1_000_000_000
_ROUNDS, _MOST_RATIO = 3, 1.3
_SIDES = "benchmarks.recording_preview_sides"


def recording_preview_rows(folder: Path) -> Iterator[Row]:
    """Measure recordings of 1 GB; `folder` contains them, and they are made if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    drive, bag, payload = folder / "drive.mcap", folder / "drive.bag", folder / "payload.mcap"
    if not drive.exists():
        generate_mcap(drive, size_bytes=_GB, seed=2)
    if not bag.exists():
        generate_bag(bag, size_bytes=_GB, seed=2)
    if not payload.exists():
        _make_payload(payload)
    for path, name in ((drive, "vehicle, MCAP"), (bag, "vehicle, bag"), (payload, "three cameras and a lidar, MCAP")):
        yield recording_preview_row(path, name)


def recording_preview_row(path: Path, name: str) -> Row:
    """Measure the verification of a recording with and without its preview."""
    run_side("verify_with_preview", str(path), environment={}, module=_SIDES)  # the page cache, for all sides
    runs = take_turns(["verify", "verify_with_preview"], str(path), module=_SIDES, rounds=_ROUNDS)
    alone, both = runs["verify"], runs["verify_with_preview"]
    alone_s, both_s = (statistics.median(run.seconds for run in side) for side in (alone, both))
    alone_cpu_s, both_cpu_s = (statistics.median(run.cpu_s for run in side) for side in (alone, both))
    size_bytes, facts = path.stat().st_size, both[0].facts
    ratio, limit = both_s / alone_s, preview_max_bytes(size_bytes)
    return {
        "what": f"previews of a recording of {size_bytes / _GB:.2f} GB ({name}), made while it is verified",
        "measured": f"{ratio:.2f}x of the time of verifying alone ({both_s:.1f} s, {alone_s:.1f} s)",
        "also": f"{both_cpu_s:.1f} s of CPU instead of {alone_cpu_s:.1f} s, with the store's; "
        f"{facts['preview_bytes'] / 1e6:.2f} MB of at most {limit / 1e6:.1f} MB; "
        f"{facts['fields']:.0f} fields, {facts['thumbnails']:.0f} thumbnails",
        "bar": f"<= {_MOST_RATIO}x",
        "met": ratio <= _MOST_RATIO and facts["preview_bytes"] <= limit,
        "ratio": ratio,
    }


def _make_payload(path: Path) -> None:
    """Write the recording of one computer of a mission with pictures and clouds of real sizes."""
    with TemporaryDirectory(dir=path.parent) as temporary:
        mission = Path(temporary) / "mission"
        payload_mission(mission, size_bytes=_GB)
        (mission / "computer0.mcap").rename(path)
