"""A first `checks.yaml` from missions that are known to be good: what they have in common, with margins.

The text is for people to edit: rounded numbers, comments, one line a rule. It uses what the indexes say; rules about
the content of messages are chosen by type and have their defaults, but for the axis of IMUs that points up.
"""

import glob
import json
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple

from kleinkram.checks.document import MAX_RULES, read_checks
from kleinkram.checks.facts import MissionFacts, TopicFacts
from kleinkram.checks.local import LocalMission
from kleinkram.checks.outcomes import storable
from kleinkram.checks.results import content_checks
from kleinkram.recordings.model import counted

_PLAIN_KEY = re.compile(r"/?[A-Za-z0-9_][A-Za-z0-9_/.-]*")
_COMMON_RATES_HZ = (
    *(1, 2, 4, 5, 10, 12.5, 15, 20, 25, 30, 40, 50, 60, 100, 120, 125, 150, 200, 250, 300, 400, 500, 800, 1000),
)
_MIN_COUNT = 20  # of a topic whose rate is believed
_MAX_PERIODS = 20  # a topic with longer gaps is not periodic
_GAP_MARGIN, _GAP_PERIODS = 2, 5
_TOLERANCE, _TOLERANCE_MARGIN, _MAX_TOLERANCE = 0.1, 1.5, 0.4
_COVERAGE_MARGIN = 0.05
_MAX_CLEAR_TILT = 7.5  # degrees between an axis of an IMU and up; half of what the rule allows
_MAX_NAMES = 3  # listed in a section about content; more become a glob
_CONTENT_SECTIONS: Mapping[str, tuple[str, ...]] = {
    "images": ("sensor_msgs/Image", "sensor_msgs/CompressedImage"),
    "imu": ("sensor_msgs/Imu",),
    "positions": ("sensor_msgs/NavSatFix",),
    "point_clouds": ("sensor_msgs/PointCloud2",),
    "transforms": ("tf2_msgs/TFMessage", "tf/tfMessage"),
    "odometry": ("nav_msgs/Odometry",),
}
# Fields without which a message is useless. Others may be NaN in a good mission: velocities, covariances.
_FINITE_FIELDS: Mapping[str, str] = {
    "nav_msgs/Odometry": '["pose.pose.*"]',
    "sensor_msgs/Imu": '["linear_acceleration.*", "angular_velocity.*"]',
}
# Topics with messages only on events.
_EVENT_TOPICS = frozenset(("/rosout", "/rosout_agg", "/parameter_events", "/events/write_split"))


class _CommonTopic(NamedTuple):
    """A topic in all missions: what they say of it. `message_type`: in the spelling of ROS 1; None if types differ."""

    name: str
    message_type: str | None
    facts: Sequence[TopicFacts]
    shares: Sequence[float]


def suggest_checks(missions: Sequence[MissionFacts], up_axes: Mapping[str, str] | None = None) -> str:
    """Return the text of a `checks.yaml` that these missions pass from the index.

    `up_axes`: of IMUs, by topic, as `measure_up_axes` returns them.

    Raises ValueError if they have no topic with messages in common.
    """
    common = list(_common_topics(missions))
    if not common:
        raise ValueError(
            "the missions have no topic with messages in common" if len(missions) > 1 else "it has no messages"
        )
    listed = common[:MAX_RULES]
    lines = [
        f"# Made by `klein checks init` from {counted(len(missions), 'good mission')}. Read it; change what is wrong.",
        "# `klein checks schema` says which rules there are; `klein check PATH --checks THIS` applies them.",
        "version: 1",
        "profiles:",
        "- name: all missions",
        "  # when: {robot: anymal-*}   # only missions with these metadata; other robots get a profile of their own",
        *_recordings_section(missions),
        "  topics:",
        *(_topic_line(topic) for topic in listed),
        *_left_out_topics(missions, common, listed),
        "  clocks:",
        '    "*": {no_jump: true}',
        *_content_sections(listed, up_axes or {}),
    ]
    return "\n".join(lines) + "\n"


# -- recordings -------------------------------------------------------------------------------------------------------


