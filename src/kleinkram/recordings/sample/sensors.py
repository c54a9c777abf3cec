"""The sensors of the sample robots: each makes the messages of one topic, with the defects that it has.

The sensors of a robot are consistent: GNSS, odometry, transforms and IMU agree, and lidars and cameras see the same
scene from where the robot is. Noise depends on the number of the message, so that two recorders of a topic record
the same bytes.
"""

from __future__ import annotations

import math
import random
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

from kleinkram.recordings.sample import jpeg, scene
from kleinkram.recordings.sample.defects import Defect
from kleinkram.recordings.sample.messages import Encoding, Item, Layout, diagonal, header, variable
from kleinkram.recordings.sample.motion import Motion, MotionState, Mount

START_NS = 1_714_550_400_000_000_000
GRAVITY_M_S2 = 9.81
_LATITUDE_DEG, _LONGITUDE_DEG, _ALTITUDE_M = 47.4076, 8.5072, 540.0
_METRES_PER_DEGREE = 111_320.0
_NOISE_BYTES = 4 * 2**20
_NOISE_VALUES = 4096
_POINT_BYTES = 16
_FLOAT32 = 7
_JUMP_EVERY, _JUMP_M = 4, 300.0
_TILT_RAD = math.radians(30)
_GRAVITY_FACTOR = 1.1
_IMU_LIMIT_M_S2 = 156.96
_BLACK, _WHITE = 2, 252
_NO_FIX, _FIX = -1, 0
_IMPOSSIBLE = 1e6

Maker = Callable[[int, float, int], bytes]
"""Makes a message from its number, the seconds since the start, and the stamp for its header."""


@dataclass(frozen=True)
class SensorContext:
    """What a sensor is made with. Defects that begin during the drive begin at `onset_s`."""

    topic: str
    seed: int
    encoding: Encoding
    motion: Motion
    defects: frozenset[Defect]
    onset_s: float

    def seed_of(self, purpose: str) -> str:
        """Return the seed of the random numbers for a purpose: always the same."""
        return f"{self.seed} {self.topic} {purpose}"

    def layout(self, *items: list[Item]) -> Layout:
        """Compile a layout from its parts."""
        return Layout([item for part in items for item in part], self.encoding)

    def has(self, defect: Defect, seconds: float = math.inf) -> bool:
        """Return whether the sensor has a defect at a time."""
        return defect in self.defects and seconds >= self.onset_s

    @cached_property
    def _values(self) -> list[float]:
        return _noise_table(self.seed_of("noise"))

    def noise(self, number: int, index: int) -> float:
        """Return a normally distributed value for one quantity of a message."""
        return self._values[(number * 7 + index) % _NOISE_VALUES]


# The tables below depend on their seeds alone, and take a quarter of the time of a drive of a few seconds: the files of
# a mission, and missions of one seed with different defects, share them.


@lru_cache(maxsize=32)
def _noise_table(seed: str) -> list[float]:
    chance = _random(seed)
    return [chance.gauss(0, 1) for _ in range(_NOISE_VALUES)]


@lru_cache(maxsize=8)
def _lidar_view(points: int, seed: str) -> scene.LidarView:
    return scene.LidarView(points, _random(seed))


@lru_cache(maxsize=32)
def _camera_view(tiles: tuple[int, int], seed: str) -> scene.CameraView:
    return scene.CameraView(*tiles, _random(seed))


def _random(seed: str) -> random.Random:
    return random.Random(seed)  # noqa: S311 - repeatable samples, not secrets


SensorFactory = Callable[[SensorContext], Maker]


def camera(context: SensorContext, *, frame: str, tiles: tuple[int, int], size_bytes: int, mount: Mount) -> Maker:
    """Make JPEG pictures of `tiles` (columns, rows), each padded to about `size_bytes`."""
    layout = context.layout(header(frame, context.encoding), [("s", "jpeg"), ("I", None)])
    noise = _random(context.seed_of("padding")).randbytes(min(_NOISE_BYTES, max(size_bytes, 1) * 16))
    view = _camera_view(tiles, context.seed_of("picture"))
    frozen: list[bytes] = []

    def picture(number: int, seconds: float) -> bytes:
        if context.has(Defect.frozen_camera, seconds) and frozen:
            return frozen[0]
        brightness = view.picture(number, mount.pose(context.motion(seconds)))
        if context.has(Defect.black_camera, seconds):
            brightness = bytes(_BLACK + (tile & 1) for tile in brightness)
        if context.has(Defect.overexposed_camera, seconds):
            brightness = bytes(_WHITE + (tile & 1) for tile in brightness)
        if context.has(Defect.blurred_camera, seconds):
            brightness = scene.blurred(brightness, view.columns)
        encoded = jpeg.mosaic_jpeg(brightness, view.columns)
        missing = max(0, size_bytes - len(encoded))
        at = number * missing % max(1, len(noise) - missing)
        encoded = jpeg.padded(encoded, noise[at : at + missing])
        if context.has(Defect.frozen_camera, seconds):
            frozen.append(encoded)
        return encoded

    def make(number: int, seconds: float, stamp_ns: int) -> bytes:
        encoded = picture(number, seconds)
        return layout.pack(*_stamp(stamp_ns), len(encoded)) + encoded

    return make


