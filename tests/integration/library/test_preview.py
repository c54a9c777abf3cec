"""`preview`: what its pictures show, and what it says of whatever cannot be shown."""

from __future__ import annotations

import io
import json
import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from kleinkram.action.testing import TryOutResult, try_out
from kleinkram.client.actions import read_manifest
from kleinkram.contract.access import Right
from kleinkram.contract.actions import Network
from kleinkram.contract.checks import Verdict
from kleinkram.recordings.sample import Defect, Faults, SampleFormat, generate_file, generate_rig
from tests.integration.library.packages import LIBRARY
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, ros2_mcap

PREVIEW = LIBRARY / "preview.py"
RED, BLUE, BLACK = (220, 30, 40), (20, 60, 200), (0, 0, 0)


def preview(folder: Path, files: Mapping[str, Path | bytes], **parameters: str | int) -> TryOutResult:
    """Run it. Whatever the files are, it ends well, without a traceback, and the first preview is a picture."""
    folder.mkdir(exist_ok=True)
    ran = try_out(PREVIEW, folder, files=files, parameters={**parameters}, timeout_s=100)
    assert ran.exit_code == 0, ran.log
    assert ran.log == ""
    if ran.report.previews:
        first = ran.report.previews[0].path
        assert first == "overview.jpg"
        with Image.open(ran.out / first) as picture:
            assert (picture.format, picture.size) == ("JPEG", (640, 360))
        assert (ran.out / first).stat().st_size <= 100_000
    for one in ran.report.previews:
        assert (ran.out / one.path).stat().st_size > 0
    return ran


def names(ran: TryOutResult) -> list[str]:
    return [one.path for one in ran.report.previews]


def messages_of(ran: TryOutResult, code: str) -> list[str]:
    return [finding.message for finding in ran.report.findings if finding.code == code]


def mcap(*timed: TimedMessage) -> bytes:
    source = ros2_mcap(timed)
    return source.read(0, source.size_bytes)


def recording_files(folder: Path) -> dict[str, Path | bytes]:
    return {str(path.relative_to(folder)): path for path in folder.rglob("*") if path.is_file()}


