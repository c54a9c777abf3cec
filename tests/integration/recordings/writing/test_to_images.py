"""`Recording.to_images`: files and their index hold the images of the messages."""

from __future__ import annotations

import base64
import csv
import fcntl
import io
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from PIL import Image

from kleinkram.recordings import CannotWrite, ImageOptions, Recording
from kleinkram.recordings.decoding import image
from kleinkram.recordings.sample import generate_bag, generate_mcap
from tests.recording_files.builders import T0, Watched
from tests.recording_files.corpus import Entry, params
from tests.recording_files.ros_messages import SECOND, TimedMessage, ros2_mcap
from tests.recording_files.tables import json_mcap

CAMERA = "/camera/image/compressed"
FORMATS = "MCAP", "ROS1 bag 2.0", "ROS2 sqlite3 db3"


def index_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "index.csv").open(encoding="utf-8", newline="") as file:
        return [*csv.DictReader(file)]


def jpeg(width: int = 4, height: int = 3) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (width, height), (200, 10, 10)).save(out, "JPEG")
    return out.getvalue()


def camera(count: int, *, stamp_ns: int | None = None, data: bytes | None = None) -> list[TimedMessage]:
    """Images at 10 Hz."""
    values = {"format": "jpeg", "data": jpeg() if data is None else data}
    step = SECOND // 10
    return [
        TimedMessage("/cam", "sensor_msgs/CompressedImage", T0 + n * step, values, stamp_ns or T0 + n * step + 5)
        for n in range(count)
    ]