def lidar(context: SensorContext, *, frame: str, points: int, mount: Mount) -> Maker:
    """Make point clouds of x, y, z and intensity (float32), of 16 rings."""
    view = _lidar_view(points, context.seed_of("lidar"))
    fields: list[Item] = [("I", 4)]
    for number, name in enumerate(("x", "y", "z", "intensity")):
        fields += [("s", name), ("I", number * 4), ("B", _FLOAT32), ("I", 1)]
    layout = context.layout(
        header(frame, context.encoding), [("I", 1), ("I", None), *fields, ("B", 0), ("I", _POINT_BYTES)],
        [("I", None), ("I", None)],
    )  # fmt: skip
    is_dense = b"\x01"

    def make(number: int, seconds: float, stamp_ns: int) -> bytes:
        if context.has(Defect.empty_clouds, seconds):
            scan = array("f")
        else:
            scan = view.scan(number, mount.pose(context.motion(seconds)))
        if context.has(Defect.far_points, seconds):
            scan = scene.with_far_points(scan)
        size = len(scan) * scan.itemsize
        return b"".join((layout.pack(*_stamp(stamp_ns), size // _POINT_BYTES, size, size), scan.tobytes(), is_dense))

    return make


def imu(context: SensorContext, *, frame: str) -> Maker:
    """Make orientation, angular velocity and linear acceleration; z up."""
    layout = context.layout(
        header(frame, context.encoding), variable(4), diagonal(3, 1e-4), variable(3), diagonal(3, 1e-6), variable(3),
        diagonal(3, 1e-3),
    )  # fmt: skip
    gravity = GRAVITY_M_S2 * (_GRAVITY_FACTOR if context.has(Defect.wrong_gravity) else 1)
    tilt_rad = _TILT_RAD if context.has(Defect.tilted_gravity) else 0.0

    def make(number: int, seconds: float, stamp_ns: int) -> bytes:
        at = 0 if context.has(Defect.constant_imu) else number
        state = context.motion(0.0 if context.has(Defect.constant_imu) else seconds)
        angular = (
            1e-3 * context.noise(at, 0),
            1e-3 * context.noise(at, 1),
            state.turn_rad_s + 1e-3 * context.noise(at, 2),
        )
        noise = 0.03 + state.shaking_m_s2
        left, up = state.left_m_s2, state.up_m_s2 + gravity
        if tilt_rad:
            left, up = (
                left * math.cos(tilt_rad) + up * math.sin(tilt_rad),
                up * math.cos(tilt_rad) - left * math.sin(tilt_rad),
            )
        forward = state.forward_m_s2 + noise * context.noise(at, 3)
        if context.has(Defect.saturated_imu, seconds):
            forward = _IMU_LIMIT_M_S2 if number % 2 else -_IMU_LIMIT_M_S2
        linear = forward, left + noise * context.noise(at, 4), up + noise * context.noise(at, 5)
        return layout.pack(*_stamp(stamp_ns), *state.orientation, *angular, *linear)

    return make


def gnss(context: SensorContext, *, frame: str) -> Maker:
    """Make positions; the origin of frame odom is in Zurich."""
    layout = context.layout(
        header(frame, context.encoding), [("b", None), ("H", 1)], variable(3), diagonal(3, 0.04), [("B", 2)]
    )
    metres_per_degree_east = _METRES_PER_DEGREE * math.cos(math.radians(_LATITUDE_DEG))

    def make(number: int, seconds: float, stamp_ns: int) -> bytes:
        state = context.motion(seconds)
        north = state.north_m + 0.2 * context.noise(number, 0)
        east = state.east_m + 0.2 * context.noise(number, 1) + _jump_m(context, Defect.position_jump, number, seconds)
        altitude = _ALTITUDE_M + state.up_m + 0.4 * context.noise(number, 2)
        status = _NO_FIX if context.has(Defect.no_fix, seconds) else _FIX
        latitude, longitude = _LATITUDE_DEG + north / _METRES_PER_DEGREE, _LONGITUDE_DEG + east / metres_per_degree_east
        return layout.pack(*_stamp(stamp_ns), status, latitude, longitude, altitude)

    return make


def odometry(context: SensorContext, *, child_frame: str) -> Maker:
    """Make poses and velocities in frame odom."""
    layout = context.layout(
        header("odom", context.encoding), [("s", child_frame)], variable(7), diagonal(6, 1e-3), variable(1),
        [("d", 0.0)] * 4, variable(1), diagonal(6, 1e-3),
    )  # fmt: skip

    def make(number: int, seconds: float, stamp_ns: int) -> bytes:
        state = context.motion(seconds)
        return layout.pack(
            *_stamp(stamp_ns), *_noisy_pose(context, number, seconds, state), state.speed_m_s, state.turn_rad_s
        )

    return make


def pose_with_covariance(context: SensorContext) -> Maker:
    """Make poses in frame odom, without velocities."""
    layout = context.layout(header("odom", context.encoding), variable(7), diagonal(6, 1e-3))

    def make(number: int, seconds: float, stamp_ns: int) -> bytes:
        return layout.pack(*_stamp(stamp_ns), *_noisy_pose(context, number, seconds, context.motion(seconds)))

    return make


def _noisy_pose(context: SensorContext, number: int, seconds: float, state: MotionState) -> tuple[float, ...]:
    east = state.east_m + 0.01 * context.noise(number, 0) + _jump_m(context, Defect.odometry_jump, number, seconds)
    north = state.north_m + 0.01 * context.noise(number, 1)
    if context.has(Defect.nan, seconds):
        east = math.nan
    return (east, north, state.up_m, *state.orientation)


def _jump_m(context: SensorContext, defect: Defect, number: int, seconds: float) -> float:
    """Return by how much a position with a defect is wrong: every fourth one is."""
    return _JUMP_M if context.has(defect, seconds) and number % _JUMP_EVERY == 0 else 0.0


def transform(context: SensorContext, *, child_frame: str) -> Maker:
    """Make the transform from frame odom to the robot."""
    layout = context.layout([("I", 1)], header("odom", context.encoding), [("s", child_frame)], variable(7))

    def make(_number: int, seconds: float, stamp_ns: int) -> bytes:
        state = context.motion(seconds)
        return layout.pack(*_stamp(stamp_ns), state.east_m, state.north_m, state.up_m, *state.orientation)

    return make


def static_transforms(context: SensorContext, *, parent_frame: str, mounts: Mapping[str, Mount]) -> Maker:
    """Make the transforms from the robot to its sensors, by their frames.

    With the defect, the first of them has a parent that is not connected to the robot.
    """
    items: list[Item] = [("I", len(mounts))]
    disconnected = next(iter(mounts)) if context.has(Defect.disconnected_tf) else None
    for name, (forward_m, left_m, up_m, yaw_rad) in mounts.items():
        parent = "payload" if name == disconnected else parent_frame
        values = (forward_m, left_m, up_m, 0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2))
        items += [*header(parent, context.encoding), ("s", name), *(("d", value) for value in values)]
    layout = context.layout(items)
    return lambda _number, _seconds, stamp_ns: layout.pack(*_stamp(stamp_ns) * len(mounts))


def joint_states(context: SensorContext, *, joints: tuple[str, ...]) -> Maker:
    """Make positions, velocities and efforts of the joints of a walking robot."""
    names: list[Item] = [("I", len(joints)), *(("s", name) for name in joints)]
    values: list[Item] = [("I", len(joints)), *variable(len(joints))]
    layout = context.layout(header("base", context.encoding), names, values * 3)
    step = 2 * math.pi * 2

    def make(number: int, seconds: float, stamp_ns: int) -> bytes:
        amplitude = 0.3 * context.motion(seconds).speed_m_s
        positions, velocities, efforts = [], [], []
        for joint in range(len(joints)):
            phase = step * seconds + joint * math.pi / 2
            positions.append(0.4 + amplitude * math.sin(phase) + 1e-4 * context.noise(number, joint))
            velocities.append(amplitude * step * math.cos(phase) + 1e-3 * context.noise(number, joint + 1))
            efforts.append(20 + 10 * amplitude * math.cos(phase) + 0.1 * context.noise(number, joint + 2))
        if context.has(Defect.stuck_value):
            positions = [0.4] * len(joints)
        if context.has(Defect.value_range, seconds):
            positions[0] = _IMPOSSIBLE
        return layout.pack(*_stamp(stamp_ns), *positions, *velocities, *efforts)

    return make


def battery(context: SensorContext) -> Maker:
    """Make the states of a battery that discharges slowly."""
    status: list[Item] = [("B", 2), ("B", 1), ("B", 3), ("B", 1), ("I", 0), ("I", 0), ("s", "base"), ("s", "")]
    layout = context.layout(header("battery", context.encoding), [("f", None)] * 7, status)
    full, volts = (0.08, 41.0) if context.has(Defect.low_battery) else (0.8, 48.0)

    def make(number: int, seconds: float, stamp_ns: int) -> bytes:
        percentage = max(0.0, full - seconds / 7200)
        voltage = volts - seconds / 7200 + 0.01 * context.noise(number, 0)
        current = -8.0 + 0.1 * context.noise(number, 1)
        return layout.pack(*_stamp(stamp_ns), voltage, 30.0, current, 20 * percentage, 20.0, 20.0, percentage)

    return make


def _stamp(stamp_ns: int) -> tuple[int, int]:
    return divmod(stamp_ns, 1_000_000_000)
