"""Panels of the viewer in a real browser: map, state timeline, table and frames show what the SDK reads."""

import csv
import io
import json
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from kleinkram.recordings import Recording
from tests.acceptance.conftest import wait_until
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_AUV = "mcap/SO_bag/SO_bag_0.mcap"
_DRIVE = "ros1/robot_localization_test1_imu_odom_gps_bz2.bag"
_TURTLES = "ros1/turtlesim_lz4.bag"
_S = 1_000_000_000
_EARTH_RADIUS_M = 6_378_137


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_panels_show_what_the_sdk_reads(
    shared_cluster: Cluster, run_browser: RunBrowser, recordings_dir: Path, pictures: Path
) -> None:
    auv, drive, turtles = (recordings_dir / name for name in (_AUV, _DRIVE, _TURTLES))
    terminal = shared_cluster.terminal
    terminal.run("project", "create", "Lakes")
    terminal.run("upload", "-p", "Lakes", "-m", "day", "--create", "--wait", auv, drive, turtles)

    def files() -> dict[str, dict[str, Any]]:
        return {file["path"]: file for file in terminal.run("file", "list", "-p", "Lakes", "--json").json()["items"]}

    wait_until(lambda: all(file["content"] == "indexed" for file in files().values()), "the files to be read")
    fixes = _messages(auv, "/coug2/fix")
    head_ns = _messages(drive, "/fix")[500][0] + 7
    times = {
        "drive": head_ns,
        "auv": fixes[0][0],
        "auvFrames": _messages(auv, "/tf")[100][0] + 1000,
        "turtles": _messages(turtles, "/tf")[1500][0] + 1000,
    }
    known = files()
    ids = {name: known[path.name]["id"] for name, path in (("auv", auv), ("drive", drive), ("turtles", turtles))}
    request = {**ids, "times": {name: str(time_ns) for name, time_ns in times.items()}}
    results = run_browser("viewer_panels.mjs", shared_cluster, pictures, json.dumps(request))

    assert [results[name] for name in ("consoleErrors", "axe", "overflowing", "executed")] == [[], [], [], []]
    _assert_map(results, drive, head_ns)
    # Where the receiver says that it has a fix, the position is NaN; where it has one, the status is negative.
    usable = [fix for _, fix in fixes if fix.status.status >= 0 and np.isfinite(fix.latitude)]
    assert results["withoutFix"]["positions"] == len(usable) == 0
    assert results["withoutFix"]["missing"] == len(fixes)
    assert results["withoutFix"]["position"] == "No position"
    _assert_states(results["states"], fixes)
    _assert_table(results["table"], drive, head_ns)
    # The way goes over two static transforms and a moving one.
    _assert_frames(results["auvFrames"], auv, times["auvFrames"], ("coug2.robot", "enu"))
    _assert_frames(results["turtleFrames"], turtles, times["turtles"], ("carrot", "turtle2"))
    assert "/tf,world,turtle2" in results["selected"]["address"], "the frame that was selected is in the link"
    world = _pose(_latest(turtles, times["turtles"]), "world", "turtle2")
    assert _numbers(results["selected"]["translation"]) == pytest.approx(world[:3, 3], abs=1e-4)


def _messages(path: Path, topic: str) -> list[tuple[int, Any]]:
    with Recording.open(path) as recording:
        return [(message.log_time_ns, message.value) for message in recording.messages(topic)]


def _assert_map(results: dict[str, Any], path: Path, head_ns: int) -> None:
    fixes = _messages(path, "/fix")
    valid_ns, valid = [fix for fix in fixes if fix[0] <= head_ns][-1]
    shown = results["map"]
    assert (shown["positions"], shown["missing"], shown["hasHead"]) == (len(fixes), 0, True)
    assert int(shown["logTime"]) == valid_ns
    assert shown["position"] == f"{valid.latitude:.7f}°, {valid.longitude:.7f}°"
    assert shown["altitude"] == f"{valid.altitude:.2f} m"
    # The track is as wide and as high as the positions, in metres.
    places = [tuple(map(float, place.split())) for place in shown["path"].replace("M", "L").split("L")[1:]]
    width_px, height_px = np.ptp(np.array(places), axis=0)
    latitudes, longitudes = (np.radians([getattr(fix, name) for _, fix in fixes]) for name in ("latitude", "longitude"))
    height_m = _EARTH_RADIUS_M * np.ptp(latitudes)
    width_m = _EARTH_RADIUS_M * np.ptp(longitudes) * np.cos(latitudes.mean())
    assert width_px * shown["metresPerPixel"] == pytest.approx(width_m, rel=0.01)
    assert height_px * shown["metresPerPixel"] == pytest.approx(height_m, rel=0.01)
    assert int(results["clicked"]) == fixes[0][0], "a click on the start of the track goes to its time"
    zoom = results["zoom"]
    assert zoom["wheel"] == pytest.approx(1.5**2, rel=1e-6)
    assert zoom["key"] == pytest.approx(1.5, rel=1e-6)
    assert zoom["fitted"] == pytest.approx(1)
    assert zoom["isMoved"]
    assert zoom["isHeadSame"]


