"""The sections of a `checks.yaml` that need the content of messages: which topics and checks each of them has.

Needs no library of the extra `reading`, so that the checks that were not made can be listed without it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import NamedTuple

from kleinkram.checks import document
from kleinkram.checks.content.rows import make_row
from kleinkram.checks.document import Profile, Rule, SampledRule
from kleinkram.contract.checks import Check, CheckStatus

DEFAULT_SAMPLES = 20


class TopicOfRecording(NamedTuple):
    """A topic with messages, in one recording."""

    recording: str
    topic: str
    message_type: str


@dataclass(frozen=True)
class Family:
    """One section.

    Attributes:
        section: its key.
        rules_of: the rules of the section, by glob.
        types: message types, without package, that a glob selects; None: any. A full name selects whatever it names.
        check_names: what a rule checks; empty if it does nothing.
        noun: what its messages are, in the plural.
    """

    section: str
    rules_of: Callable[[Profile], Mapping[str, Sequence[Rule]]]
    types: frozenset[str] | None
    check_names: Callable[[Rule], tuple[str, ...]]
    noun: str


class PlannedRule(NamedTuple):
    """A rule and the topics that it applies to."""

    family: Family
    pattern: str
    rule: Rule
    topics: list[TopicOfRecording]

    @property
    def samples(self) -> int:
        """How many messages are read of each topic."""
        return self.rule.samples if isinstance(self.rule, SampledRule) else DEFAULT_SAMPLES


def _image_checks(rule: Rule) -> tuple[str, ...]:
    names = ("image.black", "image.overexposed", "image.frozen")
    is_measured = isinstance(rule, document.ImageRule) and rule.min_sharpness is not None
    return (*names, "image.blurred") if is_measured else names


def _imu_checks(rule: Rule) -> tuple[str, ...]:
    names = ["imu.gravity", "imu.constant"]
    if isinstance(rule, document.ImuRule):
        names += ["imu.tilt"] if rule.up else []
        names += ["imu.saturated"] if rule.max_acceleration or rule.max_turn_rate else []
    return tuple(names)


def _cloud_checks(rule: Rule) -> tuple[str, ...]:
    if isinstance(rule, document.PointCloudRule) and (rule.min_range or rule.max_range):
        return "cloud.empty", "cloud.range"
    return ("cloud.empty",)


def _value_checks(rule: Rule) -> tuple[str, ...]:
    names = ["value.nan"]
    if isinstance(rule, document.ValueRule):
        names += ["value.constant"] if rule.varies else []
        names += ["value.range"] if rule.min is not None or rule.max is not None else []
    return tuple(names)


def _clock_checks(rule: Rule) -> tuple[str, ...]:
    """Return the checks of header stamps; `clock.jump` is made from the index."""
    if not isinstance(rule, document.ClockRule):
        return ()
    limits = {
        "clock.stamp_offset": rule.max_stamp_offset,
        "clock.stamp_drift": rule.max_stamp_drift,
        "clock.stamp_jump": rule.max_stamp_jump,
        "clock.recorder_offset": rule.max_recorder_offset,
    }
    return tuple(name for name, limit in limits.items() if limit is not None)


def _always(*names: str) -> Callable[[Rule], tuple[str, ...]]:
    return lambda _rule: names


_POSES = ("Odometry", "PoseStamped", "PoseWithCovarianceStamped", "PoseInFrame", "TransformStamped")
FAMILIES = (
    Family("clocks", lambda profile: profile.clocks, None, _clock_checks, "messages"),
    Family(
        "images",
        lambda profile: profile.images,
        frozenset(("Image", "CompressedImage", "RawImage")),
        _image_checks,
        "images",
    ),
    Family("imu", lambda profile: profile.imu, frozenset(("Imu",)), _imu_checks, "inertial measurements"),
    Family(
        "positions",
        lambda profile: profile.positions,
        frozenset(("NavSatFix", "LocationFix")),
        _always("position.fix", "position.jump"),
        "positions",
    ),
    Family(
        "point_clouds",
        lambda profile: profile.point_clouds,
        frozenset(("PointCloud2", "PointCloud")),
        _cloud_checks,
        "point clouds",
    ),
    Family(
        "transforms",
        lambda profile: profile.transforms,
        frozenset(("TFMessage", "tfMessage", "FrameTransform", "FrameTransforms")),
        _always("transform.connected"),
        "transforms",
    ),
    Family("odometry", lambda profile: profile.odometry, frozenset(_POSES), _always("odometry.jump"), "poses"),
    Family(
        "batteries",
        lambda profile: profile.batteries,
        frozenset(("BatteryState",)),
        _always("battery.low"),
        "battery states",
    ),
    Family("values", lambda profile: profile.values, None, _value_checks, "messages"),
)


def is_pattern(name: str) -> bool:
    """Return whether a name is a glob."""
    return any(sign in name for sign in "*?[")


def planned_rules(profiles: Sequence[Profile], topics: Sequence[TopicOfRecording]) -> Iterator[PlannedRule]:
    """Yield the rules that need content, each with its topics, in the order of the document."""
    for profile in profiles:
        for family in FAMILIES:
            for pattern, rules in family.rules_of(profile).items():
                matching = [topic for topic in topics if _applies(family, pattern, topic)]
                for rule in rules:
                    if family.check_names(rule):
                        yield PlannedRule(family, pattern, rule, matching)


def unmade_checks(planned: PlannedRule, status: CheckStatus, message: str, file: str | None = None) -> Iterator[Check]:
    """Yield the checks of a rule that are not made for one reason: of each topic, or of the rule if it has none."""
    names = planned.family.check_names(planned.rule)
    for name in names:
        for topic in planned.topics:
            yield make_row(name, status, message, topic=topic.topic, file=topic.recording)
        if not planned.topics:
            yield make_row(name, status, message, topic=planned.pattern, file=file)


def needing_content(profiles: Sequence[Profile], topics: Sequence[TopicOfRecording]) -> Iterator[Check]:
    """Yield the checks that read messages, as not made because only the index was read."""
    for planned in planned_rules(profiles, topics):
        message = "it reads messages; only the index was read"
        yield from unmade_checks(planned, CheckStatus.needs_content, message)


def why_none(planned: PlannedRule, topics: Sequence[TopicOfRecording]) -> str:
    """Return why a rule applies to no topic."""
    others = [topic for topic in topics if fnmatchcase(topic.topic, planned.pattern)]
    if others:
        return (
            f"no topic that matches {planned.pattern} has {planned.family.noun}: "
            f"{others[0].topic} has {others[0].message_type or 'no type'}"
        )
    return f"no topic matches {planned.pattern}"


def _applies(family: Family, pattern: str, topic: TopicOfRecording) -> bool:
    if topic.topic == pattern:
        return True
    if not fnmatchcase(topic.topic, pattern):
        return False
    return family.types is None or topic.message_type.replace(".", "/").rpartition("/")[2] in family.types
