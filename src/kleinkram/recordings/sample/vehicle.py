"""Simulates the sensors of a small vehicle that drives in a circle; the same seed gives the same bytes.

The sensors are consistent (GPS, odometry, tf and IMU agree), noise is added, pictures can be decoded. Large messages
are made of precomputed scans and noise, so that a gigabyte takes seconds.
"""

from __future__ import annotations

import heapq
import math
import random
import struct
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from kleinkram.recordings.sample.messages import Encoding, Item, Layout, diagonal, header, variable

START_NS = 1_714_550_400_000_000_000
RADIUS_M = 25.0
SPEED_M_S = 2.0
TURN_RAD_S = SPEED_M_S / RADIUS_M
GRAVITY_M_S2 = 9.81
LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M = 47.4076, 8.5072, 540.0
_METRES_PER_DEGREE = 111_320.0
_JITTER = 0.02
_COLUMNS, _ROWS, _PICTURES = 80, 60, 8
_MIN_SCANS, _MAX_SCANS, _SCAN_BYTES = 4, 256, 2 * 2**20
_RINGS, _POINT_BYTES = 16, 16
_NOISE_BYTES = 4 * 2**20
_FLOAT32 = 7

Maker = Callable[[int, float, int], bytes]
"""Makes a message from its number, the seconds since the start, and the stamp for its header."""


@dataclass(frozen=True)
class TopicGap:
    """A topic has no messages from `start_s` on for `duration_s`."""

    topic: str
    start_s: float
    duration_s: float


@dataclass(frozen=True)
class Faults:
    """Faults of a sample mission. `truncate_to`: remaining share of each data file, such as 0.6."""

    dropped_topic: str | None = None
    gap: TopicGap | None = None
    truncate_to: float | None = None


class Stream(NamedTuple):
    """One topic: `message_type` as ROS 1 spells it; a rate of 0 means one message at the start."""

    topic: str
    message_type: str
    rate_hz: float
    latency_ns: int


class RecordedMessage(NamedTuple):
    """One recorded message."""

    log_time_ns: int
    order: int
    topic: str
    payload: bytes


STREAMS = (
    Stream("/tf_static", "tf2_msgs/TFMessage", 0, 100_000),
    Stream("/camera/image/compressed", "sensor_msgs/CompressedImage", 10, 30_000_000),
    Stream("/lidar/points", "sensor_msgs/PointCloud2", 10, 50_000_000),
    Stream("/imu/data", "sensor_msgs/Imu", 200, 1_000_000),
    Stream("/gps/fix", "sensor_msgs/NavSatFix", 5, 80_000_000),
    Stream("/odom", "nav_msgs/Odometry", 50, 3_000_000),
    Stream("/tf", "tf2_msgs/TFMessage", 50, 3_500_000),
)


