"""`checks.yaml`: the rules by which the recordings of a mission are checked, as models and as JSON schema.

A document has profiles; each applies to the missions whose metadata match its `when`, and several may apply. In every
section, a rule belongs to the names that match a glob (`*` also matches `/`), and all matching rules apply.
"""

import difflib
from collections.abc import Hashable, Iterable, Iterator, Mapping, Set
from typing import Annotated, Literal, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    FiniteFloat,
    GetJsonSchemaHandler,
    JsonValue,
    StrictBool,
    ValidationError,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue, WithJsonSchema
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError
from typing_extensions import Self

from kleinkram.checks.globs import TextsToMatch, check_rule_glob, is_glob
from kleinkram.contract import units
from kleinkram.contract.base import Request
from kleinkram.contract.checks import MAX_CHECKS_CHARACTERS, CheckSeverity
from kleinkram.contract.errors import YamlInvalid
from kleinkram.contract.names import check_trajectory_name
from kleinkram.contract.problems import message_of
from kleinkram.recordings.model import span_text
from kleinkram.untrusted_yaml import Document, Path, read_yaml

MAX_PROFILES, MAX_RULES, MAX_VALUES = 50, 1000, 1000
_MAX_NS, _MAX_NUMBER = 2**62, 1e9
SCHEMA_ID = "urn:kleinkram:checks:1"


def _duration(value: object) -> object:
    """Return nanoseconds of `50ms`, or of a number of seconds."""
    if isinstance(value, str):
        span_ns = int(units.read_duration(value))
    else:
        span_ns = round(_number(value, "write a duration such as 50ms, or a number of seconds") * 1e9)
    if span_ns > _MAX_NS:
        raise ValueError(f"a duration may be at most {span_text(_MAX_NS)}")
    return span_ns


def _share(value: object) -> object:
    """Return a share from 0 to 1 of `95%` or 0.95."""
    if isinstance(value, str) and value.strip().endswith("%"):
        try:
            return float(value.strip()[:-1]) / 100
        except ValueError:
            raise ValueError("write a share such as 95%, or a number from 0 to 1") from None
    return _number(value, "write a share such as 95%, or a number from 0 to 1")


def _rate(value: object) -> object:
    """Return hertz of `200 Hz` or 200."""
    if isinstance(value, str) and value.strip().lower().endswith("hz"):
        try:
            return float(value.strip()[:-2])
        except ValueError:
            raise ValueError("write a rate such as 200 Hz, or a number of hertz") from None
    return _number(value, "write a rate such as 200 Hz, or a number of hertz")


def _number(value: object, message: str) -> float:
    if not isinstance(value, bool) and isinstance(value, int | float) and abs(value) <= _MAX_NUMBER:
        return value
    raise ValueError(message)


def _size(value: object) -> object:
    return int(units.read_size(value)) if isinstance(value, str) else value


def _one_or_several(value: object) -> object:
    """Return the rules of a name; one that says nothing has the defaults."""
    return [{} if rule is None else rule for rule in (value if isinstance(value, list) else [value])]


def _exact_count(value: object) -> object:
    return {"min": value, "max": value} if isinstance(value, int) and not isinstance(value, bool) else value


DurationNs = Annotated[
    int,
    BeforeValidator(_duration),
    Field(ge=0),
    WithJsonSchema({"anyOf": [{"type": "number", "minimum": 0}, {"type": "string"}], "examples": ["50ms", "2s", 0.5]}),
]
Share = Annotated[
    float,
    BeforeValidator(_share),
    Field(ge=0, le=1, allow_inf_nan=False),
    WithJsonSchema(
        {"anyOf": [{"type": "number", "minimum": 0, "maximum": 1}, {"type": "string"}], "examples": ["95%"]}
    ),
]
Rate = Annotated[
    float,
    BeforeValidator(_rate),
    Field(gt=0, allow_inf_nan=False),
    WithJsonSchema({"anyOf": [{"type": "number", "exclusiveMinimum": 0}, {"type": "string"}], "examples": [200]}),
]
SizeBytes = Annotated[
    int,
    BeforeValidator(_size),
    Field(ge=0, lt=2**63),
    WithJsonSchema({"anyOf": [{"type": "integer", "minimum": 0}, {"type": "string"}], "examples": ["10MB"]}),
]
Positive = Annotated[FiniteFloat, Field(gt=0)]
Glob = Annotated[str, Field(min_length=1, max_length=1024), AfterValidator(check_rule_glob)]
TrajectoryName = Annotated[str, Field(max_length=1024), AfterValidator(check_trajectory_name)]


