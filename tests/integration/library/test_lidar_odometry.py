"""`lidar-odometry`: its trajectory of the generated world is right to centimetres, and `slam-evaluate` says so."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from kleinkram.action.testing import TryOutResult, try_out
from kleinkram.client.actions import read_manifest
from kleinkram.contract.access import Right
from kleinkram.library import lidar_odometry
from kleinkram.library.inputs import InputRecording
from kleinkram.recordings import Recording
from kleinkram.recordings.sample import generate_mcap, generate_rig
from kleinkram.recordings.trajectories import TrajectoryRefused, read_file
from tests.integration.library.packages import LIDAR_ODOMETRY, SLAM_EVALUATE, slow_with_packages, with_packages
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, ros2_mcap

MAX_ATE_M = 0.05


def track(folder: Path, files: Mapping[str, Path | bytes], **parameters: str | float) -> TryOutResult:
    return try_out(LIDAR_ODOMETRY, folder, files=files, parameters={**parameters}, timeout_s=200)


def mcap(*timed: TimedMessage) -> bytes:
    source = ros2_mcap(timed)
    return source.read(0, source.size_bytes)


def cloud(topic: str, stamp_ns: int | None = T0) -> TimedMessage:
    fields = [{"name": axis, "offset": 4 * at, "datatype": 7, "count": 1} for at, axis in enumerate("xyz")]
    data = np.arange(30, dtype=np.float32).tobytes()
    sizes = {"height": 1, "width": 10, "point_step": 12, "row_step": 120}
    return TimedMessage(topic, "sensor_msgs/PointCloud2", T0, {"fields": fields, "data": data, **sizes}, stamp_ns)


IMU = TimedMessage("/imu", "sensor_msgs/Imu", T0, {}, T0)
TF = TimedMessage(
    "/tf",
    "tf2_msgs/TFMessage",
    T0,
    {
        "transforms": [
            {
                "header": {"frame_id": "base", "stamp": {"sec": T0 // SECOND, "nanosec": 0}},
                "child_frame_id": "lidar",
                "transform": {"rotation": {"w": 1.0}},
            }
        ]
    },
)


@pytest.mark.parametrize(
    ("recordings", "parameters", "sentence"),
    [
        ([[IMU]], {}, "topic: the mission has no topic of point clouds (sensor_msgs/PointCloud2)"),
        ([[cloud("/a"), cloud("/b")]], {}, "topic: the mission has 2 topics of point clouds, name one: /a, /b"),
        ([[cloud("/a"), IMU]], {"topic": "/imu"}, "/imu: is of type sensor_msgs/msg/Imu, not of point clouds"),
        ([[cloud("/a")]], {"topic": "/b"}, "/b: no recording has this topic; topics of point clouds: /a"),
        ([[cloud("/a")], [cloud("/a")]], {}, "/a: 2 recordings have it: 0.mcap, 1.mcap; name one, such as"),
        ([[cloud("/a")]], {"mount": "tf:base->lidar"}, "tf:base->lidar: the inputs have no such file or topic"),
        ([[cloud("/a")]], {"min_range": 100.0}, "min_range: must be below max_range"),
        ([[cloud("/a"), TF]], {"mount": "tf:base->lidar"}, "tf:base->lidar: moves: the mount of a lidar is a static"),
    ],
)
def test_a_mission_without_one_lidar_fails_with_a_sentence(
    tmp_path: Path, recordings: list[list[TimedMessage]], parameters: dict[str, str | float], sentence: str
) -> None:
    files = {f"{number}.mcap": mcap(*messages) for number, messages in enumerate(recordings)}
    ran = track(tmp_path, files, **parameters)
    assert ran.exit_code == 1, ran.log
    (finding,) = ran.report.findings
    assert finding.message.startswith(sentence)
    assert ran.log.strip() == finding.message
    assert not ran.report.mission_files


def test_doubled_scans_are_refused_before_the_others_are_tracked(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    path.write_bytes(mcap(cloud("/a"), cloud("/a", T0 + 1), cloud("/a", T0 + 1), cloud("/a", T0 + 2)))
    with Recording.open(path) as recording:
        topic = recording.topic("/a")
    scans = lidar_odometry.scans(InputRecording("drive.mcap", (path,), (topic,)), topic)
    assert [next(scans).stamp_ns, next(scans).stamp_ns] == [T0, T0 + 1]
    with pytest.raises(TrajectoryRefused, match=r"its stamp 1700000000\.000000001 s is not later than"):
        next(scans)


def test_the_script_describes_itself() -> None:
    manifest = read_manifest(LIDAR_ODOMETRY)
    assert (manifest.name, manifest.dependencies) == ("lidar-odometry", ["open-kleinkram", "kiss-icp==1.3.0"])
    assert manifest.right is Right.create  # it puts a file back
    assert not manifest.inputs.derived


@slow_with_packages
def test_from_a_recording_to_an_error_of_centimetres(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both actions, one after the other, on a drive of 20 m; the second finds the file that the first one made."""
    folder = tmp_path_factory.mktemp("drive")
    drive = folder / "drive.mcap"
    generate_mcap(drive, duration_s=10, size_bytes=30_000_000)
    with_packages(monkeypatch, LIDAR_ODOMETRY)
    ran = track(tmp_path_factory.mktemp("odometry"), {"drive.mcap": drive})
    assert ran.exit_code == 0, ran.log
    (made,) = ran.report.mission_files
    assert (made.to, made.derived_from) == ("derived/lidar-odometry.tum", ["drive.mcap"])
    assert ran.metric("scans", topic="/lidar/points") == 100
    assert ran.metric("path_length", topic="/lidar/points") == pytest.approx(19.8, rel=0.01)
    trajectory = read_file(ran.out / made.path)
    assert len(trajectory) == 100

    with_packages(monkeypatch, SLAM_EVALUATE)
    evaluated = try_out(
        SLAM_EVALUATE,
        tmp_path_factory.mktemp("evaluation"),
        files={"drive.mcap": drive, made.to: ran.out / made.path},
        metadata={"reference": "tf:odom->base_link"},
        timeout_s=120,
    )
    assert evaluated.exit_code == 0, evaluated.log
    compared = {"estimate": made.to, "reference": "tf:odom->base_link"}
    labels = {**compared, "alignment": "se3", "tolerance": "0.01 s"}
    assert evaluated.metric("matched_poses", labels=labels) == 100
    assert 0 < evaluated.metric("ate_rmse", labels=labels) < MAX_ATE_M
    assert evaluated.metric("rpe_rmse", labels={**labels, "delta": "1 s"}) < MAX_ATE_M