def pixels(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def first_tile(path: Path) -> tuple[int, ...]:
    """The colour in the middle of the first frame of a contact sheet."""
    return tuple(int(value) for value in np.median(pixels(path)[90:130, 100:200], axis=(0, 1)))


def test_the_script_describes_itself() -> None:
    manifest = read_manifest(PREVIEW)
    assert (manifest.name, manifest.dependencies) == ("preview", ["open-kleinkram[reading]"])
    assert (manifest.right, manifest.network) == (Right.read, Network.none)
    assert (manifest.resources.cores, manifest.resources.memory_bytes) == (2, 10**9)
    assert [parameter.name for parameter in manifest.parameters] == ["topics", "exclude", "frames", "max_plots"]


# -- whole missions ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> TryOutResult:
    folder = tmp_path_factory.mktemp("rig")
    generate_rig(folder, duration_s=6)
    return preview(tmp_path_factory.mktemp("run"), recording_files(folder))


def test_a_robot_with_four_computers_has_all_kinds_of_pictures(rig: TryOutResult) -> None:
    paths = names(rig)
    assert paths[0] == "overview.jpg"
    assert [path.startswith("camera-") for path in paths[1:13]] == [True] * 12
    assert paths[13:] == [
        "cameras-over-time.jpg",
        "plots-1.png",
        "plots-2.png",
        "lidar-1-lidar-hesai-points.png",
        "lidar-2-lidar-livox-points.png",
        "track-gnss.png",
        "track.geojson",
        "track-odometry.png",
    ]
    assert rig.verdict in (None, Verdict.good)
    assert {finding.severity.value for finding in rig.report.findings} == {"info"}
    assert (rig.metric("cameras"), rig.metric("lidars")) == (12, 2)
    assert rig.metric("plotted_topics") >= 8


def test_the_titles_have_rate_and_resolution(rig: TryOutResult) -> None:
    (title,) = [one.title for one in rig.report.previews if "hdr-front" in one.path]
    assert title.startswith("/camera/hdr_front/image/compressed · sensor_msgs/msg/CompressedImage · ")
    assert " × " in title
    assert " Hz · " in title


def test_the_track_is_where_the_robot_was(rig: TryOutResult) -> None:
    (feature,) = json.loads((rig.out / "track.geojson").read_text())["features"]
    longitudes, latitudes = zip(*feature["geometry"]["coordinates"], strict=True)
    assert feature["properties"] == {"topic": "/gnss/fix", "positions": pytest.approx(60, abs=2)}
    assert 0 < (max(latitudes) - min(latitudes)) * 111_200 < 20  # it walks for four seconds
    assert max(longitudes) - min(longitudes) < 0.001


def test_a_camera_that_began_late_and_a_black_one_are_seen(tmp_path: Path) -> None:
    generate_rig(
        tmp_path / "rig", duration_s=6, faults=Faults(defects=frozenset((Defect.silent_start, Defect.black_camera)))
    )
    ran = preview(tmp_path / "run", recording_files(tmp_path / "rig"), topics="/camera/hdr_*", frames=6)
    assert names(ran)[1:] == [
        *(
            f"camera-0{number}-camera-hdr-{side}-image-compressed.jpg"
            for number, side in enumerate(("front", "left", "right"), 1)
        ),
        "cameras-over-time.jpg",
    ]
    strip = pixels(ran.out / "cameras-over-time.jpg").astype(int)
    bars = [strip[8 + 104 * row + 93] for row in range(3)]
    is_absent = [(bar[20:1260, 0] > 200) & (bar[20:1260, 2] < 230) for bar in bars]
    shares = [float(absent.mean()) for absent in is_absent]
    assert sorted(round(share, 1) for share in shares) == [0, 0, 0.4]


@pytest.mark.parametrize("kind", list(SampleFormat))
def test_every_format_gives_the_same_pictures(tmp_path: Path, kind: SampleFormat) -> None:
    name = "drive_rosbag2" if kind is SampleFormat.db3 else f"drive.{kind.value}"
    generate_file(tmp_path / name, kind=kind, duration_s=4, size_bytes=2_000_000)
    files = recording_files(tmp_path / name) if kind is SampleFormat.db3 else {name: tmp_path / name}
    ran = preview(tmp_path / "run", files)
    assert [Path(path).name.partition("-")[0].partition(".")[0] for path in names(ran)] == [
        *("overview", "camera", "cameras", "plots", "lidar", "track", "track", "track")
    ]
    assert not [finding for finding in ran.report.findings if finding.severity.value != "info"]


# -- encodings --------------------------------------------------------------------------------------------------------


def raw(encoding: str, data: bytes, bytes_per_pixel: int, side: int = 64) -> TimedMessage:
    values = {"height": side, "width": side, "encoding": encoding, "step": side * bytes_per_pixel, "data": data}
    return TimedMessage(f"/{encoding}", "sensor_msgs/Image", T0, values, T0)


def compressed(topic: str, form: str, data: bytes) -> TimedMessage:
    return TimedMessage(topic, "sensor_msgs/CompressedImage", T0, {"format": form, "data": data}, T0)


def encoded(colour: tuple[int, ...], form: str, side: int = 64) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (side, side), colour).save(out, form)
    return out.getvalue()


def bayer(colour: tuple[int, int, int], side: int = 64) -> bytes:
    mosaic = np.zeros((side, side), np.uint8)
    mosaic[::2, ::2], mosaic[::2, 1::2], mosaic[1::2, ::2], mosaic[1::2, 1::2] = (
        colour[place] for place in (0, 1, 1, 2)
    )
    return mosaic.tobytes()


