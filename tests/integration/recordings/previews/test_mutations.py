"""Any change of a recording's bytes yields a preview of bounded size, or the error that it cannot be opened."""

from __future__ import annotations

import json
import struct
from io import BytesIO

from hypothesis import given, settings
from hypothesis import strategies as st

from kleinkram.recordings import Recording
from kleinkram.recordings.errors import RecordingError
from kleinkram.recordings.previews import make_preview, read_preview
from kleinkram.recordings.sample import messages as definitions
from kleinkram.recordings.sample.messages import Encoding
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, data_of, ros1_bag
from tests.recording_files.writers import Compression, McapWriter
from tests.unit.recordings.previews.test_contents import jpeg

_FIELDS = [{"name": axis, "offset": 4 * n, "datatype": 7, "count": 1} for n, axis in enumerate("xyz")]
_CLOUD = {"height": 1, "width": 8, "fields": _FIELDS, "point_step": 12, "row_step": 96, "data": bytes(range(96))}
_IMAGE = {"height": 8, "width": 8, "encoding": "bayer_grbg8", "step": 8, "data": bytes(range(64))}
_STATUS = [{"level": 1, "name": "motor", "message": "hot", "values": []}]


def _messages() -> list[TimedMessage]:
    kinds = (
        ("/imu", "sensor_msgs/Imu", {"linear_acceleration": {"x": 1.5}}),
        ("/gnss", "sensor_msgs/NavSatFix", {"latitude": 47.1, "longitude": 8.2}),
        ("/odom", "nav_msgs/Odometry", {"pose": {"pose": {"position": {"x": 3.0}}}}),
        ("/lidar", "sensor_msgs/PointCloud2", _CLOUD),
        ("/camera", "sensor_msgs/Image", _IMAGE),
        ("/jpeg", "sensor_msgs/CompressedImage", {"format": "jpeg", "data": jpeg(16, 16, (9, 99, 200))}),
        ("/diagnostics", "diagnostic_msgs/DiagnosticArray", {"status": _STATUS}),
    )
    times = range(T0, T0 + 6 * SECOND, SECOND)
    return [TimedMessage(topic, kind, at, values, at) for at in times for topic, kind, values in kinds]


def _mcap() -> bytes:
    """Return an MCAP without compression and checksums of chunks that would hide what is changed."""
    out = BytesIO()
    writer = McapWriter(out, profile="ros2", compression=Compression.none, chunk_bytes=2**14)
    channels: dict[str, int] = {}
    for message in _messages():
        if message.topic not in channels:
            definition = definitions.ros2_definition(message.message_type).encode()
            schema = writer.add_schema(definitions.ros2_name(message.message_type), "ros2msg", definition)
            channels[message.topic] = writer.add_channel(message.topic, schema, "cdr")
        writer.add_message(channels[message.topic], message.log_ns, data_of(message, Encoding.cdr))
    json_channel = writer.add_channel("/state", writer.add_schema("State", "jsonschema", b"{}"), "json")
    for number in range(20):
        writer.add_message(json_channel, T0 + number, json.dumps({"x": number, "deep": {"y": [1, 2.5]}}).encode())
    writer.finish()
    return out.getvalue()


_MCAP = _mcap()
_BAG_SOURCE = ros1_bag(_messages(), chunk_bytes=2**14)
_BAG = _BAG_SOURCE.read(0, _BAG_SOURCE.size_bytes)
_EDITS = st.lists(st.tuples(st.floats(0, 1), st.binary(min_size=1, max_size=9)), max_size=6)


@given(st.sampled_from([(_MCAP, "test.mcap"), (_BAG, "test.bag")]), _EDITS, st.one_of(st.just(1.0), st.floats(0.2, 1)))
@settings(max_examples=200, deadline=20_000)
def test_mutated_recordings(recording: tuple[bytes, str], edits: list[tuple[float, bytes]], keep: float) -> None:
    data, name = recording
    changed = bytearray(data)
    for place, patch in edits:
        at = int(place * (len(data) - 1))
        changed[at : at + len(patch)] = patch
    _check(bytes(changed[: int(len(data) * keep)]), name)


@given(st.sampled_from(["/imu", "/gnss", "/lidar", "/camera", "/jpeg", "/diagnostics"]), _EDITS)
@settings(max_examples=200, deadline=20_000)
def test_mutated_messages(topic: str, edits: list[tuple[float, bytes]]) -> None:
    (message, *_) = [one for one in _messages() if one.topic == topic]
    data = bytearray(data_of(message, Encoding.cdr))
    for place, patch in edits:
        at = 4 + int(place * (len(data) - 5))
        data[at : at + len(patch)] = patch
    out = BytesIO()
    writer = McapWriter(out, profile="ros2")
    definition = definitions.ros2_definition(message.message_type).encode()
    schema = writer.add_schema(definitions.ros2_name(message.message_type), "ros2msg", definition)
    channel = writer.add_channel(topic, schema, "cdr")
    for at in range(3):
        writer.add_message(channel, T0 + at, bytes(data) + struct.pack("<I", 0) * at)
    writer.finish()
    _check(out.getvalue(), "test.mcap")


def _check(data: bytes, name: str) -> None:
    try:
        recording = Recording.open(MemorySource(data, name))
    except RecordingError:
        return
    with recording:
        made = make_preview(recording)
    assert len(made) <= 256_000
    read_preview(made)