class _RecordedSpan(NamedTuple):
    """How a recording lies in the span of its mission: the share that it covers, and its start after the mission's."""

    share: float
    skew_ns: int


def _recordings_section(missions: Sequence[MissionFacts]) -> Iterator[str]:
    """Yield a rule for each computer, which is a folder that all missions have; otherwise one for all recordings."""
    by_folder = [_spans_by_folder(mission) for mission in missions]
    folders = set.intersection(*(set(spans) for spans in by_folder))
    if "" in folders or any(set(spans) != folders for spans in by_folder):
        by_folder = [{"": [span for spans in one.values() for span in spans]} for one in by_folder]
        folders = {""}
    yield "  recordings:"
    for folder in sorted(folders):
        own = [spans[folder] for spans in by_folder]
        numbers = {len(spans) for spans in own}
        settings = {"count": str(numbers.pop())} if len(numbers) == 1 else {}
        # Several recordings of one folder may follow each other: each covers a part.
        known = [spans[0] for spans in own if len(spans) == 1 and spans[0] is not None]
        if len(known) == len(missions) and (covers := _lower_share(min(span.share for span in known))):
            settings["covers"] = covers
            settings["max_start_skew"] = _duration_text(_rounded_up(max(*(2 * one.skew_ns for one in known), 10**9)))
        yield f"    {_key(f'{glob.escape(folder)}/*' if folder else '*')}: {_flow(settings)}"


def _spans_by_folder(mission: MissionFacts) -> dict[str, list[_RecordedSpan | None]]:
    """Return the recordings by the first folder of their path; None for one without messages."""
    spans: dict[str, list[_RecordedSpan | None]] = defaultdict(list)
    for recording in mission.recordings:
        path = recording.paths[0] if recording.paths else recording.name
        span = None
        if recording.start_ns is not None and mission.start_ns is not None:
            share = _share(recording.start_ns, recording.end_ns, mission)
            span = _RecordedSpan(share, abs(recording.start_ns - mission.start_ns))
        spans[path.split("/", 1)[0] if "/" in path else ""].append(span)
    return spans


# -- topics -----------------------------------------------------------------------------------------------------------


def _common_topics(missions: Sequence[MissionFacts]) -> Iterator[_CommonTopic]:
    """Yield the topics with messages that all missions have, by name; names that YAML cannot express are left out."""
    by_name: dict[str, list[TopicFacts]] = defaultdict(list)
    shares: dict[str, list[float]] = defaultdict(list)
    for mission in missions:
        for topic in mission.topics:
            if topic.count and _is_expressible(topic.name):
                by_name[topic.name].append(topic)
                if None not in (topic.first_ns, topic.last_ns, mission.start_ns, mission.end_ns):
                    shares[topic.name].append(_share(topic.first_ns, topic.last_ns, mission))
    for name, facts in sorted(by_name.items()):
        in_missions = sum(any(topic.name == name and topic.count for topic in mission.topics) for mission in missions)
        if in_missions == len(missions):
            types = {_ros1_type(topic) for topic in facts}
            yield _CommonTopic(name, types.pop() if len(types) == 1 else None, facts, shares[name])


def _is_expressible(name: str) -> bool:
    return bool(name) and name.isprintable() and storable(name) == name and len(glob.escape(name)) <= 1024


def _topic_line(topic: _CommonTopic) -> str:
    settings = {"type": _value(topic.message_type)} if topic.message_type else {}
    rates = [facts.rate_hz for facts in topic.facts]
    if topic.name not in _EVENT_TOPICS and _is_periodic(topic):
        settings |= _rate_settings([rate for rate in rates if rate is not None])
        longest_ns = max(facts.longest_gap_ns or 0 for facts in topic.facts)
        slowest_hz = min(rate for rate in rates if rate is not None)
        gap_ns = max(longest_ns * _GAP_MARGIN, round(_GAP_PERIODS * 1e9 / slowest_hz))
        settings["max_gap"] = _duration_text(_rounded_up(gap_ns))
        if topic.shares and (covers := _lower_share(min(topic.shares))):
            settings["covers"] = covers
    return f"    {_key(glob.escape(topic.name))}: {_flow(settings)}"


