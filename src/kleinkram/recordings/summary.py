"""`summarise`: any file -> what is in it. Whatever the bytes are, the answer is a summary and never an exception."""

from __future__ import annotations

from dataclasses import replace

from kleinkram.recordings.assemble import bounded
from kleinkram.recordings.bag.summary import summarise_bag
from kleinkram.recordings.mcap.summary import summarise_mcap
from kleinkram.recordings.model import Content, RecordingFormat, RecordingSummary
from kleinkram.recordings.sniffing import extension_lies, sniff, sniff_inside_zstd
from kleinkram.recordings.sources import CountingSource, Source

_RECORDINGS = frozenset((RecordingFormat.mcap, RecordingFormat.rosbag1, RecordingFormat.rosbag2_db3))
_NOT_READ = {
    RecordingFormat.rosbag1_old: "a ROS bag 1.x: convert it with 'rosbag migrate'",
    RecordingFormat.rosbag2_metadata: "the metadata of a rosbag2 recording, not a recording by itself",
    RecordingFormat.ulog: "a PX4 ULog, whose content is not read",
    RecordingFormat.tum: "a trajectory (TUM), not a recording",
    RecordingFormat.kitti: "a trajectory (KITTI), not a recording",
    RecordingFormat.yaml: "YAML, not a recording",
    RecordingFormat.csv: "a table (CSV), not a recording",
    RecordingFormat.unknown: "not a recording that we know",
}


def summarise(source: Source) -> RecordingSummary:
    """Say what is in a file, by ranges: for an indexed MCAP or bag about its index bytes.

    `content` is `indexed` for a whole MCAP or ROS 1 bag; `broken` where the file itself is at fault, with the place
    in `reason`; `pending` for a recording that this version does not read (db3, compressed as a whole, without index
    and very large); `opaque` for anything else.

    Raises:
        SourceError: the bytes cannot be read.
    """
    counting = CountingSource(source)
    kind = sniff(counting)
    if kind is RecordingFormat.mcap:
        summary = summarise_mcap(counting)
    elif kind is RecordingFormat.rosbag1:
        summary = summarise_bag(counting)
    else:
        summary = _recognised(counting, kind)
    lie = extension_lies(source.name, kind)
    problems = bounded([lie, *summary.problems]) if lie else summary.problems
    return replace(summary, problems=problems, bytes_read=counting.bytes_read)


def _recognised(source: Source, kind: RecordingFormat) -> RecordingSummary:
    if kind is RecordingFormat.empty:
        return RecordingSummary(kind, Content.broken, "the file has 0 bytes")
    if kind is RecordingFormat.rosbag2_db3:
        return RecordingSummary(kind, Content.pending, "a rosbag2 database (db3), which has no index to read")
    if kind is RecordingFormat.zstd:
        inside = sniff_inside_zstd(source)
        content = Content.pending if inside in _RECORDINGS else Content.opaque
        return RecordingSummary(kind, content, f"compressed as a whole; inside is {inside.value}")
    return RecordingSummary(kind, Content.opaque, _NOT_READ[kind])
