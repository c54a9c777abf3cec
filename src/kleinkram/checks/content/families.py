"""The sections of a `checks.yaml` that need the content of messages: which topics and checks each of them has.

Needs no library of the extra `reading`, so that the checks that were not made can be listed without it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import NamedTuple

from kleinkram.checks.document import (
    BatteryRule,
    ClockRule,
    ImageRule,
    ImuRule,
    OdometryRule,
    PointCloudRule,
    PositionRule,
    Profile,
    Rule,
    SampledRule,
    TransformRule,
    ValueRule,
)
from kleinkram.checks.globs import Comparisons, matches
from kleinkram.checks.outcomes import make_check
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
        noun: what its messages are, in the plural.
    """

    section: str
    rules_of: Callable[[Profile], Mapping[str, Sequence[Rule]]]
    types: frozenset[str] | None
    noun: str


class PlannedRule(NamedTuple):
    """A rule, the names of its checks, and the topics that it applies to.

    `other`: if there are none, one that matches, but has other messages.
    """

    family: Family
    pattern: str
    rule: Rule
    names: tuple[str, ...]
    topics: list[TopicOfRecording]
    other: TopicOfRecording | None = None

    @property
    def samples(self) -> int:
        """How many messages are read of each topic."""
        return self.rule.samples if isinstance(self.rule, SampledRule) else DEFAULT_SAMPLES


_POSES = ("Odometry", "PoseStamped", "PoseWithCovarianceStamped", "PoseInFrame", "TransformStamped")
FAMILIES = (
    Family("clocks", lambda profile: profile.clocks, None, "messages"),
    Family(
        "images",
        lambda profile: profile.images,
        frozenset(("Image", "CompressedImage", "RawImage")),
        "images",
    ),
    Family("imu", lambda profile: profile.imu, frozenset(("Imu",)), "inertial measurements"),
    Family(
        "positions",
        lambda profile: profile.positions,
        frozenset(("NavSatFix", "LocationFix")),
        "positions",
    ),
    Family(
        "point_clouds",
        lambda profile: profile.point_clouds,
        frozenset(("PointCloud2", "PointCloud")),
        "point clouds",
    ),
    Family(
        "transforms",
        lambda profile: profile.transforms,
        frozenset(("TFMessage", "tfMessage", "FrameTransform", "FrameTransforms")),
        "transforms",
    ),
    Family("odometry", lambda profile: profile.odometry, frozenset(_POSES), "poses"),
    Family(
        "batteries",
        lambda profile: profile.batteries,
        frozenset(("BatteryState",)),
        "battery states",
    ),
    Family("values", lambda profile: profile.values, None, "messages"),
)


def content_checks_of(rule: Rule) -> tuple[str, ...]:
    """Return the names of the checks of a rule that read messages: those whose bounds are set."""
    names: dict[str, object] = {}
    if isinstance(rule, ClockRule):
        names = {
            "clock.stamp_offset": rule.max_stamp_offset,
            "clock.stamp_drift": rule.max_stamp_drift,
            "clock.stamp_jump": rule.max_stamp_jump,
            "clock.recorder_offset": rule.max_recorder_offset,
        }
    elif isinstance(rule, ImageRule):
        names = {"image.black": 0, "image.overexposed": 0, "image.frozen": 0, "image.blurred": rule.min_sharpness}
    elif isinstance(rule, ImuRule):
        limit = rule.max_acceleration or rule.max_turn_rate
        names = {"imu.gravity": 0, "imu.tilt": rule.up, "imu.saturated": limit, "imu.constant": 0}
    elif isinstance(rule, PointCloudRule):
        names = {"cloud.empty": 0, "cloud.range": rule.max_range or rule.min_range or None}
    elif isinstance(rule, ValueRule):
        limit = rule.min if rule.max is None else rule.max
        names = {"value.nan": 0, "value.constant": rule.varies or None, "value.range": limit}
    elif isinstance(rule, BatteryRule):
        names = {"battery.low": rule.min_voltage if rule.min_percentage is None else rule.min_percentage}
    else:
        names = dict.fromkeys(_UNBOUNDED.get(type(rule), ()), 0)
    return tuple(name for name, bound in names.items() if bound is not None)


_UNBOUNDED: Mapping[type[Rule], tuple[str, ...]] = {
    PositionRule: ("position.fix", "position.jump"),
    TransformRule: ("transform.connected",),
    OdometryRule: ("odometry.jump",),
}


def optional_topics(profiles: Sequence[Profile]) -> Set[str]:
    """Return the names and globs of topics that a profile describes and does not require."""
    return {
        pattern
        for profile in profiles
        for pattern, rules in profile.topics.items()
        if not any(rule.required for rule in rules)
    }


def need_content(profiles: Sequence[Profile]) -> bool:
    """Return whether a rule needs the content of messages."""
    all_rules = (rules for profile in profiles for family in FAMILIES for rules in family.rules_of(profile).values())
    return any(content_checks_of(rule) for rules in all_rules for rule in rules)


def planned_rules(profiles: Sequence[Profile], topics: Sequence[TopicOfRecording]) -> Iterator[PlannedRule]:
    """Yield the rules that need content, each with its topics, in the order of the document.

    Left out are those that match no topic and have the name or glob of topics that may be missing.

    Raises TooManyComparisons.
    """
    comparisons = Comparisons([topic.topic for topic in topics])
    optional = optional_topics(profiles)
    for profile in profiles:
        for family in FAMILIES:
            for pattern, rules in family.rules_of(profile).items():
                comparisons.add(pattern)
                matching = [topic for topic in topics if topic.topic == pattern or matches(topic.topic, pattern)]
                if not matching and pattern in optional:
                    continue
                applying = [topic for topic in matching if _applies(family, pattern, topic)]
                other = matching[0] if matching and not applying else None
                for rule in rules:
                    if names := content_checks_of(rule):
                        yield PlannedRule(family, pattern, rule, names, applying, other)


def unmade_checks(planned: PlannedRule, status: CheckStatus, message: str, file: str | None = None) -> Iterator[Check]:
    """Yield the checks of a rule that are not made for one reason: of each topic, or of the rule if it has none."""
    for name in planned.names:
        for topic in planned.topics:
            yield make_check(name, status, message, topic=topic.topic, file=topic.recording)
        if not planned.topics:
            yield make_check(name, status, message, topic=planned.pattern, file=file)


def why_none(planned: PlannedRule) -> str:
    """Return why a rule applies to no topic."""
    if planned.other is not None:
        return (
            f"no topic that matches {planned.pattern} has {planned.family.noun}: "
            f"{planned.other.topic} has {planned.other.message_type or 'no type'}"
        )
    return f"no topic matches {planned.pattern}"


def _applies(family: Family, pattern: str, topic: TopicOfRecording) -> bool:
    """Return whether a topic that matches has messages of a section; one with its full name does."""
    return (
        topic.topic == pattern
        or family.types is None
        or topic.message_type.replace(".", "/").rpartition("/")[2] in family.types
    )