class Vehicle:
    """One drive. `camera_bytes` and `lidar_points` set the size of each picture and scan."""

    def __init__(self, *, seed: int, encoding: Encoding, camera_bytes: int, lidar_points: int, faults: Faults) -> None:
        self.streams = tuple(stream for stream in STREAMS if stream.topic != faults.dropped_topic)
        self._seed = seed
        self._encoding = encoding
        self._faults = faults
        self._makers: dict[str, Maker] = {
            "/tf_static": self._tf_static(),
            "/camera/image/compressed": self._camera(camera_bytes),
            "/lidar/points": self._lidar(lidar_points),
            "/imu/data": self._imu(),
            "/gps/fix": self._gps(),
            "/odom": self._odometry(),
            "/tf": self._tf(),
        }

    def drive(self, duration_s: float | None) -> Iterator[RecordedMessage]:
        """Yield the messages in the order in which they are recorded; without end if `duration_s` is None."""
        ticks = heapq.merge(*(self._ticks(number, stream) for number, stream in enumerate(self.streams)))
        for recorded_ns, order, k, true_ns in ticks:
            seconds = true_ns / 1e9
            if duration_s is not None and seconds >= duration_s:
                return
            topic = self.streams[order].topic
            payload = self._makers[topic](k, seconds, START_NS + true_ns)
            yield RecordedMessage(START_NS + recorded_ns, order, topic, payload)

    def _ticks(self, order: int, stream: Stream) -> Iterator[tuple[int, int, int, int]]:
        """Yield (recorded, order, number, true time) of one topic, in nanoseconds since the start."""
        if stream.rate_hz == 0:
            yield stream.latency_ns, order, 0, 0
            return
        chance = self._random(stream.topic)
        period_ns = 1e9 / stream.rate_hz
        gap = self._faults.gap
        silent_s = (gap.start_s, gap.start_s + gap.duration_s) if gap and gap.topic == stream.topic else (0.0, 0.0)
        k = 0
        while True:
            true_ns = round((k + chance.random() * _JITTER) * period_ns)
            if not silent_s[0] <= true_ns / 1e9 < silent_s[1]:
                yield true_ns + stream.latency_ns, order, k, true_ns
            k += 1

    def _random(self, purpose: str) -> random.Random:
        return random.Random(f"{self._seed} {purpose}")  # noqa: S311 - repeatable samples, not secrets

    def _layout(self, *items: list[Item]) -> Layout:
        return Layout([item for part in items for item in part], self._encoding)

    def _camera(self, size_bytes: int) -> Maker:
        layout = self._layout(header("camera", self._encoding), [("s", "jpeg"), ("I", None)])
        noise = self._random("camera noise").randbytes(min(_NOISE_BYTES, max(size_bytes, 1) * 16))
        pictures = [_picture(number) for number in range(_PICTURES)]

        def make(k: int, _seconds: float, stamp_ns: int) -> bytes:
            picture = pictures[k % _PICTURES]
            missing = max(0, size_bytes - len(picture))
            at = k * missing % max(1, len(noise) - missing)
            picture = padded(picture, noise[at : at + missing])
            return layout.pack(*_stamp(stamp_ns), len(picture)) + picture

        return make

    def _lidar(self, points: int) -> Maker:
        fields: list[Item] = [("I", 4)]
        for number, name in enumerate(("x", "y", "z", "intensity")):
            fields += [("s", name), ("I", number * 4), ("B", _FLOAT32), ("I", 1)]
        size = points * _POINT_BYTES
        layout = self._layout(
            header("lidar", self._encoding),
            [("I", 1), ("I", points), *fields, ("B", 0), ("I", _POINT_BYTES), ("I", size), ("I", size)],
        )
        chance = self._random("lidar")
        # Enough of them that no compressor finds one again within its window.
        scans = [_scan(chance, points) for _ in range(max(_MIN_SCANS, min(_MAX_SCANS, _SCAN_BYTES // size)))]
        is_dense = b"\x01"
        return lambda k, _s, stamp_ns: b"".join((layout.pack(*_stamp(stamp_ns)), scans[k % len(scans)], is_dense))

    def _measurement(self, layout: Layout, measure: Callable[[float], tuple[float, ...]]) -> Maker:
        """Make messages of a stamp and the values at a time."""
        return lambda _k, seconds, stamp_ns: layout.pack(*_stamp(stamp_ns), *measure(seconds))

    def _imu(self) -> Maker:
        layout = self._layout(
            header("imu", self._encoding), variable(4), diagonal(3, 1e-4), variable(3), diagonal(3, 1e-6), variable(3),
            diagonal(3, 1e-3),
        )  # fmt: skip
        noise = self._random("imu noise").gauss

        def measure(seconds: float) -> tuple[float, ...]:
            angular = (noise(0, 1e-3), noise(0, 1e-3), TURN_RAD_S + noise(0, 1e-3))
            linear = (noise(0, 0.03), SPEED_M_S * TURN_RAD_S + noise(0, 0.03), GRAVITY_M_S2 + noise(0, 0.03))
            return (*_orientation(seconds), *angular, *linear)

        return self._measurement(layout, measure)

    def _gps(self) -> Maker:
        status: list[Item] = [("b", 0), ("H", 1)]
        layout = self._layout(header("gps", self._encoding), status, variable(3), diagonal(3, 0.04), [("B", 2)])
        noise = self._random("gps noise").gauss
        metres_per_degree_east = _METRES_PER_DEGREE * math.cos(math.radians(LATITUDE_DEG))

        def measure(seconds: float) -> tuple[float, ...]:
            east, north = _position(seconds)
            latitude = LATITUDE_DEG + (north + noise(0, 0.2)) / _METRES_PER_DEGREE
            longitude = LONGITUDE_DEG + (east + noise(0, 0.2)) / metres_per_degree_east
            return latitude, longitude, ALTITUDE_M + noise(0, 0.4)

        return self._measurement(layout, measure)

    def _odometry(self) -> Maker:
        twist: list[Item] = [("d", SPEED_M_S), *[("d", 0.0)] * 4, ("d", TURN_RAD_S)]
        layout = self._layout(
            header("odom", self._encoding), [("s", "base_link")], variable(7), diagonal(6, 1e-3), twist,
            diagonal(6, 1e-3),
        )  # fmt: skip
        noise = self._random("odometry noise").gauss

        def measure(seconds: float) -> tuple[float, ...]:
            east, north = _position(seconds)
            return (east + noise(0, 0.01), north + noise(0, 0.01), 0.0, *_orientation(seconds))

        return self._measurement(layout, measure)

    def _tf(self) -> Maker:
        layout = self._layout([("I", 1)], header("odom", self._encoding), [("s", "base_link")], variable(7))
        return self._measurement(layout, lambda seconds: (*_position(seconds), 0.0, *_orientation(seconds)))

    def _tf_static(self) -> Maker:
        mounts = {"camera": (0.3, 0.0, 0.4), "lidar": (0.0, 0.0, 0.6), "imu": (0.0, 0.0, 0.1), "gps": (-0.2, 0.0, 0.5)}
        items: list[Item] = [("I", len(mounts))]
        for name, mount in mounts.items():
            level: list[Item] = [("d", 0.0), ("d", 0.0), ("d", 0.0), ("d", 1.0)]
            items += [*header("base_link", self._encoding), ("s", name), *(("d", metres) for metres in mount), *level]
        layout = self._layout(items)
        return lambda _k, _seconds, stamp_ns: layout.pack(*_stamp(stamp_ns) * len(mounts))


def _stamp(stamp_ns: int) -> tuple[int, int]:
    return divmod(stamp_ns, 1_000_000_000)


def _position(seconds: float) -> tuple[float, float]:
    """Return metres east and north of the centre of the circle."""
    angle = TURN_RAD_S * seconds
    return RADIUS_M * math.cos(angle), RADIUS_M * math.sin(angle)


def _orientation(seconds: float) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of the vehicle's heading."""
    half = (TURN_RAD_S * seconds + math.pi / 2) / 2
    return 0.0, 0.0, math.sin(half), math.cos(half)


def _picture(number: int) -> bytes:
    centre = _COLUMNS * (number + 0.5) / _PICTURES
    rows = range(_ROWS)
    return mosaic_jpeg(
        [[235 if math.hypot(x - centre, y - _ROWS / 2) < 9 else 40 + 2 * y // 1 for x in range(_COLUMNS)] for y in rows]
    )


def _scan(chance: random.Random, points: int) -> bytes:
    """Return x, y, z, intensity (float32) of a scan of a hall with 16 rings; metres, frame lidar."""
    flat = array("f")
    noise = chance.random
    for number in range(points):
        angle = 2 * math.pi * number / max(1, points)
        tilt = math.radians(2 * (number % _RINGS) - _RINGS + 1)
        distance = 8.0 + 2.0 * math.cos(4 * angle) + 0.04 * noise()
        level = distance * math.cos(tilt)
        flat.extend((level * math.cos(angle), level * math.sin(angle), distance * math.sin(tilt), 255 * noise()))
    return flat.tobytes()


_BLOCK = 8
# Annex K.3 of ITU-T T.81, luminance DC: how many codes of each length, and the categories in their order.
_DC_LENGTHS = bytes([0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0])
_DC_CATEGORIES = bytes(range(12))
# The only AC code is "end of block".
_AC_LENGTHS = bytes([1] + [0] * 15)
_AC_SYMBOLS = b"\x00"
_MAX_IN_SEGMENT = 65533
_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"


def mosaic_jpeg(tiles: Sequence[Sequence[int]]) -> bytes:
    """Return a grey baseline JPEG of 8x8 tiles, DC coefficients only; `tiles`: rows of brightness, 0 to 255."""
    frame = struct.pack(">BHHBBBB", 8, len(tiles) * _BLOCK, len(tiles[0]) * _BLOCK, 1, 1, 0x11, 0)
    segments = (
        _segment(0xDB, b"\x00" + bytes([_BLOCK] * 64)),
        _segment(0xC0, frame),
        _segment(0xC4, b"\x00" + _DC_LENGTHS + _DC_CATEGORIES),
        _segment(0xC4, b"\x10" + _AC_LENGTHS + _AC_SYMBOLS),
        _segment(0xDA, bytes([1, 1, 0x00, 0, 63, 0])),
    )
    codes: list[str] = []
    code = 0
    for length, count in enumerate(_DC_LENGTHS, start=1):
        codes += [format(code + number, f"0{length}b") for number in range(count)]
        code = (code + count) << 1
    bits: list[str] = []
    before = 0
    for brightness in (brightness for row in tiles for brightness in row):
        # The DC coefficient is 8 times the mean above 128; quantised by 8, it is that mean itself.
        difference, before = brightness - 128 - before, brightness - 128
        category = abs(difference).bit_length()
        value = difference if difference > 0 else difference + (1 << category) - 1
        bits.append(codes[category] + (format(value, f"0{category}b") if category else "") + "0")
    text = "".join(bits)
    text += "1" * (-len(text) % 8)
    scan = int(text, 2).to_bytes(len(text) // 8, "big").replace(b"\xff", b"\xff\x00")
    return b"".join((_SOI, *segments, scan, _EOI))


def padded(jpeg: bytes, noise: bytes) -> bytes:
    """Return the same picture with `noise` in comment segments, so that it has the size of a real camera's."""
    comments = [_segment(0xFE, noise[at : at + _MAX_IN_SEGMENT]) for at in range(0, len(noise), _MAX_IN_SEGMENT)]
    return b"".join((_SOI, *comments, jpeg[len(_SOI) :]))


def _segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body