class CountRange(Request):
    """How many there must be."""

    min: Annotated[int, Field(ge=0)] = 0
    max: Annotated[int, Field(ge=0)] | None = None

    @model_validator(mode="after")
    def _is_a_range(self) -> Self:
        if self.max is not None and self.max < self.min:
            raise ValueError("max is smaller than min")
        return self


Count = Annotated[
    CountRange,
    BeforeValidator(_exact_count),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "integer", "minimum": 0},
                {
                    "type": "object",
                    "additionalProperties": False,
                    "properties": {name: {"type": "integer", "minimum": 0} for name in ("min", "max")},
                },
            ]
        }
    ),
]


class Rule(Request):
    """Base of the rules. `severity`: what it means that one of its checks fails."""

    severity: CheckSeverity = CheckSeverity.error


class FileRule(Rule):
    """Files of the mission, by path. Checks: file.missing, file.count, file.incomplete, file.size."""

    required: StrictBool = Field(True, description="At least one file must match.")
    count: Count | None = Field(None, description="How many files must match.")
    complete: StrictBool = Field(False, description="Each recording among them must be readable from start to end.")
    min_size: SizeBytes | None = Field(None, description="Smallest size of each file, such as 10MB.")


class RecordingRule(Rule):
    """Recordings, by name: one for each computer that records.

    Checks: recording.missing, recording.count, recording.incomplete, recording.coverage, recording.start_skew,
    recording.end_skew.
    """

    required: StrictBool = Field(True, description="At least one recording must match.")
    count: Count | None = Field(None, description="How many recordings must match.")
    complete: StrictBool = Field(True, description="Each must be readable from start to end.")
    covers: Share | None = Field(None, description="Smallest share of the mission's span that each must cover.")
    max_start_skew: DurationNs | None = Field(None, description="Latest start after the mission's start.")
    max_end_skew: DurationNs | None = Field(None, description="Earliest end before the mission's end.")


class TopicRule(Rule):
    """Topics, by name.

    Checks: topic.missing, topic.type, topic.rate, topic.gap, topic.coverage, topic.count, topic.silent_start,
    topic.silent_end.
    """

    required: StrictBool = Field(True, description="At least one topic with a message must match.")
    recording: Glob | None = Field(None, description="A recording that matches this glob must contain the topic.")
    type: str | None = Field(None, description="Message type; the spellings of ROS 1 and ROS 2 are equal.")
    rate: Rate | None = Field(None, description="Rate in hertz.")
    tolerance: Share = Field(0.1, description="Largest deviation of the rate, as a share of it.")
    max_gap: DurationNs | None = Field(None, description="Longest silence between two messages.")
    covers: Share | None = Field(None, description="Smallest share of the mission's span from first to last message.")
    count: Count | None = Field(None, description="How many messages there must be.")
    max_silence_at_start: DurationNs | None = Field(None, description="Latest first message after the mission's start.")
    max_silence_at_end: DurationNs | None = Field(None, description="Earliest last message before the mission's end.")


class ClockRule(Rule):
    """Clocks, by topic: the time stamps in the headers, and the log times.

    Checks: clock.jump (log times jump back; from the index), clock.stamp_offset, clock.stamp_drift, clock.stamp_jump,
    clock.recorder_offset.
    """

    no_jump: StrictBool = Field(False, description="Log times must not jump back.")
    max_stamp_offset: DurationNs | None = Field(
        None, description="Largest difference between header stamp and log time, as the median over the recording."
    )
    max_stamp_drift: Positive | None = Field(
        None, description="Largest drift of the header stamp against the log time, in microseconds per second (ppm)."
    )
    max_stamp_jump: DurationNs | None = Field(
        None, description="Largest change of the difference between stamp and log time from one sample to the next."
    )
    max_recorder_offset: DurationNs | None = Field(
        None, description="Largest difference between the log times that two recordings have for the same message."
    )


class SampledRule(Rule):
    """Base of rules that read messages: `samples`, spread over the recording, are read of each topic."""

    samples: Annotated[int, Field(ge=2, le=1000)] = Field(20, description="How many messages are read of each topic.")


