"""Panels of the viewer in a real browser show what the SDK reads, and images what was encoded."""

import base64
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
from tests.system.web import image_samples as samples
from tests.system.web.conftest import RunBrowser
from tests.system.web.h264_samples import h264_frames
from tests.system.web.image_samples import VideoFrame

_AUV = "mcap/SO_bag/SO_bag_0.mcap"
_DRIVE = "ros1/robot_localization_test1_imu_odom_gps_bz2.bag"
_TURTLES = "ros1/turtlesim_lz4.bag"
_S = 1_000_000_000
_EARTH_RADIUS_M = 6_378_137
_SHOWN = 10
_VIDEO_FRAMES = 60
# The beginning of a key frame of H.265 (Main profile, level 3.1): its parameters, and the head of its first slice.
_H265_KEY = base64.b64encode(bytes.fromhex("0000000142010101600000030090000003000003005da00000012601")).decode()
# Coefficients of red, green and blue, of x⁰ first. Source: A. Mikhailov, "Turbo, An Improved Rainbow Colormap", 2019.
_TURBO = (
    (0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943),
    (0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604),
    (0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973),
)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_panels_show_what_the_sdk_reads(
    shared_cluster: Cluster, run_browser: RunBrowser, recordings_dir: Path, pictures: Path, tmp_path: Path
) -> None:
    auv, drive, turtles = (recordings_dir / name for name in (_AUV, _DRIVE, _TURTLES))
    terminal = shared_cluster.terminal
    terminal.run("project", "create", "Lakes")
    encoded = run_browser("encode_video.mjs", shared_cluster, _VIDEO_FRAMES)
    images = samples.write_images(tmp_path / "images.mcap", _videos(encoded), h264_frames(_VIDEO_FRAMES))
    terminal.run("upload", "-p", "Lakes", "-m", "day", "--create", "--wait", auv, drive, turtles, images)

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
        "images": _image_ns(_SHOWN),
    }
    known = files()
    paths = {"auv": auv, "drive": drive, "turtles": turtles, "images": images}
    ids = {name: known[path.name]["id"] for name, path in paths.items()}
    request = {
        **ids,
        "times": {name: str(time_ns) for name, time_ns in times.items()},
        "damagedTimes": [str(_image_ns(number)) for number in range(len(samples.BAD_RAW) + 2)],
        "videos": [_video_steps(topic) for topic in (*_videos(encoded), "/video/h264_pcm")],
    }
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
    _assert_depth(results["depth"])
    _assert_annotated(results["annotated"])
    _assert_damaged(results["damaged"])
    _assert_videos(results["videos"], encoded["decodable"])


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


def _image_ns(number: int) -> int:
    return samples.START_NS + number * samples.STEP_NS


def _videos(encoded: dict[str, Any]) -> dict[str, list[VideoFrame]]:
    """The videos that the browser encoded, and one of which it has no decoder or that is damaged."""
    videos = {
        f"/video/{name}": [VideoFrame(data, name) for data in frames] for name, frames in encoded["videos"].items()
    }
    assert "vp9" in encoded["videos"], "Chromium encodes VP9"
    vp9 = videos["/video/vp9"]
    return {
        **videos,
        "/video/h265": [VideoFrame(_H265_KEY, "h265")],
        "/video/cut": vp9[1:20],
        "/video/unknown": [VideoFrame(frame.data, "mpeg2") for frame in vp9[:3]],
    }


def _video_steps(topic: str) -> dict[str, Any]:
    """Where a video is opened, between two key frames, and the keys that are pressed then."""
    numbers = {"ArrowRight": 57, ".": 58, ",": 57, "ArrowLeft": 47}
    keys = [(key, str(_image_ns(number))) for key, number in numbers.items()]
    start = 0 if topic in ("/video/cut", "/video/unknown", "/video/h265") else 47
    return {"topic": topic, "time": str(_image_ns(start)), "keys": keys}


def _rgba(state: dict[str, Any]) -> Any:
    assert "failure" not in state, state
    return np.frombuffer(base64.b64decode(state["rgba"]), np.uint8).reshape(state["height"], state["width"], 4)


def _coloured(values: Any, least: float, greatest: float, table: Any) -> Any:
    """The colours of values; 0 and NaN have none."""
    finite = np.nan_to_num(values.astype(np.float64))
    places = np.floor(np.clip((finite - least) * (255 / (greatest - least)), 0, 255) + 0.5).astype(int)
    return np.where((finite == 0)[..., None], 0, table[places])


def _percentiles(values: Any) -> tuple[float, float]:
    measured = np.sort(values[np.isfinite(values) & (values != 0)].astype(np.float64))
    last = len(measured) - 1
    return float(measured[int(np.floor(last * 0.01))]), float(measured[int(np.ceil(last * 0.99))])