@pytest.mark.parametrize("entry", params(*FORMATS))
def test_images_of_every_recording(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    with Recording.open(recordings_dir / entry.name) as recording:
        result = recording.to_images(tmp_path)
        for file in result.files:
            rows = index_of(file.path)
            assert len(rows) == file.row_count
            assert file.row_count + file.failed_count == sum(1 for _ in recording.raw_messages(file.topic))
            values = {message.log_time_ns: message.value for message in recording.messages(file.topic)}
            for row in rows:
                value = values[int(row["log_time_ns"])]
                with Image.open(file.path / row["file"]) as opened:
                    pixels = np.asarray(opened)
                assert pixels.shape[:2] == (int(row["height"]), int(row["width"]))
                if row["file"].endswith((".jpg", ".png")) and hasattr(value, "format"):
                    assert bytes(value.data).endswith((file.path / row["file"]).read_bytes())
                elif not str(value.encoding).lower().startswith(("8uc3", "8uc4", "16uc3", "16uc4")):
                    assert np.array_equal(pixels.reshape(image(value).shape), image(value), equal_nan=True)


def test_files_are_the_bytes_that_the_mcap_reader_reads(tmp_path: Path) -> None:
    generate_mcap(tmp_path / "drive.mcap", duration_s=2, size_bytes=4_000_000)
    with Recording.open(tmp_path / "drive.mcap") as recording:
        (file,) = recording.to_images(tmp_path / "out").files
    rows = index_of(file.path)
    with (tmp_path / "drive.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        messages = [*reader.iter_decoded_messages([CAMERA])]
    assert file.path == tmp_path / "out" / "camera.image.compressed"
    assert len(rows) == len(messages) > 5
    for row, (_, _, message, value) in zip(rows, messages, strict=True):
        stamp = value.header.stamp.sec * SECOND + value.header.stamp.nanosec
        assert row["file"] == f"{stamp}.jpg"
        assert (int(row["stamp_ns"]), int(row["log_time_ns"])) == (stamp, message.log_time)
        assert row["frame_id"] == value.header.frame_id == file.frame_id
        assert (file.path / row["file"]).read_bytes() == bytes(value.data)
    assert {path.name for path in file.path.iterdir()} == {"index.csv", *(row["file"] for row in rows)}
    assert file.size_bytes == sum(path.stat().st_size for path in file.path.iterdir())


@pytest.mark.parametrize(
    ("options", "numbers"),
    [
        (ImageOptions(every=4), [0, 4, 8]),
        (ImageOptions(rate_hz=2), [0, 5]),
        (ImageOptions(rate_hz=100), [*range(10)]),
        (ImageOptions(rate_hz=3), [0, 4, 7]),
    ],
)
def test_some_of_the_images(tmp_path: Path, options: ImageOptions, numbers: list[int]) -> None:
    with Recording.open(ros2_mcap(camera(10))) as recording:
        (file,) = recording.to_images(tmp_path, images=options).files
    assert [(int(row["log_time_ns"]) - T0) * 10 // SECOND for row in index_of(file.path)] == numbers


def test_a_low_rate_reads_only_what_it_needs(tmp_path: Path) -> None:
    """100 s at 10 Hz in chunks of about 1 s."""
    noise = np.random.default_rng(1).bytes(2000)
    mission = ros2_mcap(camera(1000, data=jpeg() + noise), chunk_bytes=20_000)
    sizes = []
    for options in (ImageOptions(), ImageOptions(rate_hz=0.1)):
        counted = Watched(mission)
        with Recording.open(counted) as recording:
            (file,) = recording.to_images(tmp_path / str(options.rate_hz), images=options).files
        sizes.append(counted.bytes_read)
    assert [int(row["log_time_ns"]) - T0 for row in index_of(file.path)] == [n * 10 * SECOND for n in range(10)]
    assert sizes[1] < sizes[0] / 4


@given(
    st.lists(st.integers(0, 3000), min_size=1, max_size=40), st.sampled_from([0.4, 1.0, 5.0]), st.integers(200, 4000)
)
def test_images_at_a_rate_are_the_first_of_each_part(
    tmp_path_factory: pytest.TempPathFactory, times: list[int], rate_hz: float, chunk_bytes: int
) -> None:
    """Whatever the times (in units of 10 ms) and chunks: as picked from all images."""
    (image_message,) = camera(1)
    times = sorted(times)
    messages = [image_message._replace(log_ns=T0 + time * SECOND // 100) for time in times]
    with Recording.open(ros2_mcap(messages, chunk_bytes=chunk_bytes)) as recording:
        (file,) = recording.to_images(tmp_path_factory.mktemp("images"), images=ImageOptions(rate_hz=rate_hz)).files
    slots: dict[int, int] = {}
    for time in times:
        slots.setdefault((time - times[0]) * SECOND // 100 // round(SECOND / rate_hz), time)
    assert [(int(row["log_time_ns"]) - T0) * 100 // SECOND for row in index_of(file.path)] == [*slots.values()]


def test_images_of_one_stamp_have_numbers(tmp_path: Path) -> None:
    with Recording.open(ros2_mcap(camera(3, stamp_ns=12))) as recording:
        (file,) = recording.to_images(tmp_path).files
    stem = f"{12:019d}"
    assert [row["file"] for row in index_of(file.path)] == [f"{stem}.jpg", f"{stem}-2.jpg", f"{stem}-3.jpg"]


def test_broken_images_are_counted(tmp_path: Path) -> None:
    messages = [*camera(2), *(m._replace(log_ns=m.log_ns + SECOND) for m in camera(1, data=b"no image"))]
    with Recording.open(ros2_mcap(messages)) as recording:
        (file,) = recording.to_images(tmp_path).files
    assert (file.row_count, file.failed_count) == (2, 1)
    assert "its image cannot be read" in file.failure


def test_texts_and_stamps_of_json_may_be_anything(tmp_path: Path) -> None:
    data = base64.b64encode(jpeg()).decode()
    images = [
        {"timestamp": {"sec": sec, "nsec": 0}, "frame_id": "\ud800", "format": "../\udc00", "data": data}
        for sec in (5, 10**300, -5)
    ]
    source = json_mcap(images, name="foxglove.CompressedImage")
    with Recording.open(source) as recording:
        (file,) = recording.to_images(tmp_path).files
    assert (file.row_count, file.failed_count, file.frame_id) == (2, 1, "?")
    assert "its stamp is beyond all times" in file.failure
    assert [row["encoding"] for row in index_of(file.path)] == ["../?"] * 2


def test_topics_without_images_are_named(tmp_path: Path) -> None:
    imu = TimedMessage("/imu", "sensor_msgs/Imu", T0, {}, T0)
    with Recording.open(ros2_mcap([*camera(1, data=b"no image"), imu])) as recording:
        every, both = recording.to_images(tmp_path), recording.to_images(tmp_path, ["/imu", "/cam"])
    assert [item.topic for item in every.left_out] == ["/cam"]
    reasons = {item.topic: item.reason for item in both.left_out}
    assert reasons["/imu"] == "its messages, sensor_msgs/msg/Imu, are no images"
    assert "its image cannot be read" in reasons["/cam"]
    assert [*tmp_path.iterdir()] == []


def test_a_folder_is_not_replaced(tmp_path: Path) -> None:
    with Recording.open(ros2_mcap(camera(1))) as recording:
        recording.to_images(tmp_path)
        with pytest.raises(CannotWrite, match="there is such a file or folder"):
            recording.to_images(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["cam"]


def test_two_processes_do_not_write_the_same_folder(tmp_path: Path) -> None:
    part = tmp_path / ".cam.part"
    part.mkdir()
    (part / "1.png").write_bytes(b"of the other process")
    descriptor = os.open(part, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    with Recording.open(ros2_mcap(camera(1))) as recording:
        with pytest.raises(CannotWrite, match="another process is writing it"):
            recording.to_images(tmp_path)
        assert (part / "1.png").exists()
        os.close(descriptor)  # as if it were killed
        (file,) = recording.to_images(tmp_path).files
    assert sorted(path.name for path in file.path.iterdir()) == [f"{T0 + 5:019d}.jpg", "index.csv"]


def test_an_error_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a full disk does in the middle of the images."""

    def full(_self: Path, *_arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("kleinkram.recordings.writing.image_files._write", full)
    with (
        Recording.open(ros2_mcap(camera(2))) as recording,
        pytest.raises(CannotWrite, match="cannot be written: No space left on device"),
    ):
        recording.to_images(tmp_path)
    assert [*tmp_path.iterdir()] == []


def test_a_bag_has_the_same_images(tmp_path: Path) -> None:
    generate_mcap(tmp_path / "drive.mcap", duration_s=1, size_bytes=2_000_000)
    generate_bag(tmp_path / "drive.bag", duration_s=1, size_bytes=2_000_000)
    folders = []
    for name in ("drive.mcap", "drive.bag"):
        with Recording.open(tmp_path / name) as recording:
            (file,) = recording.to_images(tmp_path / f"{name}.out").files
        folders.append({path.name: path.read_bytes() for path in file.path.glob("*.jpg")})
    assert folders[0] == folders[1] != {}