class ImageRule(SampledRule):
    """Images and compressed images. Checks: image.black, image.overexposed, image.frozen, image.blurred."""

    min_brightness: Annotated[FiniteFloat, Field(ge=0, le=255)] = Field(
        12, description="A picture with a mean brightness below this is black (0 to 255)."
    )
    max_brightness: Annotated[FiniteFloat, Field(ge=0, le=255)] = Field(
        243, description="A picture with a mean brightness above this is overexposed (0 to 255)."
    )
    max_frozen: DurationNs = Field(
        2 * 10**9, description="Longest time with the same picture.", json_schema_extra={"default": "2s"}
    )
    min_sharpness: Positive | None = Field(
        None, description="Smallest variance of the Laplacian of a picture scaled to 320 pixels width; none by default."
    )
    allowed: Share = Field(0.1, description="Share of the samples that may be bad.")

    @model_validator(mode="after")
    def _is_a_range(self) -> Self:
        if self.max_brightness <= self.min_brightness:
            raise ValueError("max_brightness must be more than min_brightness")
        return self


class ImuRule(SampledRule):
    """Inertial measurements. Checks: imu.gravity, imu.tilt, imu.saturated, imu.constant."""

    gravity: Positive = Field(9.81, description="Magnitude of the acceleration while still, in m/s².")
    gravity_tolerance: Positive = Field(0.5, description="Largest deviation from it, in m/s².")
    up: Literal["x", "-x", "y", "-y", "z", "-z"] | None = Field(
        None, description="The axis that points up while still."
    )
    max_tilt: Positive = Field(15, description="Largest angle between that axis and gravity while still, in degrees.")
    max_acceleration: Positive | None = Field(None, description="Range of the accelerometer per axis, in m/s².")
    max_turn_rate: Positive | None = Field(None, description="Range of the gyroscope per axis, in rad/s.")


class PositionRule(SampledRule):
    """GNSS positions (NavSatFix). Checks: position.fix, position.jump."""

    min_fix: Share = Field(0.95, description="Smallest share of the samples with a fix.")
    max_speed: Positive = Field(100, description="Fastest change of position, in m/s.")


class PointCloudRule(SampledRule):
    """Point clouds. Checks: cloud.empty, cloud.range."""

    min_points: Annotated[int, Field(ge=1)] = Field(1, description="Fewest finite points in a cloud.")
    min_range: Annotated[FiniteFloat, Field(ge=0)] = Field(0, description="Nearest plausible point, in metres.")
    max_range: Positive | None = Field(None, description="Farthest plausible point, in metres.")
    allowed: Share = Field(0.05, description="Share of the clouds that may be empty, and of the points outside.")

    @model_validator(mode="after")
    def _is_a_range(self) -> Self:
        if self.max_range is not None and self.max_range <= self.min_range:
            raise ValueError("max_range must be more than min_range")
        return self


class TransformRule(Rule):
    """Transforms: all matching topics make one tree. Checks: transform.connected."""

    frames: Annotated[list[str], Field(max_length=1000)] = Field(
        default=[], description="Frames that must be connected; none: all that occur."
    )


class OdometryRule(SampledRule):
    """Odometry and poses. Checks: odometry.jump."""

    max_speed: Positive = Field(20, description="Fastest change of position, in m/s.")
    max_turn_rate: Positive = Field(10, description="Fastest change of orientation, in rad/s.")


class BatteryRule(SampledRule):
    """Battery states. Checks: battery.low."""

    min_percentage: Share | None = Field(None, description="Smallest state of charge.")
    min_voltage: Positive | None = Field(None, description="Smallest voltage, in V.")


class ValueRule(SampledRule):
    """Numeric fields of any message type. Checks: value.nan, value.constant, value.range."""

    fields: Annotated[list[Glob], Field(max_length=200)] = Field(
        default=["*"], description="Globs of dotted names of numeric fields, such as pose.position.*"
    )
    max_nan: Share = Field(0, description="Largest share of samples with NaN or infinity.")
    varies: StrictBool = Field(False, description="Each field must change.")
    min: FiniteFloat | None = Field(None, description="Smallest value.")
    max: FiniteFloat | None = Field(None, description="Largest value.")

    @model_validator(mode="after")
    def _is_a_range(self) -> Self:
        if self.min is not None and self.max is not None and self.max < self.min:
            raise ValueError("max is smaller than min")
        return self