def step_depth(near: float, far: float, kind: str, side: int = 64) -> np.ndarray[tuple[int, ...], Any]:
    """The left half is near, the right half far, and the top row is unknown."""
    depth = np.full((side, side), near)
    depth[:, side // 2 :] = far
    depth[0] = 0
    return depth.astype(kind)


def compressed_depth() -> bytes:
    out = io.BytesIO()
    Image.fromarray(step_depth(1000, 3000, "u2")).save(out, "png")
    return struct.pack("<iff", 0, 0.0, 0.0) + out.getvalue()


COLOUR_FRAMES = [
    raw("rgb8", bytes(RED) * 4096, 3),
    raw("bgr8", bytes(RED[::-1]) * 4096, 3),
    raw("8UC3", bytes(RED[::-1]) * 4096, 3),
    raw("rgba8", bytes((*RED, 9)) * 4096, 4),
    raw("bgra8", bytes((*RED[::-1], 9)) * 4096, 4),
    raw("bayer_rggb8", bayer(RED), 1),
    compressed("/jpeg", "rgb8; jpeg compressed bgr8", encoded(RED, "jpeg")),
    compressed("/png", "png", encoded(RED, "png")),
]
GREY_FRAMES = [
    raw("mono8", b"\x60" * 4096, 1),
    raw("mono16", np.linspace(0, 4095, 4096).astype("<u2").tobytes(), 2),
]
DEPTH_FRAMES = [
    raw("16UC1", step_depth(1000, 3000, "<u2").tobytes(), 2),
    raw("32FC1", step_depth(1, 3, "<f4").tobytes(), 4),
    compressed("/depth", "16UC1; compressedDepth png", compressed_depth()),
]


def test_every_encoding_of_images_has_its_colours(tmp_path: Path) -> None:
    frames = [*COLOUR_FRAMES, *GREY_FRAMES, *DEPTH_FRAMES]
    ran = preview(tmp_path, {"cameras.mcap": mcap(*frames)})
    assert ran.metric("cameras") == len(frames)
    assert not ran.report.findings
    sheets = {one.title.partition(" · ")[0]: ran.out / one.path for one in ran.report.previews if " · " in one.title}
    for frame in COLOUR_FRAMES:
        assert first_tile(sheets[frame.topic]) == pytest.approx(RED, abs=6), frame.topic
    assert first_tile(sheets["/mono8"]) == pytest.approx((0x60,) * 3, abs=4)
    for frame in DEPTH_FRAMES:
        tile = pixels(sheets[frame.topic])[60:360, 16:324]
        assert tuple(tile[150, 40]) == pytest.approx((68, 1, 84), abs=8), frame.topic  # near: violet
        assert tuple(tile[150, 260]) == pytest.approx((253, 231, 37), abs=8), frame.topic  # far: yellow


def test_frames_that_are_no_pictures_are_named_and_hide_no_others(tmp_path: Path) -> None:
    picture = encoded(BLUE, "jpeg")
    damaged = [
        TimedMessage("/camera", "sensor_msgs/CompressedImage", T0 + n * SECOND, {"format": "jpeg", "data": data}, T0)
        for n, data in enumerate([picture, picture[:200], b"", picture])
    ]
    bomb = io.BytesIO()
    Image.new("1", (9000, 9000)).save(bomb, "png")
    frames = [
        *damaged,
        compressed("/bomb", "png", bomb.getvalue()),
        compressed("/video", "h264", b"\0\0\0\1" * 20),
        raw("unheard_of", bytes(4096), 1),
        raw("rgb8", bytes(10), 3),
    ]
    ran = preview(tmp_path, {"cameras.mcap": mcap(*frames)})
    assert ran.metric("cameras") == 1
    assert first_tile(ran.out / "camera-01-camera.jpg") == pytest.approx(BLUE, abs=6)
    reasons = messages_of(ran, "frames.unreadable")
    assert [reason.partition(":")[0] for reason in reasons] == ["/bomb", "/camera", "/rgb8", "/unheard_of", "/video"]
    assert "9000 x 9000 pixels are more than 32000000" in reasons[0]
    assert "2 of 4 frames that were read cannot be shown" in reasons[1]
    assert "h264 video is not shown" in reasons[4]
    assert {finding.severity.value for finding in ran.report.findings} == {"info"}


def test_a_large_picture_is_shown_within_the_memory_of_the_run(tmp_path: Path) -> None:
    large = encoded(RED, "jpeg", side=5600)
    ran = preview(tmp_path, {"cameras.mcap": mcap(compressed("/large", "jpeg", large))})
    assert first_tile(ran.out / "camera-01-large.jpg") == pytest.approx(RED, abs=6)


# -- lidars and tracks ------------------------------------------------------------------------------------------------


def cloud(topic: str, xyz: np.ndarray[tuple[int, ...], Any], kind: str = "<f4", padding: int = 0) -> TimedMessage:
    """A cloud whose points have an intensity first, then z, y and x."""
    layout = np.dtype([("intensity", "u1"), ("z", kind), ("y", kind), ("x", kind), ("padding", f"V{padding}")])
    points = np.zeros(len(xyz), layout)
    for place, axis in enumerate("xyz"):
        points[axis] = xyz[:, place]
    code = {"<f4": 7, "<f8": 8, "<i2": 3}[kind]
    fields = (
        [
            {"name": name, "offset": layout.fields[name][1], "datatype": 2 if name == "intensity" else code, "count": 1}
            for name in ("intensity", "z", "y", "x")
        ]
        if layout.fields
        else []
    )
    step = layout.itemsize
    sizes = {"height": 1, "width": len(xyz), "point_step": step, "row_step": step * len(xyz)}
    values = {"fields": fields, "data": points.tobytes(), **sizes}
    return TimedMessage(topic, "sensor_msgs/PointCloud2", T0, values, T0)


def ring() -> np.ndarray[tuple[int, ...], Any]:
    """Points 8 m from the sensor; the left ones are low, the right ones high."""
    angles = np.linspace(0, 2 * np.pi, 2000)
    return np.stack([8 * np.cos(angles), 8 * np.sin(angles), np.cos(angles)], axis=-1)


def test_clouds_of_any_layout_are_seen_from_above(tmp_path: Path) -> None:
    infinite = np.concatenate([ring(), [[np.nan, 0, 0], [np.inf, 1, 1], [0, 0, 0]]])
    clouds = [
        cloud("/float", infinite),
        cloud("/double", ring(), "<f8", 7),
        cloud("/short", ring(), "<i2"),
        cloud("/empty", ring()[:0]),
    ]
    ran = preview(tmp_path, {"lidar.mcap": mcap(*clouds)})
    assert ran.metric("lidars") == 4
    assert names(ran) == [
        "overview.jpg",
        *(f"lidar-{n}-{topic}.png" for n, topic in enumerate(("double", "empty", "float", "short"), 1)),
    ]
    shown = pixels(ran.out / "lidar-3-float.png").astype(int)
    is_high = (shown[..., 0] > 150) & (shown[..., 2] < 60) & (shown[..., 1] < 80)
    is_low = (shown[..., 2] > 110) & (shown[..., 0] < 70) & (shown[..., 1] < 70)
    assert is_high.sum() > 50
    assert is_low.sum() > 50
    assert np.argwhere(is_high[80:430])[:, 1].mean() > np.argwhere(is_low[80:430])[:, 1].mean() + 100


def test_a_laser_scan_is_seen_from_above(tmp_path: Path) -> None:
    values = {"angle_min": -1.5, "angle_max": 1.5, "angle_increment": 0.01, "range_min": 0.1, "range_max": 30.0}
    scan = TimedMessage("/scan", "sensor_msgs/LaserScan", T0, {**values, "ranges": [5.0] * 301}, T0)
    ran = preview(tmp_path, {"scan.mcap": mcap(scan)})
    assert names(ran) == ["overview.jpg", "lidar-1-scan.png"]
    shown = pixels(ran.out / "lidar-1-scan.png").astype(int)
    is_point = (shown[..., 2] > 190) & (shown[..., 0] < 80)
    assert is_point.sum() > 200
    assert np.argwhere(is_point)[:, 1].min() > 200  # in front of the sensor


def pose(topic: str, second: float, x: float, y: float) -> TimedMessage:
    values = {"pose": {"pose": {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}}}
    return TimedMessage(topic, "nav_msgs/Odometry", T0 + round(second * SECOND), values, T0)


def test_tracks_share_a_picture_and_invalid_poses_are_left_out(tmp_path: Path) -> None:
    square = [(0, 0), (10, 0), (10, 10), (0, 10), (math.nan, 5), (0, 0)]
    poses = [pose("/odom", n, x, y) for n, (x, y) in enumerate(square)]
    far = [pose("/utm", n, 500_000 + n, 5_250_000) for n in range(6)]
    ran = preview(tmp_path, {"drive.mcap": mcap(*poses, *far)}, max_plots=0)
    assert names(ran) == ["overview.jpg", "track-odometry.png"]
    assert messages_of(ran, "positions.unusable") == ["/odom: 1 of 6 positions are invalid, and left out of the track"]
    shown = pixels(ran.out / "track-odometry.png").astype(int)
    blue = np.argwhere((shown[100:640, 70:740, 2] > 150) & (shown[100:640, 70:740, 0] < 90))
    height, width = np.ptp(blue, axis=0)
    assert height == pytest.approx(width, abs=12)  # equal axes
    assert width > 400


# -- what there is not ------------------------------------------------------------------------------------------------


def text(topic: str, second: float = 0) -> TimedMessage:
    return TimedMessage(topic, "std_msgs/String", T0 + round(second * SECOND), {"data": "hello"})


def number(topic: str, value: float, second: float = 0) -> TimedMessage:
    return TimedMessage(topic, "std_msgs/Float64", T0 + round(second * SECOND), {"data": value})


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({}, "it has no recordings"),
        ({"notes.txt": b"nothing"}, "it has no recordings"),
        ({"empty.mcap": mcap()}, "its recordings have no messages"),
    ],
)
def test_a_mission_without_messages_has_no_pictures(tmp_path: Path, files: dict[str, bytes], message: str) -> None:
    ran = preview(tmp_path, files)
    assert names(ran) == []
    assert messages_of(ran, "mission.empty") == [f"There is nothing to show of the mission: {message}."]