def _assert_depth(shown: dict[str, Any]) -> None:
    greys = np.array([(level, level, level, 255) for level in range(256)])
    x = np.linspace(0, 1, 256)
    turbo = [np.floor(np.clip(np.polynomial.Polynomial(row)(x), 0, 1) * 255 + 0.5) for row in _TURBO]
    turbo_table = np.stack([*turbo, np.full(256, 255)], axis=-1)
    millimetres, metres = samples.depth_mm(_SHOWN), samples.depth_m(_SHOWN)
    expected: dict[str, tuple[Any, Any]] = {
        "/depth/mm": (millimetres, turbo_table),
        "/depth/png": (millimetres, turbo_table),
        "/depth/rvl": (millimetres, turbo_table),
        "/depth/m": (metres, turbo_table),
        "/thermal": (millimetres, greys),
    }
    for topic, (values, table) in expected.items():
        state = shown["states"][topic]
        assert int(state["logTime"]) == _image_ns(_SHOWN)
        least, greatest = _percentiles(values)
        assert (state["range"]["least"], state["range"]["greatest"]) == pytest.approx((least, greatest))
        assert least > 700 / (1000 if topic == "/depth/m" else 1), "measurements that are far out do not count"
        difference = np.abs(_rgba(state).astype(int) - _coloured(values, least, greatest, table))
        assert difference.max() <= 1, topic
        assert (_rgba(state)[..., 3] == 0).sum() == (values == 0).sum() + np.isnan(values).sum()
    assert shown["states"]["/depth/mm"]["range"]["text"].count(" mm") == 2
    assert shown["states"]["/depth/m"]["range"]["text"].count(" m") == 2
    value = int(millimetres[30, 40])
    assert shown["values"] == [
        f"40, 30: {value} mm",
        f"40, 30: {value / 1000:g} m",
        "32, 22: no value",
        "12, 6: no value",
    ]
    fixed = np.abs(_rgba(shown["fixed"]).astype(int) - _coloured(millimetres, 1000, 1500, greys))
    assert fixed.max() == 0
    assert shown["isSame"], "the link has the settings"


def _assert_annotated(shown: dict[str, Any]) -> None:
    front, rear = _rgba(shown["states"]["/front/image"]), _rgba(shown["states"]["/rear/image"])
    plain = (*samples.camera(_SHOWN)[0, 0], 255)
    red, blue = (255, 0, 0, 255), (0, 0, 255, 255)
    # The square of shapes that were published once, 4 pixels wide; the circle is filled.
    assert [tuple(front[y, x]) for x, y in ((20, 9), (20, 10), (9, 20), (30, 25))] == [red] * 4
    assert [tuple(front[20, x]) for x in (50, 46, 54)] == [blue] * 3
    assert [tuple(front[y, x]) for x, y in ((20, 20), (40, 5), (60, 20))] == [plain] * 3
    assert (front[38:46, 2:40, :3] > 150).all(axis=-1).sum() > 10, "the text is drawn"
    assert int(shown["states"]["/front/image"]["annotations"]) == _image_ns(0)
    # The detection of this very picture, although it came later.
    assert int(shown["states"]["/rear/image"]["annotations"]) == _image_ns(_SHOWN) + samples.DELAY_NS
    left = samples.box_left(_SHOWN)
    columns = np.flatnonzero((rear[30, :, :3] != samples.camera(_SHOWN)[0, 0]).any(axis=-1))
    assert set(columns) == {left - 1, left, left + 9, left + 10}
    assert "3 annotations of /front/shapes" in shown["states"]["/front/image"]["facts"]
    assert "2 annotations of /rear/boxes" in shown["other"]["facts"]
    assert (_rgba(shown["other"]) == rear).all()
    assert (_rgba(shown["none"]) == plain).all()


def _assert_damaged(steps: list[dict[str, Any]]) -> None:
    for number, step in enumerate(steps):
        assert (_rgba(step["/front/image"])[..., :3] == samples.camera(number)).all(), "other panels go on"
        is_good = number in (0, len(steps) - 1)
        assert ("failure" in step["/bad/raw"], "failure" in step["/bad/compressed"]) == (not is_good, not is_good)
        if is_good:
            assert (_rgba(step["/bad/raw"])[..., 0] == 99).all()
            assert np.ptp(_rgba(step["/bad/compressed"])[..., 0]) > 100
    for topic, details in (("/bad/raw", samples.BAD_RAW), ("/bad/compressed", samples.BAD_COMPRESSED)):
        for step, detail in zip(steps[1:], details, strict=False):
            is_large = detail == "60000 × 60000"
            sentence = "This image is too large to display" if is_large else "This image is not readable"
            assert step[topic]["failure"] == f"{sentence} ({detail})"


def _assert_videos(videos: dict[str, Any], decodable: list[str]) -> None:
    cut, unknown, h265 = (videos.pop(f"/video/{name}")[0]["failure"] for name in ("cut", "unknown", "h265"))
    assert cut.startswith("Decoding begins with a key frame, and there is none shortly before this time")
    assert unknown == "The preview does not support this image format (video, mpeg2)"
    # A slice without its content, where a browser has the codec.
    codec = "This browser does not support the codec of this video (h265, hev1.1.6.L93.90)"
    assert h265.startswith("This image is not readable") if "h265" in decodable else h265 == codec
    assert "vp9" in decodable
    for topic, states in videos.items():
        name = topic.removeprefix("/video/").removesuffix("_pcm")
        if name not in decodable:
            assert states[0]["failure"].startswith("This browser does not support the codec of this video"), topic
            continue
        for state, number in zip(states, (47, 57, 58, 57, 47), strict=True):
            assert int(state["logTime"]) == _image_ns(number)
            pixels = _rgba(state).astype(int)
            bits = [int(pixels[10, 4 + 8 * bit, :3].mean() > 128) for bit in range(8)]
            assert int("".join(map(str, bits)), 2) == number, topic
            assert pixels[38, 12, :3] == pytest.approx((220, 30, 30), abs=40), topic
            assert pixels[38, 52, :3] == pytest.approx((30, 30, 220), abs=40), topic