def _is_periodic(topic: _CommonTopic) -> bool:
    for facts in topic.facts:
        if facts.rate_hz is None or facts.longest_gap_ns is None or (facts.count or 0) < _MIN_COUNT:
            return False
        if facts.longest_gap_ns > _MAX_PERIODS * 1e9 / facts.rate_hz:
            return False
    rates = [facts.rate_hz for facts in topic.facts if facts.rate_hz is not None]
    return max(rates) <= min(rates) * (1 + _MAX_TOLERANCE)


def _rate_settings(rates_hz: Sequence[float]) -> dict[str, str]:
    """Return the rate of good missions, and a tolerance if they differ by more than the usual one."""
    middle_hz = (min(rates_hz) + max(rates_hz)) / 2
    rate_hz = next((rate for rate in _COMMON_RATES_HZ if abs(middle_hz - rate) <= 0.02 * rate), middle_hz)
    rate_hz = float(f"{rate_hz:.3g}")
    deviation = max(abs(rate - rate_hz) / rate_hz for rate in rates_hz) * _TOLERANCE_MARGIN
    settings = {"rate": f"{rate_hz:g}"}
    if deviation > _TOLERANCE:
        settings["tolerance"] = f"{math.ceil(deviation * 100)}%"
    return settings


def _left_out_topics(
    missions: Sequence[MissionFacts], common: Sequence[_CommonTopic], listed: Sequence[_CommonTopic]
) -> Iterator[str]:
    names = {topic.name for topic in common}
    others = sorted({topic.name for mission in missions for topic in mission.topics} - names)
    for name in (name for name in others if _is_expressible(name)):
        number = sum(any(topic.name == name and topic.count for topic in mission.topics) for mission in missions)
        where = f"in {number} of {counted(len(missions), 'mission')}" if number else "defined, but has no message"
        yield f"    # {name} is {where}."
    if len(listed) < len(common):
        yield f"    # {len(common) - len(listed)} more topics are not listed."


# -- content ----------------------------------------------------------------------------------------------------------


