"""Numbers of topics over time, as least and greatest value of each bin, and the tracks of positions and poses.

The memory is that of bins and of thinned tracks, whatever the number of messages. Times are log times.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from kleinkram.recordings import Channel, RawMessage, Topic
from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable, arrow_batches
from kleinkram.recordings.decoding.tables import TIME_COLUMNS, columns_of
from kleinkram.recordings.decoding.types import Array, Primitive, Type
from kleinkram.recordings.decoding.values import part
from kleinkram.recordings.recording import decode, decoder_of

BINS = 560
MAX_ELEMENTS = 12  # of an array, of which each is a curve
_MAX_FIELDS, _MAX_CURVES = 64, 96
_BATCH_MESSAGES, _BATCH_BYTES = 8192, 4 * 2**20
_MAX_TRACK = 20_000  # points of a track, beyond which every second one is dropped
_EARTH_RADIUS_M = 6_371_008.8
_PANELS_OF_UNKNOWN = 4
_CONSTANT_ROUND = 100

Unit = str
KNOWN_FIELDS: Mapping[str, Sequence[tuple[str, Unit]]] = {
    "Imu": (("linear_acceleration", "m/s²"), ("angular_velocity", "rad/s")),
    "Odometry": (("twist.twist.linear", "m/s"), ("twist.twist.angular", "rad/s"), ("pose.pose.position", "m")),
    "BatteryState": (("voltage", "V"), ("percentage", ""), ("current", "A"), ("temperature", "°C")),
    "JointState": (("position", "rad"), ("velocity", "rad/s"), ("effort", "N m")),
    "NavSatFix": (("altitude", "m"), ("status.status", "")),
    "LocationFix": (("altitude", "m"),),
    "Twist": (("linear", "m/s"), ("angular", "rad/s")),
    "TwistStamped": (("twist.linear", "m/s"), ("twist.angular", "rad/s")),
    "TwistWithCovarianceStamped": (("twist.twist.linear", "m/s"), ("twist.twist.angular", "rad/s")),
    "AccelStamped": (("accel.linear", "m/s²"), ("accel.angular", "rad/s²")),
    "Wrench": (("force", "N"), ("torque", "N m")),
    "WrenchStamped": (("wrench.force", "N"), ("wrench.torque", "N m")),
    "Temperature": (("temperature", "°C"),),
    "FluidPressure": (("fluid_pressure", "Pa"),),
    "RelativeHumidity": (("relative_humidity", ""),),
    "MagneticField": (("magnetic_field", "T"),),
    "Illuminance": (("illuminance", "lx"),),
    "Range": (("range", "m"),),
    "PoseStamped": (("pose.position", "m"),),
    "PoseWithCovarianceStamped": (("pose.pose.position", "m"),),
    "PoseInFrame": (("pose.position", "m"),),
    "PointStamped": (("point", "m"),),
    "TransformStamped": (("transform.translation", "m"),),
    "Vector3Stamped": (("vector", ""),),
    "sensor_combined": (("accelerometer_m_s2", "m/s²"), ("gyro_rad", "rad/s")),
    "vehicle_local_position": (("x", "m"), ("y", "m"), ("z", "m"), ("vx", "m/s"), ("vy", "m/s"), ("vz", "m/s")),
    "battery_status": (("voltage_v", "V"), ("current_a", "A"), ("remaining", "")),
    "vehicle_air_data": (("baro_alt_meter", "m"), ("baro_pressure_pa", "Pa")),
}
"""Of message types of ROS (without package) and PX4: the fields that are plotted, by interest, with their units."""
_PACKAGES = frozenset(("sensor_msgs", "geometry_msgs", "nav_msgs", "foxglove", "foxglove_msgs", ""))

NOT_PLOTTED = frozenset(("CameraInfo", "Log", "ParameterEvent"))
"""Types of messages whose numbers say nothing over time."""

_COUNTERS = frozenset(("seq", "sequence", "sequence_id", "sec", "secs", "nsec", "nsecs", "nanosec", "stamp"))

_POSITIONS = (
    ("pose.pose.position.x", "pose.pose.position.y"),
    ("pose.position.x", "pose.position.y"),
    ("transform.translation.x", "transform.translation.y"),
    ("position.x", "position.y"),
)
_PLANAR_POSES = frozenset(("Pose", "Pose2D"))
_GNSS = ("longitude", "latitude")


@dataclass(frozen=True)
class TimeSpan:
    """The time that all plots show, in nanoseconds of the log clock, both ends inclusive."""

    start_ns: int
    end_ns: int

    @property
    def seconds(self) -> float:
        """Its length in seconds; 1 for a moment."""
        return (self.end_ns - self.start_ns) / 1e9 or 1.0

    def offsets_s(self, times_ns: Iterable[int]) -> NDArray[np.float64]:
        """Return seconds since the start."""
        return np.array([(time_ns - self.start_ns) / 1e9 for time_ns in times_ns], np.float64)

    def bins(self, offsets_s: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the bin of each time; -1 outside of the span."""
        share = offsets_s / self.seconds
        places = np.minimum((share * BINS).astype(np.int64), BINS - 1)
        return np.where((share >= 0) & (share <= 1), places, -1)


