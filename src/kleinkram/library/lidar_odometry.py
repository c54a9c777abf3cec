# /// script
# requires-python = ">=3.10"
# dependencies = ["open-kleinkram", "kiss-icp==1.3.0"]
#
# [tool.kleinkram]
# name = "lidar-odometry"
# description = "The trajectory of a lidar by KISS-ICP, as a file of the mission in the format of TUM."
# metrics = [
#   {name = "scans"},
#   {name = "path_length", unit = "m"},
#   {name = "scan_rate", unit = "Hz", better = "higher", description = "how fast the odometry was"},
# ]
# resources = {cores = 1, memory = "4GB", disk = "1GB", time = "4h"}
# right = "CREATE"
# inputs = {paths = ["*.mcap", "*.bag", "*.db3", "*.mcap.zst*", "*.db3.zst*", "*.bag.zst*", "*metadata.yaml"]}
#
# [[tool.kleinkram.parameters]]
# name = "topic"
# type = "topic"
# default = ""
# description = "The topic of point clouds (PointCloud2); by default the only one."
#
# [[tool.kleinkram.parameters]]
# name = "to"
# type = "string"
# default = "derived/lidar-odometry.tum"
# description = "The path of the trajectory in the mission. A file that exists is not replaced."
#
# [[tool.kleinkram.parameters]]
# name = "mount"
# type = "string"
# default = ""
# description = "Where the lidar is on the robot, such as tf:base_link->lidar, for the trajectory of the robot."
#
# [[tool.kleinkram.parameters]]
# name = "max_range"
# type = "number"
# unit = "m"
# minimum = 1
# default = 100
#
# [[tool.kleinkram.parameters]]
# name = "min_range"
# type = "number"
# unit = "m"
# minimum = 0
# default = 0
#
# [[tool.kleinkram.parameters]]
# name = "voxel_size"
# type = "number"
# unit = "m"
# minimum = 0
# default = 0
# description = "The resolution of the map; 0: a hundredth of max_range."
#
# [[tool.kleinkram.parameters]]
# name = "deskew"
# type = "boolean"
# default = true
# description = "Undo the motion during a scan, where points have times."
# ///
"""Lidar odometry: a trajectory from the point clouds of a mission, by KISS-ICP.

Copy this file to try another method: only `track` knows KISS-ICP. Stamps are those of the headers. Poses are those of
the lidar relative to its first one, or with `mount` those of the robot.

Source: I. Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP", 2023.
"""

import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from kleinkram.action import out, parameters, progress, report
from kleinkram.library.inputs import InputRecording, input_recordings, only_recording, read_trajectory
from kleinkram.recordings import RecordingError, Topic
from kleinkram.recordings.decoding import DecodeError, points
from kleinkram.recordings.trajectories import (
    PoseList,
    Trajectory,
    TrajectoryRefused,
    quaternions_of,
    seconds_text,
    write_tum,
)

CLOUD_TYPES = ("PointCloud2", "PointCloud")
TIME_FIELDS = ("t", "time", "timestamp", "timestamps", "offset_time", "time_offset")
PROGRESS_EVERY_S = 1.0


class Scan(NamedTuple):
    """A scan: points [N, 3] in metres, and their times [N] in any unit (empty: unknown)."""

    log_time_ns: int
    stamp_ns: int
    points: Any
    times: Any


def main() -> None:
    """Write the trajectory; exit with 1 and a sentence if there are no usable point clouds."""
    try:
        run()
    except RecordingError as error:
        report.finding("error", "odometry.failed", str(error)[:2000])
        sys.exit(str(error))


def run() -> None:
    """Find the topic, track the lidar, and report the file and the numbers."""
    recordings = input_recordings()
    recording, topic = cloud_topic(recordings, str(parameters()["topic"]))
    mount_source = str(parameters()["mount"]).strip()
    values = parameters()
    if float(values["min_range"]) >= float(values["max_range"]):
        raise TrajectoryRefused("min_range", "must be below max_range")
    mount = read_trajectory(mount_source, recordings).trajectory if mount_source else None
    if mount is not None and mount.stamps_ns is not None:
        raise TrajectoryRefused(mount_source, "moves: the mount of a lidar is a static transform")
    started = time.monotonic()
    trajectory = track(scans(recording, topic), topic.name)
    elapsed_s = time.monotonic() - started
    if mount is not None:
        trajectory = mount.followed_by(trajectory).followed_by(mount.inverse())
    path = out / "lidar-odometry.tum"
    write_tum(trajectory, path)
    report.mission_file(path, str(parameters()["to"]), derived_from=[*recording.paths])
    report.metric("scans", len(trajectory), topic=topic.name)
    report.metric("path_length", trajectory.length_m, unit="m", topic=topic.name)
    report.metric("scan_rate", len(trajectory) / elapsed_s, unit="Hz", topic=topic.name)
    print(f"{topic.name}: {len(trajectory)} scans, {trajectory.length_m:.2f} m, in {elapsed_s:.1f} s", flush=True)


