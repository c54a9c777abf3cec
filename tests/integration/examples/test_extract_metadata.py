"""The shipped action on real recordings, compared with another library and another formula."""

import json
import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from kleinkram.action.testing import TryOutResult, try_out
from kleinkram.client.actions import read_manifest

FOLDER = Path(__file__).parents[3] / "examples" / "actions" / "extract-metadata"
GPS_STEP_M = 1.0


def extract(folder: Path, files: Mapping[str, Path | bytes], **parameters: str) -> TryOutResult:
    ran = try_out(FOLDER / "extract_metadata.py", folder, files=files, parameters={**parameters})
    assert ran.exit_code == 0, ran.log
    return ran


def values(path: Path, message_type: str) -> list[Any]:
    """The messages of a type, read by another library."""
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS1_NOETIC)) as reader:
        connections = [item for item in reader.connections if item.msgtype == message_type]
        return [reader.deserialize(raw, item.msgtype) for item, _, raw in reader.messages(connections)]


def odometry_m(path: Path) -> float:
    positions = [message.pose.pose.position for message in values(path, "nav_msgs/msg/Odometry")]
    places = [(place.x, place.y, place.z) for place in positions]
    return math.fsum(math.dist(one, other) for one, other in pairwise(places))


def geodesic_m(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Metres between two (latitude, longitude) on WGS 84.

    Source: T. Vincenty, Survey Review XXIII (176), 1975, the inverse formula.
    """
    a, f = 6_378_137.0, 1 / 298.257223563
    b = (1 - f) * a
    u1, u2 = (math.atan((1 - f) * math.tan(math.radians(place[0]))) for place in (one, other))
    difference = along = math.radians(other[1] - one[1])
    if one == other:
        return 0.0
    for _ in range(50):
        sin_s = math.hypot(
            math.cos(u2) * math.sin(along),
            math.cos(u1) * math.sin(u2) - math.sin(u1) * math.cos(u2) * math.cos(along),
        )
        cos_s = math.sin(u1) * math.sin(u2) + math.cos(u1) * math.cos(u2) * math.cos(along)
        sin_a = math.cos(u1) * math.cos(u2) * math.sin(along) / sin_s
        cos2_a = 1 - sin_a**2
        cos_2m = cos_s - 2 * math.sin(u1) * math.sin(u2) / cos2_a
        c = f / 16 * cos2_a * (4 + f * (4 - 3 * cos2_a))
        s = math.atan2(sin_s, cos_s)
        bend = s + c * sin_s * (cos_2m + c * cos_s * (2 * cos_2m**2 - 1))
        before, along = along, difference + (1 - c) * f * sin_a * bend
        if abs(along - before) < 1e-12:
            break
    squared = cos2_a * (a**2 - b**2) / b**2
    big_a = 1 + squared / 16384 * (4096 + squared * (-768 + squared * (320 - 175 * squared)))
    big_b = squared / 1024 * (256 + squared * (-128 + squared * (74 - 47 * squared)))
    rest = big_b / 4 * (cos_s * (2 * cos_2m**2 - 1) - big_b / 6 * cos_2m * (4 * sin_s**2 - 3) * (4 * cos_2m**2 - 3))
    return b * big_a * (s - big_b * sin_s * (cos_2m + rest))


def test_script_and_image_have_the_same_manifest() -> None:
    script, image = read_manifest(FOLDER / "extract_metadata.py"), read_manifest(FOLDER)
    for field in ("name", "description", "parameters", "inputs", "resources", "network", "right"):
        assert getattr(script, field) == getattr(image, field), field
    dockerfile = (FOLDER / "Dockerfile").read_text()
    assert image.command[-1] in dockerfile
    assert "FROM ${BASE}" in dockerfile


def test_a_drive_without_gps_is_measured_by_its_odometry(recordings_dir: Path, tmp_path: Path) -> None:
    bag = recordings_dir / "ros1" / "robot_localization_test2_imu_odom_bz2.bag"
    ran = extract(tmp_path, {"day/drive.bag": bag, "day/broken.mcap": b"no recording"})

    assert ran.metric("distance", "day/drive.bag") == pytest.approx(odometry_m(bag), rel=1e-9)
    assert ran.report.metadata["sensors"] == ["imu"]
    positions = [message.pose.pose.position for message in values(bag, "nav_msgs/msg/Odometry")]
    box: Any = ran.report.metadata["bounding_box"]
    assert box["frame"] == "odom"
    assert (box["x_min"], box["y_max"]) == pytest.approx(
        (min(place.x for place in positions), max(place.y for place in positions)), abs=1e-3
    )
    assert ran.codes() == {"recording.unreadable"}
    assert {item.path for item in ran.report.previews} >= {"track.csv"}
    lines = (ran.out / "track.csv").read_text().splitlines()
    assert lines[0] == "recording,topic,frame,time_ns,x_m,y_m,z_m"
    assert len(lines) - 1 == len(positions)


@pytest.mark.slow
def test_a_drive_with_gps_is_measured_by_its_positions(recordings_dir: Path, tmp_path: Path) -> None:
    bag = recordings_dir / "ros1" / "robot_localization_test1_imu_odom_gps_bz2.bag"
    fixes = [(item.latitude, item.longitude) for item in values(bag, "sensor_msgs/msg/NavSatFix")]
    walked_m, last = 0.0, fixes[0]
    for fix in fixes:
        if (step_m := geodesic_m(last, fix)) >= GPS_STEP_M:
            walked_m, last = walked_m + step_m, fix

    (tmp_path / "both").mkdir()
    both = extract(tmp_path / "both", {"drive.bag": bag})
    assert both.metric("mission_distance") == pytest.approx(odometry_m(bag), rel=1e-9)
    (tmp_path / "gps").mkdir()
    by_gps = extract(tmp_path / "gps", {"drive.bag": bag}, topic="/fix")
    assert by_gps.metric("mission_distance") == pytest.approx(walked_m, rel=1e-6)

    message: Any = both.report.metadata
    assert message["sensors"] == ["gps", "imu"]
    assert (message["location"]["latitude"], message["location"]["longitude"]) == fixes[0]
    assert message["bounding_box"] == {
        "south": min(latitude for latitude, _ in fixes),
        "north": max(latitude for latitude, _ in fixes),
        "west": min(longitude for _, longitude in fixes),
        "east": max(longitude for _, longitude in fixes),
    }
    (feature,) = json.loads((both.out / "track.geojson").read_text())["features"]
    drawn = [(round(latitude, 8), round(longitude, 8)) for latitude, longitude in fixes]
    assert [(place[1], place[0]) for place in feature["geometry"]["coordinates"]] == drawn
    (picture,) = (item for item in both.report.previews if item.path.endswith((".png", ".svg")))
    assert (both.out / picture.path).stat().st_size > 1000


@pytest.mark.slow
def test_invalid_positions_are_reported_and_not_counted(recordings_dir: Path, tmp_path: Path) -> None:
    folder = recordings_dir / "mcap" / "SO_bag"
    ran = extract(tmp_path, {f"auv/{item.name}": item for item in folder.iterdir()})
    lost = {item.topic: item.message for item in ran.report.findings if item.code == "track.no_fix"}
    assert lost["/coug2/fix"].startswith("29 of 29")
    assert "location" not in ran.report.metadata
    assert ran.report.metadata["sensors"] == ["barometer", "battery", "gps", "imu"]