@slow_with_packages
def test_with_its_mount_the_trajectory_is_that_of_the_robot(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lidar of the legged robot, a quarter of a metre in front of its base, recorded by another computer."""
    folder = tmp_path_factory.mktemp("rig")
    generate_rig(folder, duration_s=6)
    files: dict[str, Path | bytes] = {name: folder / name for name in ("nuc/nuc.mcap", "lpc/lpc.mcap")}
    with_packages(monkeypatch, LIDAR_ODOMETRY)
    topic, mount = "/lidar/livox/points", "lpc/lpc.mcap:tf:base->lidar_livox"
    robot = track(tmp_path_factory.mktemp("robot"), files, topic=topic, mount=mount)
    lidar = track(tmp_path_factory.mktemp("lidar"), files, topic=topic)
    assert robot.exit_code == lidar.exit_code == 0, robot.log + lidar.log
    of_robot, of_lidar = (read_file(ran.out / "lidar-odometry.tum") for ran in (robot, lidar))
    turn = 2 * np.arctan2(of_lidar.orientations[:, 2], of_lidar.orientations[:, 3])
    lever = 0.25 * np.stack([1 - np.cos(turn), -np.sin(turn)], axis=1)
    assert np.abs(turn).max() > 0.2
    assert of_robot.positions[:, :2] == pytest.approx(of_lidar.positions[:, :2] + lever, abs=0.01)
