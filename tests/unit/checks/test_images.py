"""Content checks of images: black, overexposed, frozen, blurred."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from kleinkram.recordings.recording_files import Openable
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, ros1_bag, ros2_mcap
from tests.unit.checks.content_checks import ERROR, NOT_MADE, OK, WARNING, only, run, statuses

RULES = 'images: {"/camera/*": {}}'
Picture = NDArray[np.uint8]
Pictures = Callable[[int], Picture]
WRITERS = pytest.mark.parametrize("write", [ros1_bag, ros2_mcap])


def scene(number: int) -> Picture:
    """A sharp picture with a square that moves."""
    picture = np.full((48, 64, 3), 90, np.uint8)
    picture[8:40, 4 + number % 40 : 20 + number % 40] = (200, 120, 60)
    picture[(number * 7) % 48, :, :] = number % 251
    return picture


def plain(brightness: int) -> Pictures:
    """Nearly uniform pictures with the noise of a sensor."""
    return lambda number: np.clip(
        np.random.default_rng(number).normal(brightness, 1, (48, 64, 3)).round(), 0, 255
    ).astype(np.uint8)


def limited_range(grey: Picture) -> Picture:
    """Return luma from 16 to 235."""
    return (16 + grey.astype(np.uint16) * 219 // 255).astype(np.uint8)


def raw(picture: Picture, encoding: str) -> dict[str, object]:
    """Return the fields of sensor_msgs/Image."""
    grey = picture.mean(axis=2).astype(np.uint8)
    if encoding == "rgb8":
        data = picture
    elif encoding == "bgr8":
        data = picture[..., ::-1]
    elif encoding in ("mono8", "bayer_rggb8", "8UC1"):
        data = grey
    elif encoding in ("rgba8", "bgra8"):
        opaque = np.full((*grey.shape, 1), 255, np.uint8)
        data = np.concatenate([picture if encoding == "rgba8" else picture[..., ::-1], opaque], axis=2)
    elif encoding == "nv12":
        data = np.concatenate([limited_range(grey), np.full((24, 64), 128, np.uint8)])
        return {"height": 48, "width": 64, "encoding": encoding, "step": 64, "data": data.tobytes()}
    elif encoding == "yuv422_yuy2":
        data = np.stack([limited_range(grey), np.full_like(grey, 128)], axis=-1)
    elif encoding == "mono16":
        data = grey.astype(np.uint16) * 16  # 12 bits in 16
    elif encoding == "yuv422":
        data = np.stack([np.full_like(grey, 128), limited_range(grey)], axis=-1)
    else:
        data = grey
    height, width = grey.shape
    raw_bytes = np.ascontiguousarray(data).tobytes()
    return {
        "height": height,
        "width": width,
        "encoding": encoding,
        "step": len(raw_bytes) // height,
        "data": raw_bytes,
    }


def compressed(picture: Picture, form: str) -> dict[str, object]:
    """Return the fields of sensor_msgs/CompressedImage."""
    out = io.BytesIO()
    Image.fromarray(picture).save(out, form)
    return {"format": form, "data": out.getvalue()}


def camera(pictures: Pictures, encoding: str = "jpeg", seconds: int = 10) -> Iterator[TimedMessage]:
    """Yield a camera of 10 Hz."""
    for number in range(seconds * 10):
        time_ns = T0 + number * SECOND // 10
        if encoding in ("jpeg", "png", "webp"):
            values = compressed(pictures(number), encoding)
            yield TimedMessage("/camera/front", "sensor_msgs/CompressedImage", time_ns, values, time_ns)
        else:
            yield TimedMessage("/camera/front", "sensor_msgs/Image", time_ns, raw(pictures(number), encoding), time_ns)


ENCODINGS = (
    "jpeg",
    "png",
    "rgb8",
    "bgr8",
    "mono8",
    "mono16",
    "bayer_rggb8",
    "yuv422",
    "8UC1",
    "rgba8",
    "bgra8",
    "nv12",
    "yuv422_yuy2",
    "webp",
)


@WRITERS
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_good_pictures_pass_in_every_encoding(encoding: str, write: Callable[..., Openable]) -> None:
    rows = run(RULES, write(camera(scene, encoding)))
    assert statuses(rows) == {"image.black": OK, "image.overexposed": OK, "image.frozen": OK}
    assert {(row.topic, row.file) for row in rows} == {("/camera/front", "a")}


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_black_pictures_are_found_in_every_encoding(encoding: str) -> None:
    rows = run(RULES, ros2_mcap(camera(plain(2), encoding)))
    black = only(rows, "image.black")
    assert black.status is ERROR
    assert black.message.startswith("20 of 20 pictures are black")
    assert black.value is not None
    assert black.value < 12
    assert (black.limit, black.time_ns) == (12, T0)
    assert only(rows, "image.overexposed").status is OK


@pytest.mark.parametrize("encoding", [name for name in ENCODINGS if name != "mono16"])
def test_overexposed_pictures_are_found(encoding: str) -> None:
    rows = run(RULES, ros2_mcap(camera(plain(253), encoding)))
    assert only(rows, "image.overexposed").status is ERROR
    assert only(rows, "image.black").status is OK


def test_pictures_of_16_bits_are_scaled_by_the_bits_that_are_used() -> None:
    dark_scene = ros2_mcap(camera(lambda number: scene(number) // 2, "mono16"))
    assert only(run(RULES, dark_scene), "image.black").status is OK


def test_some_black_pictures_are_allowed() -> None:
    def mostly_good(number: int) -> Picture:
        return plain(2)(number) if number < 5 else scene(number)

    row = only(run(RULES, ros2_mcap(camera(mostly_good))), "image.black")
    assert row.status is OK
    strict = 'images: {"/camera/*": {allowed: 0%, severity: warning}}'
    assert only(run(strict, ros2_mcap(camera(mostly_good))), "image.black").status is WARNING


@WRITERS
@pytest.mark.parametrize("encoding", ["jpeg", "rgb8"])
def test_a_camera_that_freezes_is_found_although_its_stamps_go_on(
    encoding: str, write: Callable[..., Openable]
) -> None:
    freezing = camera(lambda number: scene(min(number, 40)), encoding)
    frozen = only(run(RULES, write(freezing)), "image.frozen")
    assert frozen.status is ERROR
    assert frozen.value == pytest.approx(5.9)
    assert frozen.time_ns == T0 + 4 * SECOND


def test_a_standstill_shorter_than_the_limit_passes() -> None:
    pausing = camera(lambda number: scene(30 if 30 <= number < 48 else number))
    row = only(run(RULES, ros2_mcap(pausing)), "image.frozen")
    assert (row.status, row.value) == (OK, 1.7)


def test_black_pictures_do_not_show_whether_the_camera_is_frozen() -> None:
    uniform = camera(lambda _number: np.zeros((48, 64, 3), np.uint8))
    rows = run(RULES, ros2_mcap(uniform))
    assert only(rows, "image.frozen").status is NOT_MADE
    assert only(rows, "image.black").status is ERROR


def test_blurred_pictures_are_found_where_a_sharpness_is_set() -> None:
    def blurred(number: int) -> Picture:
        rows = np.linspace(60, 180, 48)[:, None, None] + number % 10
        return np.broadcast_to(rows, (48, 64, 3)).astype(np.uint8)

    rules = 'images: {"/camera/*": {min_sharpness: 20}}'
    assert only(run(rules, ros2_mcap(camera(scene))), "image.blurred").status is OK
    row = only(run(rules, ros2_mcap(camera(blurred))), "image.blurred")
    assert (row.status, row.limit) == (ERROR, 20)


def test_an_unknown_encoding_is_not_made_with_its_name() -> None:
    def unknown(number: int) -> TimedMessage:
        time_ns = T0 + number * SECOND // 10
        values = {**raw(scene(number), "mono8"), "encoding": "fancy42"}
        return TimedMessage("/camera/front", "sensor_msgs/Image", time_ns, values, time_ns)

    rows = run(RULES, ros2_mcap(unknown(number) for number in range(50)))
    assert statuses(rows) == {"image.black": NOT_MADE, "image.overexposed": NOT_MADE, "image.frozen": OK}
    assert "fancy42" in only(rows, "image.black").message


def test_a_broken_jpeg_is_not_made_rather_than_ignored() -> None:
    def broken(number: int) -> TimedMessage:
        values = compressed(scene(number), "jpeg")
        if number % 2:
            values["data"] = b"\xff\xd8 not a picture" + bytes([number])
        time_ns = T0 + number * SECOND // 10
        return TimedMessage("/camera/front", "sensor_msgs/CompressedImage", time_ns, values, time_ns)

    rows = run(RULES, ros2_mcap(broken(number) for number in range(40)))
    reasons = [row.message for row in rows if row.name == "image.black" and row.status is NOT_MADE]
    assert len(reasons) == 1
    assert "pictures cannot be read" in reasons[0]


def test_depth_is_judged_by_the_pixels_that_have_one() -> None:
    def depth(number: int, valid: int) -> TimedMessage:
        metres = np.zeros((48, 64), np.uint16)
        metres[:valid] = 1500 + number
        values = {"height": 48, "width": 64, "encoding": "16UC1", "step": 128, "data": metres.tobytes()}
        return TimedMessage("/camera/depth", "sensor_msgs/Image", T0 + number * SECOND // 10, values)

    good = run(RULES, ros2_mcap(depth(number, 40) for number in range(40)))
    assert set(statuses(good).values()) == {OK}
    blind = run(RULES, ros2_mcap(depth(number, 1) for number in range(40)))
    assert statuses(blind)["image.black"] is ERROR


def test_a_glob_leaves_out_topics_that_are_no_images() -> None:
    info = [TimedMessage("/camera/info", "sensor_msgs/CameraInfo", T0, {}, T0)]
    rows = run(RULES, ros2_mcap([*info, *camera(scene)]))
    assert {row.topic for row in rows} == {"/camera/front"}
    (row,) = {row.message for row in run(RULES, ros2_mcap(info))}
    assert row == "no topic that matches /camera/* has images: /camera/info has sensor_msgs/msg/CameraInfo"