def _assert_states(shown: dict[str, Any], fixes: list[tuple[int, Any]]) -> None:
    runs = [[time_ns for time_ns, _ in run] for _, run in groupby(fixes, key=lambda fix: fix[1].status.status)]
    rows = {row["field"]: row for row in shown["rows"]}
    assert [rows[field]["runs"] for field in ("status.status", "status.service", "header.frame_id")] == [3, 1, 1]
    assert rows["status.status"]["bars"] == 3
    duration = (runs[1][0] - runs[0][0]) / _S
    assert rows["status.status"]["described"] == f"STATUS_NO_FIX (-1), for {duration:.3f} s"
    assert rows["header.frame_id"]["described"].startswith("gps, for ")
    assert [int(shown["next"]), int(shown["previous"])] == [runs[1][0], runs[0][0]]
    assert shown["describedNext"].startswith("STATUS_FIX (0), for ")
    middle_ns = (1744320598277644941 + 1744320618450047454) // 2
    assert int(shown["clicked"]) == pytest.approx(middle_ns, abs=0.1 * _S)


def _assert_table(shown: dict[str, Any], path: Path, head_ns: int) -> None:
    messages = _messages(path, "/imu/data")
    valid = max(place for place, (time_ns, _) in enumerate(messages) if time_ns <= head_ns)
    assert int(shown["current"]) == messages[valid][0]
    first = next(place for place, (time_ns, _) in enumerate(messages) if str(time_ns) == shown["rows"][0][0])
    expected = messages[first : first + len(shown["rows"])]
    assert first <= valid - 10
    assert len(expected) > valid - first + 10
    truth = [[str(time_ns), imu.linear_acceleration.x, imu.header.frame_id] for time_ns, imu in expected]
    assert [[row[0], float(row[1]), row[2]] for row in shown["rows"]] == truth
    head, *rows = csv.reader(io.StringIO(shown["csv"]))
    assert head == ["log_time_ns", "linear_acceleration.x", "header.frame_id"]
    assert [[row[0], float(row[1]), row[2]] for row in rows] == truth
    assert shown["clicked"] == shown["rows"][2][0]


def _assert_frames(shown: dict[str, Any], path: Path, head_ns: int, way: tuple[str, str]) -> None:
    latest = _latest(path, head_ns)
    rows = {row["frame"]: row for row in shown["rows"]}
    assert set(rows) == set(latest) | {step.parent for step in latest.values()}
    for child, step in latest.items():
        assert int(rows[child]["time"]) == step.time_ns
        assert rows[child]["depth"] == rows[step.parent]["depth"] + 1
        assert rows[child]["text"] == ("static" if step.is_static else f"{(head_ns - step.time_ns) / _S:.3f} s old")
    pose = _pose(latest, *way)
    assert _numbers(shown["translation"]) == pytest.approx(pose[:3, 3], abs=1e-4)
    roll = np.degrees(np.arctan2(pose[2, 1], pose[2, 2]))
    pitch = np.degrees(np.arcsin(-pose[2, 0]))
    yaw = np.degrees(np.arctan2(pose[1, 0], pose[0, 0]))
    assert _numbers(shown["rotation"]) == pytest.approx([roll, pitch, yaw], abs=2e-3)


class _Step(NamedTuple):
    time_ns: int
    parent: str
    is_static: bool
    matrix: Any


def _latest(path: Path, head_ns: int) -> dict[str, _Step]:
    """The latest transform of each frame at a time; static ones are valid at all times."""
    latest: dict[str, _Step] = {}
    for topic in ("/tf_static", "/tf"):
        is_static = topic == "/tf_static"
        for time_ns, message in _messages(path, topic):
            for one in message.transforms if is_static or time_ns <= head_ns else ():
                step = _Step(time_ns, one.header.frame_id, is_static, _matrix(one.transform))
                latest[one.child_frame_id] = step
    return latest


def _pose(latest: dict[str, _Step], frame: str, reference: str) -> Any:
    """The pose of a frame relative to another, as a matrix, by way of the root of both."""
    return np.linalg.inv(_in_root(latest, reference)) @ _in_root(latest, frame)


def _in_root(latest: dict[str, _Step], frame: str) -> Any:
    pose = np.eye(4)
    while frame in latest:
        pose = latest[frame].matrix @ pose
        frame = latest[frame].parent
    return pose


def _numbers(text: str) -> list[float]:
    return [float(number) for number in text.split(", ")]


def _matrix(transform: Any) -> Any:
    """The matrix of a transform, from the definition of a rotation by a quaternion."""
    rotation, shift = transform.rotation, transform.translation
    x, y, z, w = np.array([rotation.x, rotation.y, rotation.z, rotation.w]) / np.linalg.norm(
        [rotation.x, rotation.y, rotation.z, rotation.w]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = [shift.x, shift.y, shift.z]
    return matrix
