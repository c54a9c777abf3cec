"""A recording with pictures of many kinds: depth, annotations, damaged ones and video.

Depth is encoded here from the descriptions of the formats, independently of what the viewer decodes with.
"""

import base64
import io
import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.message_factory import GetMessages
from numpy.typing import NDArray
from PIL import Image

from kleinkram.recordings.writing.mcap_writer import McapWriter

START_NS = 1_700_000_000_000_000_000
STEP_NS = 100_000_000
COUNT = 40
WIDTH, HEIGHT = 64, 48
# Detections are published later than the picture that they are made from.
DELAY_NS = 30_000_000
# Each is one message of a topic, between two good ones.
BAD_RAW = ("0 × 0", "rows of 10 bytes for 8 × 8", "60 bytes for 8 × 8", "60000 × 60000")
BAD_COMPRESSED = ("image/jpeg", "image/png", "0 bytes", "it does not say its size")

Pixels = NDArray[np.uint8]
Values = NDArray[np.float32]


class VideoFrame(NamedTuple):
    """A coded frame, in base64."""

    data: str
    format: str


def depth_mm(number: int) -> NDArray[np.uint16]:
    """Depth with a ramp, parts that were not measured, and a few measurements that are far out."""
    ramp = 800 + 20 * np.arange(WIDTH)[None, :] + 5 * np.arange(HEIGHT)[:, None] + number
    depth = ramp.astype(np.uint16)
    depth[5:9, 10:20] = 0
    depth[0, :3] = (60_000, 1, 65_535)
    return depth


def depth_m(number: int) -> Values:
    depth = (depth_mm(number) / 1000).astype(np.float32)
    depth[20:24, 30:40] = np.nan
    return depth


def camera(number: int) -> Pixels:
    """A dark picture that is somewhat brighter in each message."""
    return np.full((HEIGHT, WIDTH, 3), 20 + number, np.uint8)


def box_left(number: int) -> int:
    """Where the detection of a picture begins."""
    return 4 + number