def test_a_mission_of_texts_shows_when_they_were_sent(tmp_path: Path) -> None:
    ran = preview(tmp_path, {"log.mcap": mcap(*(text(topic, n) for n in range(5) for topic in ("/a", "/b")))})
    assert names(ran) == ["overview.jpg"]
    assert messages_of(ran, "topics.not_shown") == [
        "2 topics are not shown, because their messages have no numbers to plot over time: /a, /b"
    ]


@pytest.mark.parametrize(
    "message",
    [
        number("/value", 3.0),
        number("/value", math.nan),
        text("/text"),
        RED_FRAME := (COLOUR_FRAMES[0]),
        pose("/odom", 0, 1, 2),
    ],
    ids=["number", "nan", "text", "frame", "pose"],
)
def test_one_message_is_enough(tmp_path: Path, message: TimedMessage) -> None:
    assert names(preview(tmp_path, {"one.mcap": mcap(message)}))


def test_times_that_are_all_zero_are_shown(tmp_path: Path) -> None:
    frames = [frame._replace(log_ns=0, stamp_ns=0) for frame in COLOUR_FRAMES[:2]]
    numbers = [number("/value", float(n))._replace(log_ns=0) for n in range(5)]
    ran = preview(tmp_path, {"zero.mcap": mcap(*frames, *numbers)})
    assert ran.metric("cameras") == 2
    assert ran.metric("plotted_topics") == 1