class _OneOrSeveral:
    """Shows editors that a rule may stand alone instead of in a list."""

    def __get_pydantic_json_schema__(self, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        several = handler(core_schema)
        return {"anyOf": [several["items"], several, {"type": "null"}]}


R = TypeVar("R", bound=Rule)
# Of each glob, one rule or several.
RulesOf = Annotated[
    dict[
        Glob,
        Annotated[list[R], BeforeValidator(_one_or_several), Field(min_length=1, max_length=20), _OneOrSeveral()],
    ],
    Field(max_length=MAX_RULES),
]
When = dict[Annotated[str, Field(max_length=200)], JsonValue]


class Profile(Request):
    """Rules for the missions whose metadata match `when`, and the reference of their trajectories.

    `when` maps a metadata field to the value that it must have, to a glob for a text, or to a list of them of which
    one must match; without `when`, the profile applies to every mission.
    """

    name: Annotated[str, Field(min_length=1, max_length=128)] = "checks"
    when: Annotated[When, Field(max_length=50)] = {}
    reference: TrajectoryName | None = Field(
        None,
        description="The trajectory that estimates are compared with, unless the metadata of the mission name another.",
        examples=["/vicon/pose", "tf:map->base_link", "ground_truth.tum"],
    )
    files: RulesOf[FileRule] = {}
    recordings: RulesOf[RecordingRule] = {}
    topics: RulesOf[TopicRule] = {}
    clocks: RulesOf[ClockRule] = {}
    images: RulesOf[ImageRule] = {}
    imu: RulesOf[ImuRule] = {}
    positions: RulesOf[PositionRule] = {}
    point_clouds: RulesOf[PointCloudRule] = {}
    transforms: RulesOf[TransformRule] = {}
    odometry: RulesOf[OdometryRule] = {}
    batteries: RulesOf[BatteryRule] = {}
    values: RulesOf[ValueRule] = {}

    def mismatch(self, mission: "MatchedMetadata") -> str | None:
        """Return the first field of `when` that the metadata do not match; None if the profile applies to them."""
        return next((name for name, expected in self.when.items() if not mission.has(name, expected)), None)


class MatchedMetadata:
    """Metadata of a mission, which the conditions of profiles are compared with. Each field is prepared once.

    Globs are compared with texts of a bounded length: see `TextsToMatch`.
    """

    def __init__(self, metadata: Mapping[str, JsonValue]) -> None:
        self.metadata = metadata
        self._fields: dict[str, tuple[Set[Hashable], TextsToMatch]] = {}

    def has(self, name: str, expected: JsonValue) -> bool:
        """Return whether a field has a value that a profile's `when` names."""
        if name not in self.metadata:
            return False
        if name not in self._fields:
            values = list(_flat(self.metadata[name]))
            texts = TextsToMatch(value for value in values if isinstance(value, str))
            self._fields[name] = {_comparable(value) for value in values}, texts
        values_of_field, texts_of_field = self._fields[name]
        choices = list(_flat(expected))
        globs = dict.fromkeys(_globs(choices))
        plain = (choice for choice in choices if not isinstance(choice, str) or choice not in globs)
        return any(_comparable(choice) in values_of_field for choice in plain) or any(
            map(texts_of_field.any_matches, globs)
        )


def reference_of(document: "ChecksDocument | None", metadata: Mapping[str, JsonValue]) -> str | None:
    """Return the name of the reference trajectory of a mission; None if there is none.

    It is the metadata field `reference`, or else that of the first profile that applies to the mission and has one.
    """
    own = metadata.get("reference")
    if own is not None and (name := str(own).strip()):
        return name
    mission = MatchedMetadata(metadata)
    profiles = (profile for profile in document.profiles if profile.reference) if document is not None else ()
    return next((profile.reference for profile in profiles if profile.mismatch(mission) is None), None)


def _globs(values: Iterable[JsonValue]) -> Iterator[str]:
    return (value for value in values if isinstance(value, str) and is_glob(value))


def _flat(value: JsonValue) -> Iterator[JsonValue]:
    """Yield the values of lists in lists, or the value that is none."""
    if isinstance(value, list):
        for part in value:
            yield from _flat(part)
    else:
        yield value


def _comparable(value: JsonValue) -> Hashable:
    """Return what is equal for equal values: 1 is 1.0, but not true."""
    if isinstance(value, dict):
        return frozenset((name, _comparable(part)) for name, part in value.items())
    if isinstance(value, list):
        return tuple(map(_comparable, value))
    return isinstance(value, bool), value


_OF_DOCUMENT = "checks_document"
# Where pydantic found that a key itself is wrong.
_OF_KEY = "[key]"


class ChecksDocument(Request):
    """A `checks.yaml`."""

    version: Literal[1]
    profiles: Annotated[list[Profile], Field(min_length=1, max_length=MAX_PROFILES)]

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [profile.name for profile in self.profiles]
        for number, name in enumerate(names):
            if name in names[:number]:
                reason = f"two profiles are named {name!r}; give each a name of its own"
                raise PydanticCustomError(_OF_DOCUMENT, "{reason}", {"reason": reason, "at": ("profiles", number)})
        return self

    @model_validator(mode="after")
    def _conditions_have_a_limit(self) -> Self:
        count = 0
        for number, profile in enumerate(self.profiles):
            for name, expected in profile.when.items():
                values = list(_flat(expected))
                count += len(values)
                if count > MAX_VALUES:
                    raise _invalid_condition(number, f"all `when` together have more than {MAX_VALUES:,} values")
                try:
                    for glob in _globs(values):
                        check_rule_glob(glob)
                except ValueError as error:
                    raise _invalid_condition(number, str(error), name) from None
        return self


def _invalid_condition(number: int, reason: str, *names: str) -> PydanticCustomError:
    """Return the error of the `when` of a profile, or of one of its fields."""
    at = ("profiles", number, "when", *names)
    return PydanticCustomError(_OF_DOCUMENT, "{reason}", {"reason": reason, "at": at})


def json_schema() -> JsonSchemaValue:
    """Return the JSON schema of a `checks.yaml`, for editors (draft 2020-12)."""
    schema = ChecksDocument.model_json_schema()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": SCHEMA_ID,
        **schema,
        "title": "checks.yaml of Kleinkram",
    }