def write_images(path: Path, videos: Mapping[str, Sequence[VideoFrame]], protobuf_video: Sequence[bytes]) -> Path:
    """Write the recording; `videos` by topic in JSON, and one of H.264 in protobuf."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        messages = _Messages(writer)
        for number in range(COUNT):
            _add_depth(messages, number)
            _add_annotated(messages, number)
        for number, picture in enumerate(_damaged_raw()):
            messages.add("/bad/raw", "sensor_msgs/msg/Image", number, picture)
        for number, data in enumerate(_damaged_compressed()):
            messages.add("/bad/compressed", "sensor_msgs/msg/CompressedImage", number, _compressed(data, "jpeg"))
        for topic, frames in videos.items():
            for number, frame in enumerate(frames):
                content = {"timestamp": _stamp(number), "frame_id": "", "data": frame.data, "format": frame.format}
                messages.add(topic, "foxglove.CompressedVideo", number, content)
        _add_protobuf(messages, protobuf_video)
        messages.write()
        writer.finish()
    return path


class _Messages:
    """Messages of all topics, which are written in the order of their times."""

    def __init__(self, writer: McapWriter) -> None:
        self._writer = writer
        self._channels: dict[str, int] = {}
        self._messages: list[tuple[int, int, bytes]] = []

    def add(self, topic: str, message_type: str, number: int, content: dict[str, Any], delay_ns: int = 0) -> None:
        if topic not in self._channels:
            schema = self._writer.add_schema(message_type, "jsonschema", b"{}")
            self._channels[topic] = self._writer.add_channel(topic, schema, "json")
        self.add_bytes(self._channels[topic], number, json.dumps(content).encode(), delay_ns)

    def add_protobuf_channel(self, topic: str, message_type: str, descriptors: bytes) -> int:
        return self._writer.add_channel(
            topic, self._writer.add_schema(message_type, "protobuf", descriptors), "protobuf"
        )

    def add_bytes(self, channel: int, number: int, payload: bytes, delay_ns: int = 0) -> None:
        self._messages.append((START_NS + number * STEP_NS + delay_ns, channel, payload))

    def write(self) -> None:
        for time_ns, channel, payload in sorted(self._messages):
            self._writer.add_message(channel, time_ns, payload)


def _add_depth(messages: _Messages, number: int) -> None:
    depth, metres = depth_mm(number), depth_m(number)
    png, rvl = io.BytesIO(), _rvl(depth.ravel().tolist())
    Image.fromarray(depth).save(png, "PNG")
    size = struct.pack("<II", WIDTH, HEIGHT)
    messages.add("/depth/mm", "sensor_msgs/msg/Image", number, _raw(depth.astype("<u2"), "16UC1", number))
    messages.add("/depth/m", "sensor_msgs/msg/Image", number, _raw(metres.astype("<f4"), "32FC1", number))
    messages.add("/thermal", "sensor_msgs/msg/Image", number, _raw(depth.astype(">u2"), "mono16", number, 1))
    for codec, data in (("png", png.getvalue()), ("rvl", size + rvl)):
        content = _compressed(bytes(12) + data, f"16UC1; compressedDepth {codec}")
        messages.add(f"/depth/{codec}", "sensor_msgs/msg/CompressedImage", number, content)


def _rvl(pixels: list[int]) -> bytes:
    """RVL (A. D. Wilson, 2017): runs of zeros and of other pixels by turns, the others as steps."""
    nibbles: list[int] = []

    def put(number: int) -> None:
        while number > 7:
            nibbles.append(8 | number & 7)
            number >>= 3
        nibbles.append(number)

    at, previous = 0, 0
    while at < len(pixels):
        zeros = next((place for place, pixel in enumerate(pixels[at:]) if pixel), len(pixels) - at)
        at += zeros
        others = next((place for place, pixel in enumerate(pixels[at:]) if not pixel), len(pixels) - at)
        put(zeros)
        put(others)
        for pixel in pixels[at : at + others]:
            step = pixel - previous
            put(2 * step if step >= 0 else -2 * step - 1)
            previous = pixel
        at += others
    nibbles += [0] * (-len(nibbles) % 8)
    words = ("".join(f"{nibble:x}" for nibble in nibbles[at : at + 8]) for at in range(0, len(nibbles), 8))
    return b"".join(struct.pack("<I", int(word, 16)) for word in words)


def _add_annotated(messages: _Messages, number: int) -> None:
    picture = _raw(camera(number), "rgb8", number)
    for side in ("front", "rear"):
        messages.add(f"/{side}/image", "sensor_msgs/msg/Image", number, picture)
    red, blue = {"r": 1, "g": 0, "b": 0, "a": 1}, {"r": 0, "g": 0, "b": 1, "a": 1}
    corners = [(10, 10), (30, 10), (30, 30), (10, 30)]
    square = [{"x": x, "y": y} for x, y in corners]
    annotations = {
        "points": [
            {"type": 2, "points": square, "outline_color": red, "fill_color": {**red, "a": 0}, "thickness": 4},
            {"type": 3, "points": [{"x": None, "y": 2}], "outline_color": red, "thickness": 4},
        ],
        "circles": [{"position": {"x": 50, "y": 20}, "diameter": 12, "fill_color": blue, "outline_color": blue}],
        "texts": [{"position": {"x": 2, "y": 46}, "text": "<img src=x onerror=alert(1)>", "font_size": 10}],
    }
    if number == 0:
        messages.add("/front/shapes", "foxglove.ImageAnnotations", number, annotations)
    bbox = {"center": {"position": {"x": box_left(number) + 5, "y": 30}, "theta": 0}, "size_x": 10, "size_y": 20}
    results = [{"hypothesis": {"class_id": "dog", "score": 0.9}}]
    detections = {"header": {"stamp": _stamp(number)}, "detections": [{"bbox": bbox, "results": results}]}
    messages.add("/rear/boxes", "vision_msgs/msg/Detection2DArray", number, detections, DELAY_NS)


def _add_protobuf(messages: _Messages, frames: Sequence[bytes]) -> None:
    """Add frames of foxglove.CompressedVideo as the library of protobuf writes them."""
    file = FileDescriptorProto(name="video.proto", package="foxglove", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    message_type = file.message_type.add(name="CompressedVideo")
    kinds = FieldDescriptorProto
    fields = {"frame_id": kinds.TYPE_STRING, "data": kinds.TYPE_BYTES, "format": kinds.TYPE_STRING}
    message_type.field.add(
        name="timestamp",
        number=1,
        type=kinds.TYPE_MESSAGE,
        label=kinds.LABEL_OPTIONAL,
        type_name=".google.protobuf.Timestamp",
    )
    for number, (name, kind) in enumerate(fields.items(), 2):
        message_type.field.add(name=name, number=number, type=kind, label=kinds.LABEL_OPTIONAL)
    timestamp = FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(timestamp)
    descriptors = FileDescriptorSet(file=[timestamp, file])
    video = GetMessages([timestamp, file])["foxglove.CompressedVideo"]
    channel = messages.add_protobuf_channel(
        "/video/h264_pcm", "foxglove.CompressedVideo", descriptors.SerializeToString()
    )
    for number, frame in enumerate(frames):
        messages.add_bytes(channel, number, video(data=frame, format="h264").SerializeToString())


def _damaged_raw() -> list[dict[str, Any]]:
    good = _raw(np.full((8, 8), 99, np.uint8), "mono8", 0)
    rgb = _raw(np.zeros((8, 8, 3), np.uint8), "rgb8", 0)
    return [
        good,
        {**good, "width": 0, "height": 0},
        {**rgb, "step": 10},
        {**good, "data": base64.b64encode(bytes(60)).decode()},
        {**good, "width": 60_000, "height": 60_000, "step": 60_000},
        good,
    ]


def _damaged_compressed() -> list[bytes]:
    noise = np.random.default_rng(20).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    jpeg, png = io.BytesIO(), io.BytesIO()
    Image.fromarray(noise).save(jpeg, "JPEG")
    Image.fromarray(noise).save(png, "PNG")
    good = jpeg.getvalue()
    codes = good.index(b"\xff\xc4") + 5  # a table cannot have 16 times 255 codes
    corrupt_jpeg = good[:codes] + b"\xff" * 16 + good[codes + 16 :]
    corrupt_png = png.getvalue()[:33] + b"\xff" * 200
    return [good, corrupt_jpeg, corrupt_png, b"", good[:4], good]


def _raw(pixels: NDArray[Any], encoding: str, number: int, is_big_endian: int = 0) -> dict[str, Any]:
    height, width = pixels.shape[:2]
    return {
        "header": {"stamp": _stamp(number), "frame_id": "camera"},
        "height": height,
        "width": width,
        "encoding": encoding,
        "is_bigendian": is_big_endian,
        "step": pixels.nbytes // height,
        "data": base64.b64encode(pixels.tobytes()).decode(),
    }


def _compressed(data: bytes, name: str) -> dict[str, Any]:
    return {"header": {"stamp": _stamp(0)}, "format": name, "data": base64.b64encode(data).decode()}


def _stamp(number: int) -> dict[str, int]:
    time_ns = START_NS + number * STEP_NS
    return {"sec": time_ns // 1_000_000_000, "nanosec": time_ns % 1_000_000_000}