def test_numbers_alone_give_an_overview_of_plots(tmp_path: Path) -> None:
    ran = preview(tmp_path, {"numbers.mcap": mcap(*(number("/value", math.sin(n), n) for n in range(100)))})
    assert names(ran) == ["overview.jpg", "plots-1.png"]
    assert (pixels(ran.out / "overview.jpg")[..., 0] < 120).sum() > 300


def test_parameters_select_topics_frames_and_plots(tmp_path: Path) -> None:
    frames = [
        COLOUR_FRAMES[0]._replace(topic=topic, log_ns=T0 + n * SECOND) for n in range(9) for topic in ("/a", "/b")
    ]
    numbers = [number(f"/value{n % 4}", float(n), n) for n in range(40)]
    files = {"drive.mcap": mcap(*frames, *numbers)}
    ran = preview(tmp_path, files, topics="/a, /value*", exclude="/value3", frames=2, max_plots=2)
    assert names(ran) == ["overview.jpg", "camera-01-a.jpg", "cameras-over-time.jpg", "plots-1.png"]
    sheet = pixels(ran.out / "camera-01-a.jpg")
    assert sheet.shape[1] == 2 * 324 + 16
    assert messages_of(ran, "plots.left_out") == [
        "1 plot is left out, because at most 2 are made (max_plots): /value2 data"
    ]


def test_topics_of_any_name_and_schemas_that_cannot_be_decoded_are_reported(tmp_path: Path) -> None:
    from tests.recording_files.writers import McapWriter

    out = io.BytesIO()
    writer = McapWriter(out, profile="")
    schema = writer.add_schema("strange", "flatbuffer", b"\1\2")
    for name in ("/line\nbreak", "", "/" + "x" * 3000):
        writer.add_message(writer.add_channel(name, schema, "flatbuffer"), T0, b"data")
    writer.finish()
    ran = preview(tmp_path, {"strange.mcap": out.getvalue()})
    assert names(ran) == ["overview.jpg"]
    assert len(messages_of(ran, "topic.undecodable")) == 3


