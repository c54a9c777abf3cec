"""The sample robots: a small vehicle with one computer, and a legged robot with a payload of several computers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

from kleinkram.recordings.sample import motion, sensors
from kleinkram.recordings.sample.defects import Defect
from kleinkram.recordings.sample.motion import Motion, Mount
from kleinkram.recordings.sample.sensors import SensorFactory

COMPUTER = "drive"
"""The only computer of the vehicle."""


@dataclass(frozen=True)
class Sensor:
    """One topic: `message_type` as ROS 1 spells it; a rate of 0 means one message at the start.

    Attributes:
        latency_ns: from the measurement, which is the stamp of the header, to the arrival at the recorders.
        computers: those that record it; the clock of the first one makes the stamps.
    """

    topic: str
    message_type: str
    rate_hz: float
    latency_ns: int
    factory: SensorFactory
    computers: tuple[str, ...] = (COMPUTER,)


@dataclass(frozen=True)
class Robot:
    """What is recorded of a robot, and what its defects affect.

    Attributes:
        targets: the topic, computer or file that each defect affects; it cannot have the defects that are not there.
        texts: further files of the mission, with their contents.
    """

    name: str
    motion: Motion
    sensors: tuple[Sensor, ...]
    targets: Mapping[Defect, str]
    texts: Mapping[str, str]

    @property
    def computers(self) -> tuple[str, ...]:
        """The names of the computers, in the order of their first topics."""
        return tuple(dict.fromkeys(computer for sensor in self.sensors for computer in sensor.computers))

    def check_defects(self, defects: frozenset[Defect]) -> None:
        """Raise ValueError for a defect that this robot cannot have."""
        for defect in sorted(defects, key=list(Defect).index):
            if defect not in self.targets:
                raise ValueError(f"the {self.name} cannot have the defect {defect.value}; the legged robot can")

    def has_defect(self, defects: frozenset[Defect], defect: Defect, target: str) -> bool:
        """Return whether a defect is among them and affects a topic, computer or file."""
        return defect in defects and self.targets[defect] == target

    def with_defects(self, defects: frozenset[Defect]) -> Robot:
        """Return the robot with the topics that it has with these defects: some are missing, or of another kind."""
        changed = []
        for sensor in self.sensors:
            affected = [defect for defect in defects if self.targets[defect] == sensor.topic]
            if Defect.dropped_topic in affected:
                continue
            if Defect.wrong_type in affected:
                sensor = replace(
                    sensor, message_type="geometry_msgs/PoseWithCovarianceStamped", factory=sensors.pose_with_covariance
                )
            if Defect.wrong_rate in affected:
                sensor = replace(sensor, rate_hz=sensor.rate_hz / 2)
            if Defect.repeated_static in affected:
                sensor = replace(sensor, rate_hz=1.0)
            changed.append(sensor)
        return replace(self, sensors=tuple(changed))


_VEHICLE_MOUNTS = {
    "lidar": Mount(0.0, 0.0, 0.6),
    "camera": Mount(0.3, 0.0, 0.4),
    "imu": Mount(0.0, 0.0, 0.1),
    "gps": Mount(-0.2, 0.0, 0.5),
}
_VEHICLE_CAMERA_TILES = 80, 60


def vehicle(*, camera_bytes: int, lidar_points: int) -> Robot:
    """Return a small vehicle that drives in a circle, with pictures and scans of a size."""
    mounts = _VEHICLE_MOUNTS
    camera = partial(
        sensors.camera, frame="camera", tiles=_VEHICLE_CAMERA_TILES, size_bytes=camera_bytes, mount=mounts["camera"]
    )
    lidar = partial(sensors.lidar, frame="lidar", points=lidar_points, mount=mounts["lidar"])
    static = partial(sensors.static_transforms, parent_frame="base_link", mounts=mounts)
    return Robot(
        "vehicle",
        motion.drive,
        (
            Sensor("/tf_static", "tf2_msgs/TFMessage", 0, 100_000, static),
            Sensor(_CAMERA, "sensor_msgs/CompressedImage", 10, 30_000_000, camera),
            Sensor("/lidar/points", "sensor_msgs/PointCloud2", 10, 50_000_000, lidar),
            Sensor("/imu/data", "sensor_msgs/Imu", 200, 1_000_000, partial(sensors.imu, frame="imu")),
            Sensor("/gps/fix", "sensor_msgs/NavSatFix", 5, 80_000_000, partial(sensors.gnss, frame="gps")),
            Sensor("/odom", "nav_msgs/Odometry", 50, 3_000_000, partial(sensors.odometry, child_frame="base_link")),
            Sensor("/tf", "tf2_msgs/TFMessage", 50, 3_500_000, partial(sensors.transform, child_frame="base_link")),
        ),
        _VEHICLE_TARGETS,
        {},
    )


_CAMERA = "/camera/image/compressed"
_VEHICLE_TARGETS = {
    Defect.gap: "/imu/data",
    Defect.wrong_rate: "/odom",
    Defect.dropped_topic: "/gps/fix",
    Defect.wrong_type: "/odom",
    Defect.repeated_static: "/tf_static",
    Defect.silent_start: "/lidar/points",
    Defect.silent_end: _CAMERA,
    Defect.clock_jump: COMPUTER,
    Defect.stamp_offset: "/lidar/points",
    Defect.stamp_drift: "/lidar/points",
    Defect.stamp_jump: "/lidar/points",
    Defect.black_camera: _CAMERA,
    Defect.overexposed_camera: _CAMERA,
    Defect.frozen_camera: _CAMERA,
    Defect.blurred_camera: _CAMERA,
    Defect.tilted_gravity: "/imu/data",
    Defect.wrong_gravity: "/imu/data",
    Defect.saturated_imu: "/imu/data",
    Defect.constant_imu: "/imu/data",
    Defect.no_fix: "/gps/fix",
    Defect.position_jump: "/gps/fix",
    Defect.empty_clouds: "/lidar/points",
    Defect.far_points: "/lidar/points",
    Defect.disconnected_tf: "/tf_static",
    Defect.odometry_jump: "/odom",
    Defect.nan: "/odom",
    Defect.truncated: COMPUTER,
}
_JOINTS = tuple(f"{leg}_{joint}" for leg in ("LF", "RF", "LH", "RH") for joint in ("HAA", "HFE", "KFE"))
_NUC, _JETSON, _LPC, _OPC = "nuc", "jetson", "lpc", "opc"
# Of each camera: the computer that records it, and its mount.
_RIG_CAMERAS = {
    "alphasense_front_left": (_NUC, Mount(0.30, 0.06, 0.70)),
    "alphasense_front_center": (_NUC, Mount(0.30, 0.0, 0.70)),
    "alphasense_front_right": (_NUC, Mount(0.30, -0.06, 0.70)),
    "alphasense_left": (_NUC, Mount(0.20, 0.12, 0.70, math.pi / 2)),
    "alphasense_right": (_NUC, Mount(0.20, -0.12, 0.70, -math.pi / 2)),
    "hdr_front": (_JETSON, Mount(0.32, 0.0, 0.75)),
    "hdr_left": (_JETSON, Mount(0.22, 0.12, 0.75, math.pi / 2)),
    "hdr_right": (_JETSON, Mount(0.22, -0.12, 0.75, -math.pi / 2)),
    "zed_left": (_JETSON, Mount(0.32, 0.06, 0.65)),
    "zed_right": (_JETSON, Mount(0.32, -0.06, 0.65)),
    "depth_front": (_OPC, Mount(0.40, 0.0, 0.50)),
    "depth_rear": (_OPC, Mount(-0.40, 0.0, 0.50, math.pi)),
}
_RIG_LIDARS = {"hesai": (8000, Mount(0.0, 0.0, 0.95)), "livox": (8000, Mount(0.25, 0.0, 0.80))}
# Of each IMU: the computers that record it, and its mount.
_RIG_IMUS = {
    "stim": ((_NUC,), Mount(0.1, 0.0, 0.70)),
    "livox": ((_NUC,), Mount(0.25, 0.0, 0.80)),
    "zed": ((_JETSON,), Mount(0.32, 0.0, 0.65)),
    "adis": ((_JETSON,), Mount(0.1, 0.05, 0.70)),
    "base": ((_LPC, _NUC), Mount(0.0, 0.0, 0.55)),
}
_RIG_PICTURE_TILES, _RIG_PICTURE_BYTES = (40, 30), 12_000
_GNSS_MOUNT = Mount(-0.2, 0.0, 0.9)


def legged() -> Robot:
    """Return a legged robot with a sensor payload: four computers, twelve cameras, two lidars, five IMUs, GNSS."""
    # The lidars are first, so that the first is the one that a defect disconnects.
    mounts = {f"lidar_{name}": mount for name, (_points, mount) in _RIG_LIDARS.items()}
    mounts |= {f"camera_{name}": mount for name, (_computer, mount) in _RIG_CAMERAS.items()}
    mounts |= {f"imu_{name}": mount for name, (_computers, mount) in _RIG_IMUS.items()} | {"gnss": _GNSS_MOUNT}
    static = partial(sensors.static_transforms, parent_frame="base", mounts=mounts)
    topics = [
        Sensor(
            _rig_camera(name), "sensor_msgs/CompressedImage", 10, 30_000_000,
            partial(sensors.camera, frame=f"camera_{name}", tiles=_RIG_PICTURE_TILES, size_bytes=_RIG_PICTURE_BYTES,
                    mount=mount),
            (computer,),
        )
        for name, (computer, mount) in _RIG_CAMERAS.items()
    ]  # fmt: skip
    topics += [
        Sensor(
            f"/lidar/{name}/points", "sensor_msgs/PointCloud2", 10, 50_000_000,
            partial(sensors.lidar, frame=f"lidar_{name}", points=points, mount=mount), (_NUC,),
        )
        for name, (points, mount) in _RIG_LIDARS.items()
    ]  # fmt: skip
    topics += [
        Sensor(f"/imu/{name}", "sensor_msgs/Imu", 200, 1_000_000, partial(sensors.imu, frame=f"imu_{name}"), computers)
        for name, (computers, _mount) in _RIG_IMUS.items()
    ]
    odometry, transform = (partial(make, child_frame="base") for make in (sensors.odometry, sensors.transform))
    joints = partial(sensors.joint_states, joints=_JOINTS)
    topics += [
        Sensor("/gnss/fix", "sensor_msgs/NavSatFix", 10, 40_000_000, partial(sensors.gnss, frame="gnss"), (_NUC,)),
        Sensor("/odom", "nav_msgs/Odometry", 100, 3_000_000, odometry, (_LPC,)),
        Sensor("/joint_states", "sensor_msgs/JointState", 100, 2_000_000, joints, (_LPC,)),
        Sensor("/battery", "sensor_msgs/BatteryState", 2, 5_000_000, sensors.battery, (_LPC,)),
        Sensor("/tf", "tf2_msgs/TFMessage", 100, 3_500_000, transform, (_LPC, _OPC)),
        Sensor("/tf_static", "tf2_msgs/TFMessage", 0, 100_000, static, (_LPC,)),
    ]
    return Robot("legged robot", motion.walk, tuple(topics), _RIG_TARGETS, {_CALIBRATION: _calibration(mounts)})


def _rig_camera(name: str) -> str:
    return f"/camera/{name}/image/compressed"


def _calibration(mounts: Mapping[str, Mount]) -> str:
    """Return the mounts as YAML."""
    lines = ["parent: base", "frames:"]
    for frame, mount in mounts.items():
        translation = f"[{mount.forward_m}, {mount.left_m}, {mount.up_m}]"
        lines.append(f"  {frame}: {{translation_m: {translation}, yaw_rad: {mount.yaw_rad:.6f}}}")
    return "\n".join((*lines, ""))


_CALIBRATION = "calibration.yaml"
_RIG_TARGETS = {
    Defect.gap: "/lidar/hesai/points",
    Defect.wrong_rate: "/imu/stim",
    Defect.dropped_topic: "/gnss/fix",
    Defect.wrong_type: "/odom",
    Defect.repeated_static: "/tf_static",
    Defect.silent_start: _rig_camera("hdr_front"),
    Defect.silent_end: _rig_camera("hdr_left"),
    Defect.clock_jump: _JETSON,
    Defect.stamp_offset: "/lidar/hesai/points",
    Defect.stamp_drift: "/lidar/hesai/points",
    Defect.stamp_jump: "/lidar/hesai/points",
    Defect.black_camera: _rig_camera("hdr_front"),
    Defect.overexposed_camera: _rig_camera("hdr_front"),
    Defect.frozen_camera: _rig_camera("hdr_front"),
    Defect.blurred_camera: _rig_camera("hdr_front"),
    Defect.tilted_gravity: "/imu/stim",
    Defect.wrong_gravity: "/imu/stim",
    Defect.saturated_imu: "/imu/stim",
    Defect.constant_imu: "/imu/stim",
    Defect.no_fix: "/gnss/fix",
    Defect.position_jump: "/gnss/fix",
    Defect.empty_clouds: "/lidar/hesai/points",
    Defect.far_points: "/lidar/hesai/points",
    Defect.disconnected_tf: "/tf_static",
    Defect.odometry_jump: "/odom",
    Defect.nan: "/odom",
    Defect.stuck_value: "/joint_states",
    Defect.value_range: "/joint_states",
    Defect.low_battery: "/battery",
    Defect.truncated: _NUC,
    Defect.missing_computer: _OPC,
    Defect.late_computer: _JETSON,
    Defect.early_end: _JETSON,
    Defect.empty_recording: _OPC,
    Defect.recorder_offset: _NUC,
    Defect.missing_file: _CALIBRATION,
}
