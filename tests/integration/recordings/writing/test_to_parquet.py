"""`Recording.to_parquet`: what pyarrow reads back is what `Recording.to_arrow` gives."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from kleinkram.recordings import CannotWrite, EmptyRange, NoSuchTopic, Recording
from kleinkram.recordings.decoding import types
from kleinkram.recordings.sample import generate_bag, generate_db3, generate_mcap
from kleinkram.recordings.writing.topic_rows import _file_name
from tests.recording_files.builders import T0
from tests.recording_files.corpus import Entry, params_to_write
from tests.recording_files.ros_messages import SECOND, TimedMessage, ros2_mcap
from tests.recording_files.tables import as_arrow, json_mcap

FORMATS = "MCAP", "ROS1 bag 2.0", "ROS2 sqlite3 db3", "file-zstd of MCAP", "PX4 ULog"


def _plain(table: pa.Table) -> str:
    """Return a text in which NaN equals NaN, as it does not in Arrow."""
    return repr(table.to_pylist())


@pytest.mark.parametrize("entry", params_to_write(*FORMATS))
def test_every_topic_of_every_recording(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    with Recording.open(recordings_dir / entry.name) as recording:
        result = recording.to_parquet(tmp_path / "out")
        undecodable = {topic.name: topic.undecodable for topic in recording.topics if topic.undecodable}
        left_out = {item.topic: item.reason for item in result.left_out}
        assert {topic: left_out.get(topic) for topic in undecodable} == undecodable
        assert {file.topic for file in result.files} | left_out.keys() == {t.name for t in recording.topics}
        for topic in left_out.keys() - undecodable.keys():
            assert "its columns cannot be written" in left_out[topic]
        for file in result.files:
            expected, actual = recording.to_arrow(file.topic), as_arrow(file.path)
            assert actual.schema.equals(expected.schema)
            assert actual.equals(expected) or _plain(actual) == _plain(expected)
            assert file.row_count == actual.num_rows
            assert file.size_bytes == file.path.stat().st_size
    assert sorted((tmp_path / "out").rglob("*")) == sorted(file.path for file in result.files)


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_metadata_of_the_sample(kind: str, tmp_path: Path) -> None:
    make = {"mcap": generate_mcap, "bag": generate_bag, "db3": generate_db3}[kind]
    make(tmp_path / "drive", size_bytes=3_000_000)
    with Recording.open(tmp_path / "drive") as recording:
        result = recording.to_parquet(tmp_path / "out", "/imu/data")
    (file,) = result.files
    assert file.path == tmp_path / "out" / "imu.data.parquet"
    metadata = pq.read_metadata(file.path).metadata
    message_type = "sensor_msgs/Imu" if kind == "bag" else "sensor_msgs/msg/Imu"
    expected = {
        b"sources": json.dumps({"drive": {"drive_0.db3" if kind == "db3" else "drive": None}}).encode(),
        b"topic": b"/imu/data",
        b"message_type": message_type.encode(),
        b"message_encoding": b"ros1" if kind == "bag" else b"cdr",
        b"frame_id": b"imu",
    }
    assert {key: value for key, value in metadata.items() if key in expected} == expected
    units = json.loads(metadata[b"units"])
    assert units["linear_acceleration.x"] == "m/s^2"
    schema = pq.read_schema(file.path)
    assert {
        field.name: field.metadata[b"unit"].decode() for field in schema if b"unit" in (field.metadata or {})
    } == units
    for name in ("log_time", "publish_time", "header.stamp"):
        assert schema.field(name).type == pa.timestamp("ns", "UTC")


def test_times_are_timestamps_to_the_nanosecond(tmp_path: Path) -> None:
    imu = [TimedMessage("/imu", "sensor_msgs/Imu", T0 + 1, {}, T0 + 123_456_789)]
    with Recording.open(ros2_mcap(imu)) as recording:
        (file,) = recording.to_parquet(tmp_path).files
    frame = pq.read_table(file.path).to_pandas()
    assert frame["log_time"][0].value == T0 + 1
    assert frame["header.stamp"][0].value == T0 + 123_456_789
    assert str(frame["header.stamp"].dt.tz) == "UTC"


def test_a_time_range(tmp_path: Path) -> None:
    imu = [TimedMessage("/imu", "sensor_msgs/Imu", T0 + n * SECOND, {}, T0) for n in range(5)]
    with Recording.open(ros2_mcap(imu)) as recording:
        (file,) = recording.to_parquet(tmp_path, start=T0 + SECOND, end="+3s").files
        assert as_arrow(file.path)["log_time_ns"].to_pylist() == [T0 + SECOND, T0 + 2 * SECOND]
        with pytest.raises(EmptyRange):
            recording.to_parquet(tmp_path / "empty", start=T0, end=T0)
    assert not (tmp_path / "empty").exists()


def test_fields_with_the_names_of_our_columns_get_others(tmp_path: Path) -> None:
    values: list[object] = [{"log_time": 7, "publish_time": "x", "recording": True}]
    with Recording.open(json_mcap(values)) as recording:
        (file,) = recording.to_parquet(tmp_path).files
    (row,) = pq.read_table(file.path).to_pylist()
    assert (row["log_time_"], row["publish_time_"], row["recording"]) == (7, "x", True)
    assert row["log_time"].value == T0


def test_a_frame_that_changes_is_not_named(tmp_path: Path) -> None:
    imu = [
        TimedMessage("/imu", "sensor_msgs/Imu", T0 + n, {"header": {"frame_id": f"f{n}"}}, T0 + n * SECOND)
        for n in range(2)
    ]
    with Recording.open(ros2_mcap(imu)) as recording:
        (file,) = recording.to_parquet(tmp_path).files
    assert b"frame_id" not in pq.read_metadata(file.path).metadata


def test_a_topic_is_written_in_row_groups(tmp_path: Path) -> None:
    generate_mcap(tmp_path / "drive", size_bytes=60_000_000)
    with Recording.open(tmp_path / "drive") as recording:
        (file,) = recording.to_parquet(tmp_path / "out", "/lidar/points").files
        assert pq.read_metadata(file.path).num_row_groups > 1
        assert as_arrow(file.path).equals(recording.to_arrow("/lidar/points"))


@pytest.fixture
def _small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let 1000 messages be a batch."""
    monkeypatch.setattr(types, "BATCH_MESSAGES", 1000)