class Curve:
    """One number over time: the least and the greatest value of each bin, NaN without any."""

    def __init__(self) -> None:
        self.low: NDArray[np.float64] = np.full(BINS, np.nan)
        self.high: NDArray[np.float64] = np.full(BINS, np.nan)
        self.count = 0
        self.not_finite = 0

    def add(self, bins: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Take values; those that are not finite are counted, those outside of the time span are left out."""
        is_finite = np.isfinite(values)
        self.not_finite += int(len(values) - is_finite.sum())
        usable = is_finite & (bins >= 0)
        self.count += int(usable.sum())
        np.fmin.at(self.low, bins[usable], values[usable])
        np.fmax.at(self.high, bins[usable], values[usable])

    @property
    def bounds(self) -> tuple[float, float]:
        """The least and the greatest value. There must be one."""
        return float(np.nanmin(self.low)), float(np.nanmax(self.high))


class Track:
    """Positions over time, thinned: [N] seconds, and [N, 2] x and y in metres or longitude and latitude in degrees."""

    def __init__(self, *, is_gnss: bool) -> None:
        self.is_gnss = is_gnss
        self.unusable = 0
        self.count = 0
        self._parts: list[NDArray[np.float64]] = []
        self._size, self._step, self._phase = 0, 1, 0

    def add(self, offsets_s: NDArray[np.float64], xy: NDArray[np.float64], is_fix: NDArray[np.bool_]) -> None:
        """Take positions. Those that are not finite, on no place of the earth, or without fix are counted."""
        usable = np.isfinite(xy).all(axis=1) & is_fix
        if self.is_gnss:
            usable &= (np.abs(xy) <= (180, 90)).all(axis=1) & xy.any(axis=1)
        self.unusable += int(len(xy) - usable.sum())
        self.count += int(usable.sum())
        rows = np.column_stack([offsets_s, xy])[usable]
        thin = rows[(-self._phase) % self._step :: self._step]
        self._phase = (self._phase + len(rows)) % self._step
        self._parts.append(thin)
        self._size += len(thin)
        while self._size > _MAX_TRACK:
            self._parts = [np.concatenate(self._parts)[::2]]
            self._size = len(self._parts[0])
            self._step, self._phase = 2 * self._step, 0

    @property
    def rows(self) -> NDArray[np.float64]:
        """Seconds, x and y [N, 3], in the order of time."""
        rows = np.concatenate([np.empty((0, 3)), *self._parts])
        return rows[np.argsort(rows[:, 0], kind="stable")]

    def metres(self, origin: tuple[float, float]) -> NDArray[np.float64]:
        """Return x and y [N, 2] in metres; of GNSS, east and north of an origin (longitude, latitude)."""
        xy = self.rows[:, 1:]
        return east_north(xy, origin) if self.is_gnss else xy


def east_north(degrees: NDArray[np.float64], origin: tuple[float, float]) -> NDArray[np.float64]:
    """Return metres east and north of an origin, on the tangent plane of a sphere: to about 0.5 % of the distance."""
    longitude = (degrees[:, 0] - origin[0] + 180) % 360 - 180
    east = np.radians(longitude) * np.cos(np.radians(origin[1]))
    return np.column_stack([east, np.radians(degrees[:, 1] - origin[1])]) * _EARTH_RADIUS_M


def short_type(message_type: str) -> str:
    """Return the name of a type without its package."""
    return message_type.replace(".", "/").rpartition("/")[2]


def numeric_fields(topic: Topic) -> list[str] | None:
    """Return the numbers in the messages of a topic, as names of columns; None where only the messages say.

    Raises DecodeError: they cannot be decoded.
    """
    if short_type(topic.message_type) in NOT_PLOTTED:
        return []
    decoder = decoder_of(topic.message_encoding, topic.schema)
    if isinstance(decoder, Undecodable):
        raise DecodeError(decoder.type_name, decoder.reason)
    return _numeric_fields(decoder)


def _numeric_fields(decoder: Decoder) -> list[str] | None:
    if decoder.struct is None:
        return None
    columns = columns_of(decoder.struct, None)
    names = [column.name for column in columns if _is_numeric(column.kind) and not _is_bookkeeping(column.name)]
    return names[:_MAX_FIELDS]


def _is_bookkeeping(name: str) -> bool:
    """Return whether a field is a time, a counter or a covariance."""
    leaf = name.rpartition(".")[2].lower()
    return leaf in _COUNTERS or leaf.startswith("timestamp") or "covariance" in leaf


def _is_numeric(kind: Type) -> bool:
    if isinstance(kind, Array):
        is_binary = kind.length is None and isinstance(kind.element, Primitive) and kind.element.name == "uint8"
        return isinstance(kind.element, Primitive) and bool(kind.element.code) and not is_binary
    return isinstance(kind, Primitive) and bool(kind.code)


@dataclass
class _Waiting:
    """Messages of one channel that are not decoded yet."""

    channel: Channel
    messages: list[tuple[int, int, bytes]] = field(default_factory=list)
    size_bytes: int = 0


class TopicNumbers:
    """The numbers of one topic over time."""

    def __init__(self, topic: str, message_type: str, span: TimeSpan) -> None:
        self.topic = topic
        self.message_type = message_type
        self.curves: dict[str, Curve] = {}
        self.track: Track | None = None
        self.element_names: tuple[str, ...] = ()
        self.failed = 0
        self.error = ""
        self._span = span
        self._waiting: dict[int, _Waiting] = {}

    def add(self, message: RawMessage) -> None:
        """Take a message."""
        waiting = self._waiting.get(id(message.channel))
        if waiting is None:
            waiting = self._waiting[id(message.channel)] = _Waiting(message.channel)
            self.element_names = self.element_names or _names_in(message)
        waiting.messages.append((message.log_time_ns, message.publish_time_ns, message.data))
        waiting.size_bytes += len(message.data)
        if len(waiting.messages) >= _BATCH_MESSAGES or waiting.size_bytes >= _BATCH_BYTES:
            self._decode(waiting)

    def finish(self) -> None:
        """Decode what waits. Call it once all messages were added."""
        for waiting in self._waiting.values():
            self._decode(waiting)
        self._waiting.clear()

    def _decode(self, waiting: _Waiting) -> None:
        messages, waiting.messages, waiting.size_bytes = waiting.messages, [], 0
        decoder = decoder_of(waiting.channel.message_encoding, waiting.channel.schema)
        if isinstance(decoder, Undecodable):
            self.failed, self.error = self.failed + len(messages), self.error or decoder.reason
            return
        fields = _numeric_fields(decoder)
        if not messages or fields == []:
            return
        offsets_s = self._span.offsets_s(log_ns for log_ns, _, _ in messages)
        begin = 0
        try:
            for batch in arrow_batches(decoder, messages, fields=fields, notice=self._note):
                self._add_batch(offsets_s[begin : begin + batch.num_rows], batch)
                begin += batch.num_rows
        except (DecodeError, OverflowError, pa.ArrowException) as error:  # values that no column can hold
            self.failed += len(messages) - begin
            self.error = self.error or str(error)

    def _note(self, _log_time_ns: int, error: DecodeError) -> None:
        self.failed += 1
        self.error = self.error or str(error)

    def _add_batch(self, offsets_s: NDArray[np.float64], batch: pa.RecordBatch) -> None:
        bins = self._span.bins(offsets_s)
        numbers: dict[str, NDArray[np.float64]] = {}
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if name not in TIME_COLUMNS and not _is_bookkeeping(name):
                numbers.update(_numbers_of(name, column))
        for name, values in numbers.items():
            if name in self.curves or len(self.curves) < _MAX_CURVES:
                self.curves.setdefault(name, Curve()).add(bins, values)
        self._add_track(offsets_s, numbers)

    def _add_track(self, offsets_s: NDArray[np.float64], numbers: Mapping[str, NDArray[np.float64]]) -> None:
        pairs = (_GNSS, *_POSITIONS, *((("x", "y"),) if short_type(self.message_type) in _PLANAR_POSES else ()))
        pair = next((pair for pair in pairs if all(name in numbers for name in pair)), None)
        if pair is None:
            return
        if self.track is None:
            self.track = Track(is_gnss=pair is _GNSS)
        status = numbers.get("status.status") if pair is _GNSS else None
        is_fix = np.ones(len(offsets_s), bool) if status is None else ~(status < 0)
        self.track.add(offsets_s, np.column_stack([numbers[name] for name in pair]), is_fix)


def _names_in(message: RawMessage) -> tuple[str, ...]:
    """Return the names of joints."""
    if not message.schema.name.endswith("JointState"):
        return ()
    try:
        names = part(decode(message), "name")
    except DecodeError:
        return ()
    return tuple(map(str, names)) if isinstance(names, list) else ()


def _numbers_of(name: str, column: pa.Array) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield the values of a column of numbers, or of the first elements of one of arrays; missing ones are NaN."""
    kind = column.type
    if _is_number_type(kind):
        yield name, _floats(column)
    elif (pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind)) and _is_number_type(kind.value_type):
        lengths = np.nan_to_num(_floats(column.value_lengths())).astype(np.int64)
        values = _floats(column.flatten())
        starts = np.cumsum(lengths) - lengths
        for element in range(min(MAX_ELEMENTS, int(lengths.max(initial=0)))):
            has_one = lengths > element
            taken = np.full(len(lengths), np.nan)
            taken[has_one] = values[starts[has_one] + element]
            yield f"{name}[{element}]", taken


