"""Combines the summaries of the files of one recording."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

from kleinkram.recordings import model
from kleinkram.recordings.file_summary import bounded, find_quality_warnings, with_times
from kleinkram.recordings.formats.rosbag2 import metadata as rosbag2
from kleinkram.recordings.formats.rosbag2.metadata import METADATA_NAME, Rosbag2Metadata
from kleinkram.recordings.model import Content, Problem, RecordingSummary, TopicSummary, counted
from kleinkram.recordings.timeline import MIN_JUMP_NS, StampSpan, join_spans, main_cluster, span_in_cluster

_WORST_FIRST = (
    Content.error,
    Content.pending,
    Content.broken,
    Content.opaque,
    Content.recovered,
    Content.indexed,
)
_READABLE = (Content.indexed, Content.recovered)
_MAX_FACTS = 100
_CLOCK_JUMP = "clock-jump"
_RECOMPUTED = frozenset(("silent-topic", "starts-late", "stops-early", "long-gap"))
"""Problems that a file may have only because it is one of several; searched again in all of them together."""


def combine(summaries: Sequence[RecordingSummary], names: Sequence[str] = ()) -> RecordingSummary:
    """Merge the summaries of the members of one recording, given in the order of recording.

    Counts are added; the sum is unknown if one of them is. Silences between members count as gaps. Where members
    overlap in time, the longest gap of a topic is an upper bound.

    `content` is `error` or `pending` if a member is; else `recovered` where something can be read and something not;
    else that of the members. `reason` is that of the worst, after its name, if there are `names`. `format` is that of
    the first member that can be read.
    """
    if not summaries:
        raise ValueError("a recording has at least one member")
    if len(summaries) == 1:
        return summaries[0]
    cluster = main_cluster(span for summary in summaries if (span := _span(summary)) is not None)
    by_name: dict[str, list[TopicSummary]] = defaultdict(list)
    for topic in (topic for summary in summaries for topic in summary.topics):
        by_name[topic.name].append(topic)
    topics = tuple(_combine_topic(by_name[name], cluster) for name in sorted(by_name))
    jumps = _jumps_between(summaries, names)
    first = next((summary for summary in summaries if summary.content in _READABLE), summaries[0])
    return RecordingSummary(
        format=first.format,
        content=_content({summary.content for summary in summaries}),
        reason=_reason(summaries, names),
        message_count=_total(
            # Nothing of a broken file can be read: its unknown count is 0.
            summary.message_count or 0 if summary.content in (Content.broken, Content.opaque) else summary.message_count
            for summary in summaries
        ),
        start_ns=cluster.first_ns if cluster else None,
        end_ns=cluster.last_ns if cluster else None,
        compression=tuple(sorted({name for summary in summaries for name in summary.compression})),
        topics=topics,
        problems=bounded(
            [
                *(problem for one in summaries for problem in one.problems if problem.code not in _RECOMPUTED),
                *_changed_types(summaries),
                *jumps,
                *find_quality_warnings(
                    topics,
                    cluster.last_ns - cluster.first_ns if cluster else None,
                    longest_silence_ns=0
                    if jumps or any(one.code == _CLOCK_JUMP for summary in summaries for one in summary.problems)
                    else None,
                ),
            ]
        ),
        library=first.library,
        profile=first.profile,
        attachments=sum(summary.attachments for summary in summaries),
        metadata_records=sum(summary.metadata_records for summary in summaries),
        bytes_read=sum(summary.bytes_read for summary in summaries),
        depth=model.Depth.scan
        if all(summary.depth is model.Depth.scan for summary in summaries)
        else model.Depth.summary,
        lost=_lost(summaries),
        facts=tuple(dict.fromkeys(fact for summary in summaries for fact in summary.facts))[:_MAX_FACTS],
    )


def _changed_types(summaries: Sequence[RecordingSummary]) -> list[Problem]:
    """Report the topics whose type differs between files."""
    types: dict[str, dict[str, None]] = defaultdict(dict)
    for summary in summaries:
        for topic in summary.topics:
            types[topic.name][topic.message_type] = None
    return [
        Problem("topic-types-differ", name, f"its type changes between the files: {', '.join(type_names)}")
        for name, type_names in sorted(types.items())
        if len(type_names) > 1
    ]


def _jumps_between(summaries: Sequence[RecordingSummary], names: Sequence[str]) -> list[Problem]:
    """Report the files before which the clock was set back: most of their topics begin before the file before ended."""
    problems = []
    ended: dict[str, int] = {}
    for number, summary in enumerate(summaries):
        spans = [(one.name, one.first_ns, one.last_ns) for one in summary.topics]
        known = [(name, first_ns, last_ns) for name, first_ns, last_ns in spans if first_ns is not None and last_ns]
        shared = [ended[name] - first_ns for name, first_ns, _ in known if name in ended]
        back = sorted(back_ns for back_ns in shared if back_ns > MIN_JUMP_NS)
        if 2 * len(back) > len(shared):
            where = names[number] if names else f"file {number + 1}"
            message = f"it begins {back[-1] / 1e9:.1f} s before the file before it ends: the clock was set in between, "
            problems.append(Problem(_CLOCK_JUMP, where, message + "so order, span and gaps are unreliable"))
        ended.update((name, last_ns) for name, _, last_ns in known)
    return problems


def _content(contents: set[Content]) -> Content:
    for unknown in (Content.error, Content.pending):
        if unknown in contents:
            return unknown
    if len(contents) == 1:
        return next(iter(contents))
    return Content.recovered if contents & set(_READABLE) else Content.broken


def _reason(summaries: Sequence[RecordingSummary], names: Sequence[str]) -> str | None:
    """Return the reason of the worst file, and how many others have one."""
    numbers_with_reason = [number for number, summary in enumerate(summaries) if summary.reason]
    if not numbers_with_reason:
        return None
    worst = min(numbers_with_reason, key=lambda number: _WORST_FIRST.index(summaries[number].content))
    name = f"{names[worst]}: " if names else ""
    others = f" (and {len(numbers_with_reason) - 1} more files are incomplete)" if len(numbers_with_reason) > 1 else ""
    return f"{name}{summaries[worst].reason}{others}"


def _lost(summaries: Sequence[RecordingSummary]) -> model.Lost | None:
    losses = [summary.lost for summary in summaries if summary.lost is not None]
    if not losses and _content({summary.content for summary in summaries}) is not Content.recovered:
        return None
    has_unknown = any(one.lost is None and one.content in (Content.broken, Content.opaque) for one in summaries)
    messages = None if has_unknown else _total(lost.messages for lost in losses)
    return model.Lost(sum(lost.bytes for lost in losses), sum(lost.chunks for lost in losses), messages)


def _total(counts: Iterable[int | None]) -> int | None:
    total = 0
    for count in counts:
        if count is None:
            return None
        total += count
    return total


def _span(summary: RecordingSummary) -> StampSpan | None:
    if summary.start_ns is None or summary.end_ns is None:
        return None
    counted = sum((topic.count or 0) - topic.suspect_count for topic in summary.topics)
    return StampSpan(summary.start_ns, summary.end_ns, counted, 0)


def _combine_topic(parts: list[TopicSummary], cluster: StampSpan | None) -> TopicSummary:
    spans = [
        StampSpan(part.first_ns, part.last_ns, part.count - part.suspect_count, part.longest_gap_ns or 0, part.density)
        for part in parts
        if part.first_ns is not None and part.last_ns is not None and part.count is not None
    ]
    span = span_in_cluster(join_spans(spans), cluster)
    count = _total(part.count for part in parts)
    first = parts[0]
    topic = TopicSummary(
        name=first.name,
        message_type=first.message_type,
        schema_name=first.schema_name,
        schema_encoding=first.schema_encoding,
        message_encoding=first.message_encoding,
        count=count,
        out_of_order_count=_total(part.out_of_order_count for part in parts),
        stored_bytes=_total(part.stored_bytes for part in parts),
        suspect_count=0 if count is None else count - (span.count if span else 0),
        density=span.density if span else None,
    )
    return with_times(topic, span, cluster)


MESSAGE_ZSTD = "message-zstd"  # the `compression` of a recording whose messages are compressed separately


def combine_folder(
    metadata: Rosbag2Metadata | None, names: Sequence[str], summaries: Sequence[RecordingSummary]
) -> RecordingSummary:
    """Merge the summaries of a rosbag2 folder, in the order of recording, and compare them with its metadata.yaml.

    `metadata` is None where it could not be understood. `names` are those of the files, without folder. Where files
    are missing, or a damaged one holds fewer messages than the metadata says, that is the recording's loss.
    """
    if metadata is None:
        problem = Problem("metadata-damaged", METADATA_NAME, "it is not the metadata of a rosbag2 recording")
        summary = combine(summaries, names)
        return replace(summary, problems=bounded([problem, *summary.problems]))
    members = list(zip(names, summaries, strict=True))
    if not summaries:
        return _without_data(metadata)
    summary = combine(summaries, names)
    problems = rosbag2.compare_metadata(metadata, members, summary.topics)
    if metadata.compression_mode == "message":
        name = f"message-{metadata.compression}" if metadata.compression else MESSAGE_ZSTD
        summary = replace(summary, compression=tuple(sorted({name, *summary.compression} - {"none"})))
    summary = _with_loss(metadata, members, summary, problems)
    return replace(summary, problems=bounded([*problems, *summary.problems]))


def _without_data(metadata: Rosbag2Metadata) -> RecordingSummary:
    count = len(metadata.files)
    what = "a data file" if count == 1 else f"{count} data files"
    claimed = f" with {counted(metadata.message_count, 'message')}" if metadata.message_count is not None else ""
    return RecordingSummary(
        format=rosbag2.STORAGE_FORMATS.get(metadata.storage or "", model.RecordingFormat.rosbag2_metadata),
        content=Content.broken,
        reason=f"metadata.yaml names {what}{claimed}, but none is there",
        problems=bounded(rosbag2.compare_metadata(metadata, ())),
        lost=model.Lost(0, 0, metadata.message_count),
    )


def _with_loss(
    metadata: Rosbag2Metadata, members: Sequence[rosbag2.Member], summary: RecordingSummary, problems: Sequence[Problem]
) -> RecordingSummary:
    missing = [problem.where for problem in problems if problem.code == "member-missing"]
    if summary.content not in (Content.indexed, Content.recovered, Content.broken):
        return summary
    if not missing and summary.content is Content.indexed:
        return summary
    reasons = [summary.reason] if summary.reason else []
    if missing:
        reasons.append(f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing")
    lost = summary.lost or model.Lost(0, 0, None)
    messages = rosbag2.lost_messages(metadata, members)
    if messages is not None and summary.message_count is not None:
        reasons.append(f"{summary.message_count} of {counted(metadata.message_count or 0, 'message')} can be read")
    return replace(
        summary,
        content=Content.recovered if summary.content is Content.indexed else summary.content,
        reason="; ".join(reasons),
        lost=replace(lost, messages=messages if messages is not None else lost.messages),
    )