@pytest.mark.usefixtures("_small_batches")
def test_json_of_many_shapes(tmp_path: Path) -> None:
    """More messages than fit into one batch, the last of which has another column."""
    values: list[object] = [{"x": number, "name": "a"} for number in range(1100)]
    with Recording.open(json_mcap([*values, {"x": 1.5, "late": True}])) as recording:
        (file,) = recording.to_parquet(tmp_path).files
        table = as_arrow(file.path)
        assert table.equals(recording.to_arrow("/state"))
    assert {"x", "name", "late"} <= set(table.column_names)


@pytest.mark.usefixtures("_small_batches")
@pytest.mark.parametrize("last", [{"y": "text"}, "text", True, None, [1]])
def test_json_whose_columns_change_their_kind(tmp_path: Path, last: object) -> None:
    """As in `to_arrow`, what a column cannot hold is null, and is reported."""
    values: list[object] = [{"x": number} for number in range(1100)]
    with Recording.open(json_mcap([*values, {"x": last}])) as recording:
        (file,) = recording.to_parquet(tmp_path).files
        assert as_arrow(file.path).equals(recording.to_arrow("/state"))
        reported = [problem.code for problem in recording.problems]
    assert reported == ([] if last is None else ["message-undecodable"])


def test_files_are_not_replaced(tmp_path: Path) -> None:
    generate_mcap(tmp_path / "drive", size_bytes=500_000)
    with Recording.open(tmp_path / "drive") as recording:
        recording.to_parquet(tmp_path / "out", "/odom")
        before = (tmp_path / "out" / "odom.parquet").read_bytes()
        with pytest.raises(CannotWrite, match=r"odom\.parquet: there is such a file"):
            recording.to_parquet(tmp_path / "out", "/odom")
        with pytest.raises(CannotWrite, match="the folder cannot be made: Not a directory"):
            recording.to_parquet(tmp_path / "drive" / "out")
        with pytest.raises(NoSuchTopic):
            recording.to_parquet(tmp_path / "out", "/nothing")
    assert (tmp_path / "out" / "odom.parquet").read_bytes() == before


def test_names_of_files_differ() -> None:
    names = ["/a/b", "/a.b", "/A/b", "/", "/ü/..", "/" + "x" * 300, "/" + "x" * 301]
    taken: set[str] = set()
    made = {name: f"{_file_name(name, taken)}.parquet" for name in names}
    assert made["/a/b"] == "a.b.parquet"
    assert made["/a.b"] == "a.b-2.parquet"
    assert made["/A/b"] == "A.b-3.parquet"
    assert made["/"] == "topic.parquet"
    assert len({name.lower() for name in made.values()}) == len(names)
    assert not any("/" in name or name.startswith(".") or len(name) > 255 for name in made.values())