def read_checks(text: str) -> ChecksDocument:
    """Return the document of a `checks.yaml`.

    Raises YamlInvalid, with the line and column of the first problem.
    """
    if len(text) > MAX_CHECKS_CHARACTERS:
        raise YamlInvalid(line=1, column=1, reason=f"it has more than {MAX_CHECKS_CHARACTERS:,} characters")
    document = read_yaml(text)
    if document.value is None:
        raise YamlInvalid(line=1, column=1, reason="it is empty; begin with `version: 1` and `profiles:`")
    try:
        return ChecksDocument.model_validate(document.value)
    except ValidationError as error:
        raise _invalid(document, error) from error


def _invalid(document: Document, error: ValidationError) -> YamlInvalid:
    """Return the first problem in the order of the text, with its position and the path to it."""
    problems = []
    for problem in error.errors(include_url=False):
        path = _path_in(document.value, problem.get("ctx", {}).get("at", problem["loc"]))
        position = document.position(path)
        line, column = (position.line, position.column) if position else (1, 1)
        problems.append(YamlInvalid(line=line, column=column, reason=_reason(problem, path)))
    return min(problems, key=lambda invalid: (invalid.line, invalid.column))


def _path_in(value: JsonValue, location: tuple[int | str, ...]) -> Path:
    """Return the part of pydantic's location that is in the text: single rules are no list there."""
    path: list[int | str] = []
    for step in location:
        if isinstance(value, dict) and isinstance(step, str) and (step in value or step != _OF_KEY):
            path.append(step)
            value = value.get(step)
        elif isinstance(value, list) and isinstance(step, int) and step < len(value):
            path.append(step)
            value = value[step]
    return tuple(path)


def _reason(problem: ErrorDetails, path: Path) -> str:
    where = ".".join(str(step) for step in path)
    message = problem["ctx"]["reason"] if problem["type"] == _OF_DOCUMENT else message_of(problem)
    if problem["type"] == "extra_forbidden":
        known = _known_names(problem["loc"])
        close = difflib.get_close_matches(str(problem["loc"][-1]), known, n=1)
        hint = f"did you mean {close[0]!r}?" if close else f"there are {', '.join(known)}"
        message = f"{message}; {hint}"
    return f"{where}: {message}" if where else message


def _known_names(location: tuple[int | str, ...]) -> list[str]:
    """Return the keys that are allowed where pydantic found an unknown one."""
    model: type[BaseModel] = ChecksDocument
    for step in location[:-1]:
        field = model.model_fields.get(step) if isinstance(step, str) else None
        model = (_model_in(field.annotation) if field is not None else None) or model
    return [*model.model_fields]


def _model_in(annotation: object) -> type[BaseModel] | None:
    """Return the model that an annotation such as `dict[str, list[Rule]]` contains."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for part in get_args(annotation) if (model := _model_in(part)) is not None), None)
