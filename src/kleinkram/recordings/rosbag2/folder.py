"""The summaries of data files and what metadata.yaml says -> one summary of a rosbag2 recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from kleinkram.recordings.assemble import bounded
from kleinkram.recordings.combining import combine
from kleinkram.recordings.model import (
    Content,
    Lost,
    Problem,
    RecordingFormat,
    RecordingSummary,
    TopicSummary,
    counted,
)
from kleinkram.recordings.rosbag2.comparing import (
    METADATA_NAME,
    MemberFacts,
    TopicFacts,
    compare_metadata,
    lost_messages,
)
from kleinkram.recordings.rosbag2.metadata import Rosbag2Metadata

MESSAGE_ZSTD = "message-zstd"
"""What `compression` says where the data of each message is compressed by itself."""

_FORMATS = {"sqlite3": RecordingFormat.rosbag2_db3, "mcap": RecordingFormat.mcap}


def combine_folder(
    metadata: Rosbag2Metadata | None, names: Sequence[str], summaries: Sequence[RecordingSummary]
) -> RecordingSummary:
    """Merge the data files of a rosbag2 folder, given in the order of recording, and compare with its metadata.yaml.

    `metadata` is None where it could not be understood. `names` are those of the files, without folder. Where files
    are missing, or a damaged one holds fewer messages than the metadata says, that is the recording's loss.
    """
    if metadata is None:
        problem = Problem("metadata-damaged", METADATA_NAME, "it is not the metadata of a rosbag2 recording")
        summary = combine(summaries, names)
        return replace(summary, problems=bounded([problem, *summary.problems]))
    members = [_facts(name, summary) for name, summary in zip(names, summaries, strict=True)]
    if not summaries:
        return _without_data(metadata)
    summary = combine(summaries, names)
    problems = compare_metadata(metadata, members, [_topic_facts(topic) for topic in summary.topics])
    summary = _with_compression(metadata, summary)
    summary = _with_loss(metadata, members, summary, problems)
    return replace(summary, problems=bounded([*problems, *summary.problems]))


def _facts(name: str, summary: RecordingSummary) -> MemberFacts:
    return MemberFacts(name, summary.message_count, summary.start_ns, summary.end_ns, summary.format)


def _topic_facts(topic: TopicSummary) -> TopicFacts:
    return TopicFacts(topic.name, topic.message_type, topic.message_encoding, topic.count)


def _without_data(metadata: Rosbag2Metadata) -> RecordingSummary:
    count = len(metadata.files)
    what = "a data file" if count == 1 else f"{count} data files"
    claimed = f" with {counted(metadata.message_count, 'message')}" if metadata.message_count is not None else ""
    return RecordingSummary(
        format=_FORMATS.get(metadata.storage or "", RecordingFormat.rosbag2_metadata),
        content=Content.broken,
        reason=f"metadata.yaml names {what}{claimed}, but none is there",
        problems=bounded(compare_metadata(metadata, ())),
        lost=Lost(0, 0, metadata.message_count),
    )


def _with_compression(metadata: Rosbag2Metadata, summary: RecordingSummary) -> RecordingSummary:
    if metadata.compression_mode != "message":
        return summary
    name = f"message-{metadata.compression}" if metadata.compression else MESSAGE_ZSTD
    return replace(summary, compression=tuple(sorted({name, *summary.compression} - {"none"})))


def _with_loss(
    metadata: Rosbag2Metadata, members: Sequence[MemberFacts], summary: RecordingSummary, problems: Sequence[Problem]
) -> RecordingSummary:
    missing = [problem.where for problem in problems if problem.code == "member-missing"]
    if summary.content not in (Content.indexed, Content.recovered, Content.broken):
        return summary
    if not missing and summary.content is Content.indexed:
        return summary
    reasons = [summary.reason] if summary.reason else []
    if missing:
        reasons.append(f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing")
    lost = summary.lost or Lost(0, 0, None)
    messages = lost_messages(metadata, members)
    if messages is not None and summary.message_count is not None:
        reasons.append(f"{summary.message_count} of {counted(metadata.message_count or 0, 'message')} can be read")
    return replace(
        summary,
        content=Content.recovered if summary.content is Content.indexed else summary.content,
        reason="; ".join(reasons),
        lost=replace(lost, messages=messages if messages is not None else lost.messages),
    )
