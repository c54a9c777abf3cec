"""Files that are no recordings of messages -> what they are, and the facts that are cheap to have."""

from __future__ import annotations

from collections.abc import Callable

from kleinkram.recordings.formats.documents import describe_json, describe_yaml
from kleinkram.recordings.formats.trajectories import describe_table, describe_trajectory
from kleinkram.recordings.formats.ulog import describe_ulog
from kleinkram.recordings.model import Content, RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import Forward

MAX_DESCRIBED_BYTES = 64 * 2**20
"""Bytes of a file that are read for its facts, unless every byte of it is asked for."""

_NOT_READ = {
    RecordingFormat.rosbag1_old: "a ROS bag 1.x: convert it with 'rosbag migrate'",
    RecordingFormat.rosbag2_metadata: "the metadata of a rosbag2 recording, not a recording by itself",
    RecordingFormat.unknown: "not a recording that we know",
}
_DESCRIBE: dict[RecordingFormat, Callable[[Forward], RecordingSummary]] = {
    RecordingFormat.tum: lambda forward: describe_trajectory(RecordingFormat.tum, forward),
    RecordingFormat.kitti: lambda forward: describe_trajectory(RecordingFormat.kitti, forward),
    RecordingFormat.csv: describe_table,
    RecordingFormat.yaml: describe_yaml,
    RecordingFormat.json: describe_json,
    RecordingFormat.ulog: describe_ulog,
}
DESCRIBED = frozenset(_DESCRIBE)
"""Formats that are read for what they say."""

_LARGE = {
    RecordingFormat.tum: "a trajectory (TUM)",
    RecordingFormat.kitti: "a trajectory (KITTI)",
    RecordingFormat.csv: "a table (CSV)",
    RecordingFormat.yaml: "YAML",
    RecordingFormat.json: "JSON",
}


def describe(
    kind: RecordingFormat, forward: Forward, *, most_bytes: int | None = MAX_DESCRIBED_BYTES
) -> RecordingSummary:
    """Say what is in a file of a kind that is neither MCAP, bag nor rosbag2.

    It is read forward once, if it has at most `most_bytes` (None: of whatever size); else it is only recognised.
    `content` is `opaque`, except for a flight log, whose topics and times are read, and an empty file (`broken`).

    Raises:
        SourceError: as `Forward.read`.
    """
    if kind is RecordingFormat.empty:
        return RecordingSummary(kind, Content.broken, "the file has 0 bytes")
    if kind not in _DESCRIBE:
        return RecordingSummary(kind, Content.opaque, _NOT_READ[kind])
    if most_bytes is None or forward.size_bytes <= most_bytes:
        return _DESCRIBE[kind](forward)
    cost = f"it must be read whole ({forward.size_bytes} bytes) to say more"
    if kind is RecordingFormat.ulog:
        return RecordingSummary(kind, Content.pending, f"a flight log (ULog) has no index: {cost}")
    return RecordingSummary(kind, Content.opaque, f"{_LARGE[kind]}, not a recording; {cost}")