def cloud_topic(recordings: Sequence[InputRecording], name: str) -> tuple[InputRecording, Topic]:
    """Return the topic of point clouds with this name, or without one the only topic of point clouds.

    Raises:
        TrajectoryRefused: there is none or several, or its type is another.
    """
    topics = {topic.name: topic for recording in recordings for topic in recording.topics}
    clouds = sorted(topic for topic in topics if _is_cloud(topics[topic]))
    if name and name not in topics:
        choice = f"topics of point clouds: {', '.join(clouds)}" if clouds else "there are no point clouds"
        raise TrajectoryRefused(name, f"no recording has this topic; {choice}")
    if name and name not in clouds:
        choice = f"topics of point clouds: {', '.join(clouds)}" if clouds else "there are none"
        raise TrajectoryRefused(name, f"is of type {topics[name].message_type}, not of point clouds; {choice}")
    if not clouds:
        raise TrajectoryRefused("topic", "the mission has no topic of point clouds (sensor_msgs/PointCloud2)")
    if not name and len(clouds) > 1:
        raise TrajectoryRefused(
            "topic", f"the mission has {len(clouds)} topics of point clouds, name one: {', '.join(clouds)}"
        )
    chosen = name or clouds[0]
    return only_recording(chosen, recordings, lambda topic: topic.name == chosen), topics[chosen]


def _is_cloud(topic: Topic) -> bool:
    return topic.message_type.replace(".", "/").rpartition("/")[2] in CLOUD_TYPES


def scans(recording: InputRecording, topic: Topic) -> Iterator[Scan]:
    """Yield the scans of a topic. Those without points are left out, and a finding counts them."""
    empty = number = 0
    last_ns = -1
    shown = time.monotonic()
    with recording.open() as reader:
        for number, message in enumerate(reader.messages(topic.name), 1):
            place = f"the message logged at {seconds_text(message.log_time_ns)} s"
            try:
                cloud = points(message.value).reshape(-1)
                xyz = np.column_stack([cloud[axis] for axis in "xyz"]).astype(np.float64)
            except (DecodeError, ValueError) as error:
                raise TrajectoryRefused(topic.name, f"{place} has no points: {error}") from None
            stamp_ns = message.stamp_ns
            if stamp_ns is None:
                raise TrajectoryRefused(topic.name, f"{place} has no stamp")
            if stamp_ns <= last_ns:  # now, not after hours
                before = f"{seconds_text(last_ns)} s of the scan before it"
                reason = f"{place}: its stamp {seconds_text(stamp_ns)} s is not later than {before}; stamps must ascend"
                raise TrajectoryRefused(topic.name, reason)
            last_ns = stamp_ns
            is_usable = np.isfinite(xyz).all(axis=1) & xyz.any(axis=1)
            field = next((name for name in TIME_FIELDS if name in (cloud.dtype.names or ())), None)
            times = np.empty(0) if field is None else cloud[field][is_usable].astype(np.float64)
            if is_usable.any():
                yield Scan(message.log_time_ns, stamp_ns, xyz[is_usable], times)
            else:
                empty += 1
            if topic.count and time.monotonic() > shown + PROGRESS_EVERY_S:
                shown = time.monotonic()
                progress(min(number / topic.count, 1.0), f"Scan {number} of {topic.count}")
    if empty:
        report.finding("warning", "lidar.empty", f"{empty} of {number} scans have no points", topic=topic.name)


def track(frames: Iterator[Scan], name: str) -> Trajectory:
    """Return the poses of the lidar at all scans, by KISS-ICP."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    values = parameters()
    config = KISSConfig()
    config.data.max_range, config.data.min_range = float(values["max_range"]), float(values["min_range"])
    config.data.deskew = bool(values["deskew"])
    config.mapping.voxel_size = float(values["voxel_size"]) or config.data.max_range / 100
    # Several threads add in an order of their own, so that each run would have other last digits.
    config.registration.max_num_threads = 1
    odometry = KissICP(config)
    poses = PoseList(name, lambda log_time_ns: f"the scan logged at {seconds_text(log_time_ns)} s")
    for scan in frames:
        odometry.register_frame(scan.points, scan.times)
        pose = np.asarray(odometry.last_pose)
        quaternion = quaternions_of(pose[np.newaxis, :3, :3])[0]
        poses.add(scan.log_time_ns, scan.stamp_ns, (*pose[:3, 3].tolist(), *quaternion.tolist()))
    return poses.trajectory()


if __name__ == "__main__":
    main()