def measure_up_axes(missions: Sequence[LocalMission]) -> dict[str, str]:
    """Return the axis that points up of the IMUs of which it is clear, by topic: the same in all missions.

    Reads samples of messages; without the extra `reading`, returns nothing.
    """
    topics = {topic.name: topic for mission in missions for topic in mission.facts.topics if topic.message_type}
    imus = [name for name, topic in topics.items() if _ros1_type(topic) in _CONTENT_SECTIONS["imu"]]
    names = sorted(name for name in imus if _is_expressible(name))[: MAX_RULES // 3]
    if not names:
        return {}
    rules = {glob.escape(name): [{"up": axis} for axis in "xyz"] for name in names}
    document = {"version": 1, "profiles": [{"name": "up", "imu": rules}]}
    profiles = read_checks(json.dumps(document, ensure_ascii=False)).profiles
    axes: dict[str, set[str | None]] = defaultdict(set)
    for mission in missions:
        tilts: dict[tuple[str, str | None], list[float | None]] = defaultdict(list)
        for check in content_checks(profiles, mission):
            if check.name == "imu.tilt" and check.topic is not None:
                tilts[check.topic, check.file].append(check.value)
        for (topic_name, _), degrees in tilts.items():
            axes[topic_name].add(_clear_axis(degrees))
    unanimous = {name: next(iter(measured)) for name, measured in axes.items() if len(measured) == 1}
    return {name: axis for name, axis in unanimous.items() if axis is not None}


def _clear_axis(degrees: Sequence[float | None]) -> str | None:
    """Return the axis that points up, from the angles between up and x, y and z."""
    for axis, tilt in zip("xyz", degrees, strict=False):
        if tilt is not None and tilt <= _MAX_CLEAR_TILT:
            return axis
        if tilt is not None and tilt >= 180 - _MAX_CLEAR_TILT:
            return f"-{axis}"
    return None


def _ros1_type(topic: TopicFacts) -> str | None:
    return topic.message_type and topic.message_type.replace("/msg/", "/")


def _content_sections(topics: Sequence[_CommonTopic], up_axes: Mapping[str, str]) -> Iterator[str]:
    """Yield rules with their defaults for the topics of each kind that have enough messages."""
    sections = {
        section: [topic for topic in topics if topic.message_type in types and _has_samples(topic, section)]
        for section, types in _CONTENT_SECTIONS.items()
    }
    if any(sections.values()):
        yield "  # What is in the messages: `klein check` samples them; `pip install 'open-kleinkram[reading]'`."
    for section, own in sections.items():
        if own:
            yield f"  {section}:"
            names = [topic.name for topic in own]
            axes = {up_axes.get(name) for name in names} if section == "imu" else {None}
            if len(axes) > 1:
                settings = {glob.escape(name): _up_setting(up_axes.get(name)) for name in names}
            else:
                settings = dict.fromkeys(_patterns(section, names), _up_setting(axes.pop()))
            yield from (f"    {_key(pattern)}: {_flow(values)}" for pattern, values in settings.items())
    finite = [topic for topic in topics if topic.message_type in _FINITE_FIELDS and _has_samples(topic, "values")]
    if finite:
        yield "  values:"
        for topic in finite:
            fields = _FINITE_FIELDS[topic.message_type or ""]
            yield f"    {_key(glob.escape(topic.name))}: {_flow({'fields': fields})}"
    for topic in topics:
        if topic.message_type == "sensor_msgs/BatteryState":
            yield f"  # batteries: {{{_key(glob.escape(topic.name))}: {{min_percentage: 20%}}}}"


def _up_setting(axis: str | None) -> Mapping[str, str]:
    return {} if axis is None else {"up": axis}


def _has_samples(topic: _CommonTopic, section: str) -> bool:
    return section == "transforms" or all((facts.count or 0) >= _MIN_COUNT for facts in topic.facts)


def _patterns(section: str, names: Sequence[str]) -> list[str]:
    """Return the names as globs; of many, one with what they have in common: it selects only messages of the kind."""
    if section == "transforms":  # of which all make one tree
        return ["/tf*" if all(name.startswith("/tf") for name in names) else "*"]
    if len(names) <= _MAX_NAMES:
        return [glob.escape(name) for name in names]
    columns = zip(*(name.split("/")[:-1] for name in names), strict=False)
    folder = "/".join(parts[0] for parts in takewhile(lambda parts: len(set(parts)) == 1, columns))
    return [f"{glob.escape(folder)}/*" if folder else "*"]


# -- text -------------------------------------------------------------------------------------------------------------


def _share(start_ns: int | None, end_ns: int | None, mission: MissionFacts) -> float:
    span_ns = (mission.end_ns or 0) - (mission.start_ns or 0)
    return ((end_ns or 0) - (start_ns or 0)) / span_ns if span_ns > 0 else 1.0


def _lower_share(share: float) -> str | None:
    """Return a share with its margin, in steps of 5 %; None below 10 %."""
    steps = math.floor((share - _COVERAGE_MARGIN) * 20 + 1e-9)
    return f"{steps * 5}%" if steps >= 2 else None


def _rounded_up(span_ns: int) -> int:
    """Return the next of 1, 2, 3, 5, 10, 20 … in nanoseconds."""
    power: int = 10 ** (len(str(span_ns)) - 1)
    return next(step * power for step in (1, 2, 3, 5, 10) if step * power >= span_ns)


def _duration_text(span_ns: int) -> str:
    for unit, size in (("s", 10**9), ("ms", 10**6), ("us", 10**3)):
        if span_ns >= size and span_ns % size == 0:
            return f"{span_ns // size}{unit}"
    return f"{span_ns}ns"


def _key(text: str) -> str:
    return text if _PLAIN_KEY.fullmatch(text) else json.dumps(text, ensure_ascii=False)


def _value(text: str) -> str:
    return text if _PLAIN_KEY.fullmatch(text) else json.dumps(storable(text), ensure_ascii=False)


def _flow(settings: Mapping[str, str] | Iterable[tuple[str, str]]) -> str:
    return "{" + ", ".join(f"{name}: {value}" for name, value in dict(settings).items()) + "}"
