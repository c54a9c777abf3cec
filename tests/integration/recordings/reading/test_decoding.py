"""Values and tables of recordings, and messages that cannot be decoded."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import pytest
import zstandard

from kleinkram.recordings import NoSuchTopic, Recording
from kleinkram.recordings.sample import generate_bag, generate_mcap
from tests.recording_files.builders import T0
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import McapWriter


@pytest.fixture(scope="module", params=["mcap", "bag"])
def drive(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("drive") / f"drive.{request.param}"
    maker = generate_mcap if request.param == "mcap" else generate_bag
    maker(path, duration_s=2, size_bytes=2_000_000)
    return path


def test_decoded_messages_and_tables_agree(drive: Path) -> None:
    with Recording.open(drive) as recording:
        assert all(topic.undecodable is None for topic in recording.topics)
        messages = list(recording.messages("/imu/data"))
        table = recording.to_arrow("/imu/data", fields=["linear_acceleration"])
    assert len(messages) == recording.topic("/imu/data").count == table.num_rows > 50
    assert table.column("log_time_ns").to_pylist() == [message.log_time_ns for message in messages]
    expected = [message.value.linear_acceleration.z for message in messages]
    assert table.column("linear_acceleration.z").to_pylist() == expected


def test_pandas_and_batches_of_a_span(drive: Path) -> None:
    with Recording.open(drive) as recording:
        assert recording.start_ns is not None
        middle = recording.start_ns + 10**9
        frame = recording.to_pandas("/imu/data", start=middle)
        rows = sum(batch.num_rows for batch in recording.batches("/imu/data", start=middle))
        assert 0 < len(frame) == rows < (recording.topic("/imu/data").count or 0)
        assert frame["log_time_ns"].min() >= middle
        with pytest.raises(NoSuchTopic):
            recording.to_arrow("/imu/*")


def mcap_with(encoding: str, schema: tuple[str, str, bytes], *data: bytes) -> MemorySource:
    out = BytesIO()
    writer = McapWriter(out)
    channel = writer.add_channel("/t", writer.add_schema(*schema), encoding)
    for number, raw in enumerate(data):
        writer.add_message(channel, T0 + number, raw, publish_time_ns=T0)
    writer.finish()
    return MemorySource(out.getvalue(), "run_0.mcap")


def test_a_schema_that_cannot_be_decoded_yields_bytes_and_a_reason() -> None:
    recording = Recording.open(mcap_with("flatbuffer", ("a.B", "flatbuffer", b"\0"), b"one", b"two"))
    assert "flatbuffer" in (recording.topic("/t").undecodable or "")
    assert [message.value for message in recording.messages()] == [b"one", b"two"]


def test_a_message_that_does_not_fit_its_schema_stays_bytes_and_is_named() -> None:
    good, short = b"\0\1\0\0\7\0\0\0", b"\0\1\0\0\7"
    recording = Recording.open(mcap_with("cdr", ("a/msg/B", "ros2msg", b"uint32 x"), good, short))
    values = [message.value for message in recording.messages()]
    assert values[0].x == 7
    assert values[1] == short
    assert [problem.code for problem in recording.problems] == ["message-undecodable"]


def test_messages_that_rosbag2_compressed_one_by_one() -> None:
    packed = [zstandard.compress(text) for text in (b"one", b"two" * 1000)]
    data = mcap_with("cdr", ("a/msg/B", "ros2msg", b"uint32 x"), packed[0], b"not zstd", packed[1])
    text = (
        "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - run_0.mcap\n"
        "  compression_format: zstd\n  compression_mode: MESSAGE\n"
    )
    recording = Recording.open([MemorySource(text.encode(), "metadata.yaml"), data])
    assert [message.data for message in recording.raw_messages()] == [b"one", b"two" * 1000]
    assert [(problem.code, problem.where) for problem in recording.problems] == [("damaged-message", "/t")]
    assert next(Recording.open(data).raw_messages()).data == packed[0]


def test_a_compressed_message_may_not_claim_more_than_is_read() -> None:
    bomb = zstandard.compress(bytes(65 * 2**20))
    data = mcap_with("cdr", ("a/msg/B", "ros2msg", b"uint32 x"), bomb)
    text = "rosbag2_bagfile_information:\n  compression_format: zstd\n  compression_mode: MESSAGE\n"
    recording = Recording.open([MemorySource(text.encode(), "metadata.yaml"), data])
    assert list(recording.raw_messages()) == []
    assert "at most" in recording.problems[-1].message