def _is_number_type(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind))


def _floats(column: pa.Array) -> NDArray[np.float64]:
    """Return numbers without pandas, which `to_numpy` would import (60 MB, half a second)."""
    numbers = column.cast(pa.float64(), safe=False).fill_null(np.nan)
    values = np.frombuffer(numbers.buffers()[1] or b"", np.float64)
    return values[numbers.offset : numbers.offset + len(numbers)]


class Panel(NamedTuple):
    """One plot: curves of one field or of the parts of one, by name.

    `priority`: of the plots of its topic, the first ones count most; then by the interest of the topic.
    """

    topic: str
    field: str
    unit: Unit
    curves: tuple[tuple[str, Curve], ...]
    priority: tuple[int, int]


def panels_of(numbers: TopicNumbers) -> list[Panel]:
    """Return the plots that a topic could have; fields without a finite value have none."""
    curves = {name: curve for name, curve in numbers.curves.items() if curve.count}
    kind = short_type(numbers.message_type)
    package = numbers.message_type.replace(".", "/").partition("/")[0] if kind != numbers.message_type else ""
    known = KNOWN_FIELDS.get(kind) if package in _PACKAGES else None
    rank = list(KNOWN_FIELDS).index(kind) if known else len(KNOWN_FIELDS)
    fields = known or [(name, "") for name in dict.fromkeys(_group_of(name, curves) for name in curves)]
    panels = []
    for name, unit in fields:
        own = {other: curve for other, curve in curves.items() if _is_part(other, name)}
        if own:
            entries = tuple((_label(other, name, numbers.element_names), curve) for other, curve in own.items())
            panels.append((name, unit, entries))
    panels.sort(key=lambda panel: known is None and _is_constant(panel[2]))
    limit = len(panels) if known else _PANELS_OF_UNKNOWN
    return [
        Panel(numbers.topic, name, unit, entries, (number + _CONSTANT_ROUND * _is_constant(entries), rank))
        for number, (name, unit, entries) in enumerate(panels[:limit])
    ]


