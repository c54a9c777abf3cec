"""Makes the content checks: plans them, reads the samples, and collects the rows. Needs numpy and pillow."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from kleinkram.checks.content.batteries import BatteryProbe
from kleinkram.checks.content.clocks import RecorderProbe, StampProbe
from kleinkram.checks.content.families import PlannedRule, unmade_checks
from kleinkram.checks.content.images import ImageProbe
from kleinkram.checks.content.imu import ImuProbe
from kleinkram.checks.content.odometry import OdometryProbe
from kleinkram.checks.content.point_clouds import PointCloudProbe
from kleinkram.checks.content.positions import PositionProbe
from kleinkram.checks.content.probe import FollowUp, Probe, RecordedTopic
from kleinkram.checks.content.sample_reader import SampleReader
from kleinkram.checks.content.segment_plan import READ_WHOLE_MESSAGES, default_budget
from kleinkram.checks.content.transforms import TransformProbe
from kleinkram.checks.content.values import ValueProbe
from kleinkram.checks.document import ImageRule, Rule
from kleinkram.checks.outcomes import ShowProgress
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.recording import Recording

AnyProbe = Probe[Rule]
_RECORDER_OFFSET = "clock.recorder_offset"
_PROBES: Mapping[str, Callable[..., AnyProbe]] = {
    "images": ImageProbe,
    "imu": ImuProbe,
    "positions": PositionProbe,
    "point_clouds": PointCloudProbe,
    "odometry": OdometryProbe,
    "batteries": BatteryProbe,
    "values": ValueProbe,
}
_MAX_FOLLOW_UPS = 200


class _Attached:
    """The probes of one rule, and the topics of recordings that they read."""

    def __init__(self, planned: PlannedRule) -> None:
        self.planned = planned
        self.streams: list[tuple[AnyProbe, tuple[RecordedTopic, ...]]] = []
        names = planned.names
        if planned.family.section == "clocks":
            self._add_clocks(names)
            return
        if planned.family.section == "transforms":
            self._add(
                TransformProbe, names, tuple(RecordedTopic(item.recording, item.topic) for item in planned.topics)
            )
            return
        for topic in planned.topics:
            self._add(_PROBES[planned.family.section], names, (RecordedTopic(topic.recording, topic.topic),))

    def _add(self, kind: Callable[..., AnyProbe], names: tuple[str, ...], streams: tuple[RecordedTopic, ...]) -> None:
        planned = self.planned
        is_exact = planned.pattern == streams[0].topic
        subject: Any = streams if kind in (RecorderProbe, TransformProbe) else streams[0]
        self.streams.append((kind(planned.rule, names, subject, is_exact=is_exact), streams))

    def _add_clocks(self, names: tuple[str, ...]) -> None:
        of_stamps = tuple(name for name in names if name != _RECORDER_OFFSET)
        recorders: dict[str, list[RecordedTopic]] = defaultdict(list)
        for topic in self.planned.topics:
            stream = RecordedTopic(topic.recording, topic.topic)
            recorders[topic.topic].append(stream)
            if of_stamps:
                self._add(StampProbe, of_stamps, (stream,))
        if _RECORDER_OFFSET in names:
            for streams in recorders.values():
                if len(streams) > 1:
                    self._add(RecorderProbe, (_RECORDER_OFFSET,), tuple(streams))

    def checks(self) -> Iterator[Check]:
        """Yield the rows of the rule.

        Of a glob, topics to which its checks do not apply have none; checks that apply to no topic are not made.
        """
        probes = [probe for probe, _ in self.streams]
        applicable = [probe for probe in probes if _is_applicable(probe)]
        for kind, reason in _INAPPLICABLE.items():
            of_kind = [probe for probe in probes if isinstance(probe, kind)]
            if of_kind and not any(isinstance(probe, kind) for probe in applicable):
                yield from _rows_of_rule(self.planned, of_kind[0].names, reason.format(self.planned.pattern))
        if _RECORDER_OFFSET in self.planned.names and not any(isinstance(probe, RecorderProbe) for probe in probes):
            reason = f"no two recordings have a topic that matches {self.planned.pattern}"
            yield from _rows_of_rule(self.planned, (_RECORDER_OFFSET,), reason)
        for probe in applicable:
            yield from probe.checks()


_INAPPLICABLE: Mapping[type[AnyProbe], str] = {
    StampProbe: "no message of a topic that matches {} has a header stamp",
    ValueProbe: "no topic that matches {} has such a numeric field",
}


def _is_applicable(probe: AnyProbe) -> bool:
    """Return whether the topic has what the checks are about, or the rule names it."""
    if probe.is_exact:
        return True
    if isinstance(probe, StampProbe):
        return probe.has_stamps
    return probe.has_fields if isinstance(probe, ValueProbe) else True


def _rows_of_rule(planned: PlannedRule, names: tuple[str, ...], reason: str) -> Iterator[Check]:
    without_topics = planned._replace(topics=[])
    return (row for row in unmade_checks(without_topics, CheckStatus.not_made, reason) if row.name in names)


def run_checks(
    planned_rules: Sequence[PlannedRule],
    recordings: Mapping[str, Recording],
    budget_bytes: int | None,
    show: ShowProgress,
) -> list[Check]:
    """Return the rows of all rules, in their order.

    `recordings`: by name; all that the rules name are among them. `budget_bytes`, `show`: as in `check_content`.
    """
    rules = [_Attached(planned) for planned in planned_rules]
    probes: dict[str, dict[str, list[AnyProbe]]] = defaultdict(lambda: defaultdict(list))
    samples: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    pair_gaps: dict[str, int] = defaultdict(int)
    for rule in rules:
        for probe, streams in rule.streams:
            for recording, topic in streams:
                probes[recording][topic].append(probe)
                samples[recording][topic] = max(samples[recording][topic], rule.planned.samples)
                if isinstance(probe.rule, ImageRule):
                    pair_gaps[recording] = max(pair_gaps[recording], probe.rule.max_frozen * 11 // 10 + 1)
    readers = {
        name: SampleReader(name, recordings[name], dict(needed), pair_gaps[name]) for name, needed in samples.items()
    }
    total_bytes = sum(reader.size_bytes for reader in readers.values())
    budget = default_budget(total_bytes) if budget_bytes is None else budget_bytes
    total_messages = sum(reader.message_count for reader in readers.values())
    is_whole = total_bytes <= budget and total_messages <= READ_WHOLE_MESSAGES
    for number, (name, reader) in enumerate(readers.items()):
        show(number / len(readers), name)
        reader.read(probes[name], None if is_whole else budget * reader.size_bytes // max(1, total_bytes))
    _follow_up(rules, readers)
    return [row for rule in rules for row in rule.checks()]


def _follow_up(rules: Sequence[_Attached], readers: Mapping[str, SampleReader]) -> None:
    left = _MAX_FOLLOW_UPS
    for rule in rules:
        for probe, _ in rule.streams:
            by_stream: dict[RecordedTopic, list[FollowUp]] = defaultdict(list)
            for follow_up in probe.follow_ups()[:left]:
                by_stream[follow_up.stream].append(follow_up)
                left -= 1
            for stream, follow_ups in by_stream.items():
                times_ns = [follow_up.time_ns for follow_up in follow_ups]
                readers[stream.recording].read_near(stream.topic, times_ns, probe)
