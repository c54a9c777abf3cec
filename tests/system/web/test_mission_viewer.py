"""The viewer of a mission in a real browser: what it shows at a time is what the SDK reads at that time."""

import base64
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kleinkram.recordings import Recording
from kleinkram.recordings.decoding import image
from kleinkram.recordings.sample import generate_bag, generate_db3, generate_mcap
from kleinkram.recordings.writing.mcap_writer import McapWriter
from tests.acceptance.conftest import wait_until
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_MCAP_BYTES, _SMALL_BYTES = 40_000_000, 8_000_000
_CAMERA, _IMU, _ODOM = "/camera/image/compressed", "/imu/data", "/odom"
_TRANSFORMS = ("/tf", "/tf_static")
# JPEG decoders may round differently.
_ROUNDING = 2
_LEVELS = ("DEBUG", "INFO", "WARNING", "ERROR")
_LINES = 40
_ROUNDED_NS = 1_000
# A few pixels of a plot.
_CLICK_NS = 50_000_000


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_viewer_shows_what_was_recorded_at_each_time(
    shared_cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    day = tmp_path / "day"
    day.mkdir()
    mcap = generate_mcap(day / "drive.mcap", size_bytes=_MCAP_BYTES)
    paths = {
        "drive.mcap": mcap.path,
        "drive.bag": generate_bag(day / "drive.bag", size_bytes=_SMALL_BYTES).path,
        "drive_rosbag2/drive_rosbag2_0.db3": generate_db3(day / "drive_rosbag2", size_bytes=_SMALL_BYTES).path,
        "log.mcap": _write_log(day / "log.mcap", mcap.start_ns),
    }
    terminal = shared_cluster.terminal
    terminal.run("project", "create", "Valais")
    (tmp_path / "metadata.yaml").write_text("depot: {latitude: 46.9, longitude: 7.4}\nrobot: anymal\n")
    place = ("-p", "Valais", "-m", "day", "--create", "--metadata", tmp_path / "metadata.yaml")
    terminal.run("upload", *place, "--wait", f"{day}/")

    def files() -> dict[str, dict[str, Any]]:
        return {file["path"]: file for file in terminal.run("file", "list", "-p", "Valais", "--json").json()["items"]}

    wait_until(lambda: all(files()[name]["content"] == "indexed" for name in paths), "the files to be read")
    known = files()
    keys = {name: known[name]["recording_id"][:8] for name in paths}
    mcap_key = keys["drive.mcap"]
    panels = {
        "mcapImage": f"image:{mcap_key}@{_CAMERA}",
        "bagImage": f"image:{keys['drive.bag']}@{_CAMERA}",
        "db3Image": f"image:{keys['drive_rosbag2/drive_rosbag2_0.db3']}@{_CAMERA}",
        "imu": f"raw:{mcap_key}@{_IMU}",
        "plot": f"plot*:{mcap_key}@{_IMU},linear_acceleration.x,linear_acceleration.z",
        "twoTopics": f"plot*:{mcap_key}@{_IMU},linear_acceleration.x;{keys['drive.bag']}@{_ODOM},pose.pose.position.x",
        "log": f"log:{keys['log.mcap']}@/log",
        "map": f"map:{mcap_key}@/gps/fix",
        **_computed_panels(mcap_key, keys["drive.bag"]),
    }
    later_ns = mcap.start_ns + 2_345_678_901
    mission_id, file_id = known["drive.mcap"]["mission"]["id"], known["drive.mcap"]["id"]
    shared = ("drive.mcap", "drive_rosbag2/drive_rosbag2_0.db3")
    share = terminal.run("share", "create", *shared, "-p", "Valais", "-m", "day", "--json").json()
    arguments = (mission_id, file_id, json.dumps(panels), later_ns, share["url"], share["share"]["id"])
    results = run_browser("viewer.mjs", shared_cluster, pictures, *arguments, timeout_s=560)

    assert [results[name] for name in ("consoleErrors", "axe", "overflowing", "executed")] == [[], [], [], []]
    first_row, others = [f"Image: {_CAMERA}", "3D: /lidar/points"], ["Map: /gps/fix", f"Raw messages: {_IMU}"]
    assert results["defaults"] == [*first_row, f"Plot: {_IMU}", *others, "Log: /log"]
    _assert_formats(results["later"], paths, later_ns)
    imu_count = next(topic.count for topic in mcap.topics if topic.name == _IMU)
    assert int(results["later"]["plot"]["messages"]) < imu_count, "a plot reads part of a large recording"
    assert "In the grey parts, curves come from the preview" in results["notice"]
    assert int(results["whole"]["messages"]) == imu_count
    assert results["whole"]["values"] == results["later"]["plot"]["values"]
    _assert_map(results["map"], next(topic.count for topic in mcap.topics if topic.name == "/gps/fix"))
    _assert_steps(results, paths["drive.mcap"], later_ns)
    playing = results["playing"]
    assert playing["movedImage"]
    assert playing["isStill"]
    assert int(playing["playedNs"]) < (playing["elapsedMs"] + 1_000) * 1e6, "it does not play faster than time passes"
    assert results["link"]["after"] == results["link"]["before"]
    assert results["link"]["before"]["panels"][0] == [f"Image: {_CAMERA}", True]
    assert results["link"]["before"]["loop"] == results["link"]["before"]["time"]
    odom = _valid(paths["drive.bag"], _ODOM, later_ns).value.pose.pose.position.x
    imu = _valid(paths["drive.mcap"], _IMU, later_ns).value
    assert _numbers(results["twoTopics"]["values"]) == [
        ("linear_acceleration.x", imu.linear_acceleration.x),
        ("pose.pose.position.x", odom),
    ]
    middle_ns = (int(results["home"]) + int(results["end"])) // 2
    assert abs(int(results["clicked"]) - middle_ns) < _CLICK_NS
    assert results["added"] == ["linear_acceleration.x", "angular_velocity.x", "pose.pose.position.x"]
    before_ns, zoomed_ns, added_ns = (int(results["zoomed"][name]) for name in ("before", "zoomed", "added"))
    assert before_ns < (int(results["home"]) + middle_ns) / 2 < zoomed_ns
    assert added_ns == pytest.approx(zoomed_ns, rel=0, abs=_CLICK_NS), "a further curve leaves the plot zoomed in"
    _assert_computed(results["computed"], paths, later_ns)
    assert results["log"]["lines"] == str(_LINES)
    assert results["log"]["texts"] == [f"line {number}" for number in range(_LINES)]
    assert results["log"]["errors"] == [f"line {number}" for number in range(_LINES) if number % len(_LEVELS) == 3]
    assert results["log"]["jumped"][0] == results["log"]["jumped"][1]
    with Recording.open(paths["drive.mcap"]) as recording:
        fix = next(iter(recording.messages("/gps/fix")))
    assert int(results["gps"]["logTime"]) == fix.log_time_ns
    assert dict(results["gps"]["leaves"])["latitude"] == str(fix.value.latitude)
    _assert_slice(results["sliced"], paths["drive.mcap"], later_ns, tmp_path / "slice.mcap")
    _assert_shared(results, paths["drive.mcap"], later_ns)
    assert share["secret"] not in (shared_cluster.data_dir / "logs").joinpath("api.log").read_text()


def _assert_slice(sliced: dict[str, Any], path: Path, start_ns: int, saved: Path) -> None:
    """The file that other programs open has the messages of the shown topic in the range, and the transforms."""
    end_ns = start_ns + 1_000_000_000
    assert sliced["name"] == "drive.slice.mcap"
    saved.write_bytes(base64.b64decode(sliced["bytes"]))
    with Recording.open(path) as recording, Recording.open(saved) as slice_:
        expected = [message.log_time_ns for message in recording.messages(_IMU)]
        assert sorted(topic.name for topic in slice_.topics) == [_IMU, *_TRANSFORMS]
        assert [message.log_time_ns for message in slice_.messages(_IMU)] == [
            time_ns for time_ns in expected if start_ns <= time_ns <= end_ns
        ]
    topics = " ".join(f"--topics {name}" for name in (_IMU, *_TRANSFORMS))
    assert f"{topics} --start {start_ns} --end {end_ns + 1} -o view.slice.mcap" in sliced["command"]
    assert sliced["viewers"][0].startswith("https://app.foxglove.dev/~/view?ds=remote-file&ds.url=http")


def _assert_shared(results: dict[str, Any], path: Path, at_ns: int) -> None:
    """Somebody with a link sees the same picture and the same curve, and nothing of other files or of the app."""
    shared = results["shared"]
    assert shared["defaults"][0] == f"Image: {_CAMERA}"
    assert "Log: /log" not in shared["defaults"]
    assert not [text for text in shared["topics"] if "/log" in text or "drive.bag" in text], "they are not shared"
    assert [text for text in shared["topics"] if _IMU in text]
    assert [href for href in shared["links"] if not href.startswith("/s#")] == [], "nothing leads to the app"
    assert not {"Layouts", "Add event here"} & set(shared["buttons"])
    assert int(shared["time"]) == at_ns
    _assert_picture(shared["image"], path, at_ns)
    assert shared["plot"]["values"] == results["later"]["plot"]["values"]
    assert shared["hiddenLines"] == 0, "a panel of an address shows nothing of a file that is not shared"
    assert shared["keepsSecret"]
    assert (shared["sentSecret"], shared["withoutLink"]) == (0, [])


def _assert_map(shown: dict[str, Any], fix_count: int) -> None:
    assert 0 < shown["positions"] < fix_count, "a map reads part of a large recording"
    assert shown["rough"] > 0, "and shows the rest from the preview"
    assert shown["marks"] == ["depot"]
    whole = shown["whole"]
    assert (whole["positions"], whole["rough"]) == (fix_count, 0)
    # The noise of single fixes makes the whole track somewhat longer than the thinned one.
    assert shown["rough"] + shown["read"] == pytest.approx(whole["read"], rel=0.3)


def _computed_panels(mcap: str, bag: str) -> dict[str, str]:
    """Plots of computed curves on two axes, over log and header times. Commas within curves are escaped."""
    other = f"difference(linear_acceleration.x!2c{bag}@{_ODOM}!2cpose.pose.position.x)@right"
    own = "derivative(linear_acceleration.x),difference(linear_acceleration.x!2clinear_acceleration.y)"
    series = f"{mcap}@{_IMU},norm(linear_acceleration)@right,{own},{other};{bag}@{_ODOM},pose.pose.position.x"
    return {"computed": f"plot*:{series}", "header": f"plot*@header:{series}"}


def _assert_computed(results: dict[str, Any], paths: dict[str, Path], at_ns: int) -> None:
    logged, stamped = results["logged"], results["stamped"]
    for shown, time_of in ((logged, _log_ns), (stamped, _stamp_ns)):
        assert dict(_numbers(shown["values"])) == pytest.approx(_computed(paths, at_ns, time_of), rel=1e-9, abs=1e-9)
        assert shown["axes"] == 3, "time, left and right"
    derivatives = [dict(_numbers(shown["values"]))["derivative(linear_acceleration.x)"] for shown in (logged, stamped)]
    assert derivatives[0] != derivatives[1], "the times of headers differ from those of the log"
    assert stamped["unstamped"] == "0"
    assert logged["unstamped"] is None
    assert logged["needsZoom"], "the preview has no computed curves"
    assert [unit for _, unit, _ in logged["units"]] == ["m/s²", "m/s³", "m/s²", None, "m"]
    assert [side for _, _, side in logged["units"]] == ["right", "left", "left", "right", "left"]
    assert results["reopened"] == stamped, "a link shows the very same"
    pointer = results["pointer"]
    expected = _computed(paths, int(pointer["timeNs"]), _log_ns)
    assert abs(int(pointer["timeNs"]) - at_ns) > _CLICK_NS
    assert dict(_numbers(pointer["values"])) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert results["added"]["values"] == ["linear_acceleration.x", "norm(angular_velocity)", "pose.pose.position.x"]
    assert "norm(angular_velocity)@right" in results["added"]["address"]
    assert "plot*@header:" in results["added"]["address"]


def _log_ns(message: Any) -> int:
    return int(message.log_time_ns)


def _stamp_ns(message: Any) -> int:
    stamp = message.value.header.stamp
    is_ros1 = hasattr(stamp, "secs")
    seconds, nanoseconds = (stamp.secs, stamp.nsecs) if is_ros1 else (stamp.sec, stamp.nanosec)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _computed(paths: dict[str, Path], at_ns: int, time_of: Callable[[Any], int]) -> dict[str, float]:
    """Return the values of the computed curves by the last message until a time."""
    with Recording.open(paths["drive.mcap"]) as recording:
        before, last = sorted((one for one in recording.messages(_IMU) if time_of(one) <= at_ns), key=time_of)[-2:]
    with Recording.open(paths["drive.bag"]) as recording:
        poses = sorted((time_of(one), one.value.pose.pose.position.x) for one in recording.messages(_ODOM))
    acceleration, earlier = last.value.linear_acceleration, before.value.linear_acceleration
    other = [x for time_ns, x in poses if time_ns <= time_of(last)][-1]
    return {
        "norm(linear_acceleration)": math.sqrt(acceleration.x**2 + acceleration.y**2 + acceleration.z**2),
        "derivative(linear_acceleration.x)": (acceleration.x - earlier.x) / ((time_of(last) - time_of(before)) / 1e9),
        "difference(linear_acceleration.x,linear_acceleration.y)": acceleration.x - acceleration.y,
        "difference": acceleration.x - other,
        "pose.pose.position.x": [x for time_ns, x in poses if time_ns <= at_ns][-1],
    }


def _assert_formats(results: dict[str, Any], paths: dict[str, Path], at_ns: int) -> None:
    assert int(results["time"]) == at_ns
    for name, path in zip(("mcap", "bag", "db3"), paths.values(), strict=False):
        _assert_picture(results[name], path, at_ns)
    imu = _valid(paths["drive.mcap"], _IMU, at_ns)
    assert int(results["imu"]["logTime"]) == imu.log_time_ns
    leaves = results["imu"]["leaves"]
    numbers = [(name, float(text)) for name, text in leaves if name in ("x", "z")]
    for field in (imu.value.orientation, imu.value.angular_velocity, imu.value.linear_acceleration):
        assert ("x", field.x) in numbers
        assert ("z", field.z) in numbers
    assert ["frame_id", imu.value.header.frame_id] in leaves
    acceleration = imu.value.linear_acceleration
    expected = [("linear_acceleration.x", acceleration.x), ("linear_acceleration.z", acceleration.z)]
    assert _numbers(results["plot"]["values"]) == expected


def _assert_steps(results: dict[str, Any], path: Path, at_ns: int) -> None:
    with Recording.open(path) as recording:
        times = [message.log_time_ns for message in recording.messages(_CAMERA)]
        start_ns, end_ns = recording.start_ns, recording.end_ns
    first = max(place for place, time_ns in enumerate(times) if time_ns <= at_ns)
    for name, place in (("next", first + 1), ("nextAgain", first + 2), ("previous", first + 1)):
        _assert_picture(results[name], path, times[place])
    assert results["second"] == "1000000000"
    assert start_ns is not None
    assert end_ns is not None
    assert 0 <= start_ns - int(results["home"]) <= _ROUNDED_NS
    assert int(results["end"]) >= end_ns


def _valid(path: Path, topic: str, at_ns: int) -> Any:
    """Return the last message at or before a time."""
    with Recording.open(path) as recording:
        return [message for message in recording.messages(topic) if message.log_time_ns <= at_ns][-1]


def _assert_picture(results: dict[str, Any], path: Path, at_ns: int) -> None:
    message = _valid(path, _CAMERA, at_ns)
    assert int(results["logTime"]) == message.log_time_ns
    pixels = image(message.value)[:, :, 0]
    grey = np.frombuffer(base64.b64decode(results["grey"]), np.uint8).reshape(results["height"], results["width"])
    assert grey.shape == pixels.shape
    assert int(np.abs(grey.astype(int) - pixels.astype(int)).max()) <= _ROUNDING
    assert int(grey.max()) - int(grey.min()) > 100, "the picture has one colour"


def _numbers(values: list[list[str]]) -> list[tuple[str, float]]:
    """Return values by curve. The name of a difference to another topic, which has its recording, is shortened."""
    return [("difference" if "@" in name else name, float(text)) for name, text in values]


def _write_log(path: Path, start_ns: int) -> Path:
    with path.open("wb") as file:
        writer = McapWriter(file)
        channel = writer.add_channel("/log", writer.add_schema("foxglove.Log", "jsonschema", b"{}"), "json")
        for number in range(_LINES):
            line = {"level": _LEVELS[number % len(_LEVELS)], "name": "driver", "message": f"line {number}"}
            writer.add_message(channel, start_ns + number * 100_000_000, json.dumps(line).encode())
        writer.finish()
    return path