def _is_part(name: str, group: str) -> bool:
    return name == group or name.startswith((f"{group}.", f"{group}["))


def _group_of(name: str, curves: Mapping[str, Curve]) -> str:
    """Return the field that is plotted with this one in it: an array, or a vector of x, y and z."""
    if name.endswith("]"):
        return name.rpartition("[")[0]
    parent, _, axis = name.rpartition(".")
    return parent if parent and axis in "xyzw" and f"{parent}.x" in curves else name


def _label(name: str, group: str, element_names: Sequence[str]) -> str:
    rest = name[len(group) :].lstrip(".")
    if rest.startswith("[") and rest[1:-1].isdigit() and int(rest[1:-1]) < len(element_names):
        return element_names[int(rest[1:-1])]
    return rest


def _is_constant(entries: Sequence[tuple[str, Curve]]) -> bool:
    return all(curve.bounds[0] == curve.bounds[1] for _, curve in entries)


def most_interesting(panels: Sequence[Panel], limit: int) -> list[Panel]:
    """Return at most `limit` plots, so that every topic has one before any has two; by topics and fields."""
    chosen = sorted(panels, key=lambda panel: (*panel.priority, panel.topic))[:limit]
    return sorted(chosen, key=lambda panel: (panel.priority[1], panel.topic, panel.priority[0]))