# -- real recordings --------------------------------------------------------------------------------------------------

REAL = [
    ("ros1/fiducials_compressed_image.bag", {"cameras": 1}),
    ("ros1/embag_pointcloud2_laserscan_odom_lz4.bag", {"lidars": 2}),
    ("ros1/robot_localization_test1_imu_odom_gps_bz2.bag", {"plotted_topics": 3}),
    ("ros1/scan_tools_laserscan.bag", {"lidars": 1}),
    ("ros1/turtlesim_lz4.bag", {"plotted_topics": 1}),
    ("ros1/kleinkram_imu_lz4.bag", {"plotted_topics": 1}),
    ("mcap/image_message_zstd_inside_mcap.mcap", {"cameras": 0}),  # its message is no CDR
    ("mcap/foxglove_pose_protobuf_plus_json_zstd.mcap", {}),
    ("mcap/rosbag2_all_sensor_msgs_none.mcap", {}),
    ("mcap/kleinkram_imu_ros1profile_zstd.mcap", {"plotted_topics": 1}),
    ("mcap/SO_bag", {}),
    ("mcap/split_wbag", {}),
    ("ros2-db3/vicon_standard2", {}),
    ("ros2-db3/event_camera", {}),
    ("ros2-db3/file_zstd_split", {}),
    ("other/px4_sample.ulg", {"plotted_topics": 1}),
]


def real_files(recordings_dir: Path, name: str) -> dict[str, Path | bytes]:
    path = recordings_dir / name
    return recording_files(path) if path.is_dir() else {path.name: path}


@pytest.mark.parametrize(("name", "least"), REAL, ids=[name for name, _ in REAL])
def test_real_recordings_have_pictures(
    tmp_path: Path, recordings_dir: Path, name: str, least: Mapping[str, int]
) -> None:
    ran = preview(tmp_path, real_files(recordings_dir, name))
    assert names(ran)
    for metric, value in least.items():
        assert ran.metric(metric) >= value, metric
    assert {finding.severity.value for finding in ran.report.findings} <= {"info"}


@pytest.mark.parametrize(
    ("name", "codes"),
    [
        ("broken/truncated.bag", {"recording.damaged"}),
        ("broken/truncated.mcap", {"recording.damaged"}),
        ("broken/zero_length.bag", {"recording.unreadable", "mission.empty"}),
        ("derived/auv_zstd_bitflip_chunk2.mcap", {"recording.damaged"}),
        ("derived/auv_zstd_cut_60pct.mcap", {"recording.damaged"}),
        ("derived/cut_vicon.db3", {"recording.damaged"}),
        ("derived/magic_only.mcap", {"recording.unreadable", "mission.empty"}),
    ],
)
def test_of_a_damaged_recording_what_can_be_read_is_shown(
    tmp_path: Path, recordings_dir: Path, name: str, codes: set[str]
) -> None:
    ran = preview(tmp_path, real_files(recordings_dir, name))
    warnings = {finding.code for finding in ran.report.findings if finding.severity.value != "info"}
    assert warnings | ran.codes().intersection({"mission.empty"}) == codes
    assert bool(names(ran)) is ("mission.empty" not in codes)


def test_one_broken_recording_hides_no_other(tmp_path: Path) -> None:
    good = mcap(*(number("/value", float(n), n) for n in range(5)))
    ran = preview(tmp_path, {"good.mcap": good, "bad.mcap": b"\x89MCAP0\r\n" + bytes(50)})
    assert names(ran) == ["overview.jpg", "plots-1.png"]
    assert len(messages_of(ran, "recording.unreadable") + messages_of(ran, "recording.damaged")) == 1


def test_the_track_of_a_real_receiver_is_in_its_bounding_box(tmp_path: Path, recordings_dir: Path) -> None:
    ran = preview(tmp_path, real_files(recordings_dir, "ros1/robot_localization_test1_imu_odom_gps_bz2.bag"))
    features: Sequence[Any] = json.loads((ran.out / "track.geojson").read_text())["features"]
    positions = np.concatenate([np.array(feature["geometry"]["coordinates"]) for feature in features])
    assert len(positions) > 10
    assert np.ptp(positions, axis=0).max() < 0.01
