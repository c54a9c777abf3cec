"""Several files of one recording -> one summary of the recording."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

from kleinkram.recordings.assemble import bounded, rate_hz
from kleinkram.recordings.model import Content, RecordingSummary, TopicSummary
from kleinkram.recordings.timeline import Run, bulk, join, within

_WORST_FIRST = (
    Content.error,
    Content.broken,
    Content.pending,
    Content.opaque,
    Content.recovered,
    Content.indexed,
)


def combine(summaries: Sequence[RecordingSummary]) -> RecordingSummary:
    """Merge the summaries of the members of one recording, given in the order of recording.

    Counts are added; a count that one member does not know is not known of the whole. Silences between members count
    as gaps. Where members overlap in time, the longest gap of a topic is an upper bound. `content` is the worst of
    the members'; `format` the first's; `reason` that of the worst.

    Raises:
        ValueError: there is no summary.
    """
    if not summaries:
        raise ValueError("a recording has at least one member")
    if len(summaries) == 1:
        return summaries[0]
    worst = min(summaries, key=lambda summary: _WORST_FIRST.index(summary.content))
    island = bulk(run for summary in summaries if (run := _span(summary)) is not None)
    return RecordingSummary(
        format=summaries[0].format,
        content=worst.content,
        reason=worst.reason,
        message_count=_total(summary.message_count for summary in summaries),
        start_ns=island.first_ns if island else None,
        end_ns=island.last_ns if island else None,
        compression=tuple(sorted({name for summary in summaries for name in summary.compression})),
        topics=_combine_topics(summaries, island),
        problems=bounded([problem for summary in summaries for problem in summary.problems]),
        library=summaries[0].library,
        profile=summaries[0].profile,
        attachments=sum(summary.attachments for summary in summaries),
        metadata_records=sum(summary.metadata_records for summary in summaries),
        bytes_read=sum(summary.bytes_read for summary in summaries),
    )


def _total(counts: Iterable[int | None]) -> int | None:
    total = 0
    for count in counts:
        if count is None:
            return None
        total += count
    return total


def _span(summary: RecordingSummary) -> Run | None:
    if summary.start_ns is None or summary.end_ns is None:
        return None
    counted = sum((topic.count or 0) - topic.suspect_count for topic in summary.topics)
    return Run(summary.start_ns, summary.end_ns, counted, 0)


def _combine_topics(summaries: Sequence[RecordingSummary], island: Run | None) -> tuple[TopicSummary, ...]:
    by_name: dict[str, list[TopicSummary]] = defaultdict(list)
    for summary in summaries:
        for topic in summary.topics:
            by_name[topic.name].append(topic)
    return tuple(_combine_topic(by_name[name], island) for name in sorted(by_name))


def _combine_topic(parts: list[TopicSummary], island: Run | None) -> TopicSummary:
    runs = join(run for part in parts if (run := _run(part)) is not None)
    run = within(runs, island)
    count = _total(part.count for part in parts)
    return replace(
        parts[0],
        count=count,
        first_ns=run.first_ns if run else None,
        last_ns=run.last_ns if run else None,
        rate_hz=rate_hz(run.count, run.first_ns, run.last_ns) if run else None,
        longest_gap_ns=run.longest_gap_ns if run and run.count > 1 else None,
        head_gap_ns=run.first_ns - island.first_ns if run and island else None,
        tail_gap_ns=island.last_ns - run.last_ns if run and island else None,
        out_of_order_count=_total(part.out_of_order_count for part in parts),
        stored_bytes=_total(part.stored_bytes for part in parts),
        suspect_count=(count or 0) - (run.count if run else 0),
    )


def _run(topic: TopicSummary) -> Run | None:
    if topic.first_ns is None or topic.last_ns is None or topic.count is None:
        return None
    return Run(topic.first_ns, topic.last_ns, topic.count - topic.suspect_count, topic.longest_gap_ns or 0)
