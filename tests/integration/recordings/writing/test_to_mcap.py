"""`Recording.to_mcap`: every recording becomes a whole MCAP with the same messages, or nothing."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Sequence
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag1 import Reader as BagReader
from rosbags.rosbag2 import Reader as Rosbag2Reader

from kleinkram import __version__
from kleinkram.recordings import (
    CannotWrite,
    ChunkCompression,
    McapOptions,
    NoSuchTopic,
    NotARecording,
    Recording,
    SeveralRecordings,
    SourceError,
    is_whole_mcap,
)
from kleinkram.recordings.inspect import inspect_paths
from kleinkram.recordings.sample import generate_bag, generate_db3, generate_mcap
from kleinkram.recordings.writing.mcap import MADE_FROM
from tests.conftest import CASES, MakeCase
from tests.recording_files.builders import T0, mcap_of
from tests.recording_files.corpus import MESSAGE_FORMATS, Entry, entries, params, params_to_write
from tests.recording_files.databases import make_database, steady
from tests.recording_files.independent import Stamped, independent_recording
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.whole_mcap import IndependentMessage, WholeMcap, read_whole_mcap

ROSBAG2_REFUSES = {"old_schema", "wrong_rmw_db3", "split_missing_file", "talker", "metadata_only_data_missing"}


def messages_of(path: Path) -> list[IndependentMessage]:
    with Recording.open(path) as recording:
        return [
            (message.topic, message.log_time_ns, message.publish_time_ns, message.sequence, message.data)
            for message in recording.raw_messages()
        ]


def without_times(messages: list[IndependentMessage]) -> list[Stamped]:
    return [(topic, log_ns, data) for topic, log_ns, _publish_ns, _sequence, data in messages]


def is_part(some: Sequence[Stamped], messages: Sequence[Stamped]) -> bool:
    """Return whether some messages are among others, in the same order."""
    rest = iter(messages)
    return all(message in rest for message in some)


def convert(source: Path, target: Path, **options: Any) -> WholeMcap:
    with Recording.open(source) as recording:
        result = recording.to_mcap(target, options=McapOptions(**options))
    whole = read_whole_mcap(target)
    assert (result.path, result.message_count) == (target, len(whole.messages))
    assert result.size_bytes == target.stat().st_size
    assert [path.name for path in target.parent.glob(".*")] == []
    return whole


@pytest.mark.parametrize("entry", params_to_write(*MESSAGE_FORMATS))
def test_every_recording_keeps_all_messages(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    source, target = recordings_dir / entry.name, tmp_path / "made.mcap"
    whole = convert(source, target)
    assert without_times(whole.messages) == independent_recording(source).messages
    assert whole.messages == messages_of(source)
    assert len(whole.messages) == entry.expected["messages"]
    made_from = whole.metadata_of(MADE_FROM)
    assert made_from == {"version": __version__, "files": json.dumps([{"name": source.name}])}
    with Recording.open(source) as before, Recording.open(target) as after:
        described = [(topic.name, topic.message_type, topic.message_encoding) for topic in before.topics]
        assert [(topic.name, topic.message_type, topic.message_encoding) for topic in after.topics] == described


@pytest.mark.parametrize("entry", params_to_write("MCAP"))
def test_an_mcap_keeps_its_messages_by_another_reader(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    """Also attachments, metadata, properties of channels, and the profile."""
    source = recordings_dir / entry.name
    whole = convert(source, tmp_path / "made.mcap")
    with source.open("rb") as stream:
        original = list(StreamReader(stream, validate_crcs=True).records)
    by_type: dict[str, list[Any]] = {}
    for record in original:
        by_type.setdefault(type(record).__name__, []).append(record)
    topics = {channel.id: channel.topic for channel in by_type.get("Channel", [])}
    expected = [
        (topics[one.channel_id], one.log_time, one.publish_time, one.sequence, one.data)
        for one in by_type.get("Message", [])
    ]
    assert whole.messages == sorted(expected, key=lambda message: message[1])
    assert whole.header.profile == (by_type["Header"][0].profile or whole.header.profile)
    assert whole.attachments == by_type.get("Attachment", [])
    assert whole.metadata[:-1] == by_type.get("Metadata", [])
    described = {(one.topic, one.message_encoding, tuple(one.metadata.items())) for one in by_type.get("Channel", [])}
    assert {(one.topic, one.message_encoding, tuple(one.metadata.items())) for one in whole.channels} == described
    schemas = {(one.name, one.encoding, one.data) for one in by_type.get("Schema", [])}
    assert {(one.name, one.encoding, one.data) for one in whole.schemas.values()} <= schemas


@pytest.mark.parametrize("entry", params_to_write("ROS1 bag 2.0"))
def test_a_bag_stays_ros_1(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    whole = convert(recordings_dir / entry.name, tmp_path / "made.mcap")
    with BagReader(recordings_dir / entry.name) as reader:
        connections = {(one.topic, one.msgtype, one.msgdef.data, one.digest) for one in reader.connections}
    assert without_times(whole.messages) == independent_recording(recordings_dir / entry.name).messages
    assert all(log_ns == publish_ns for _, log_ns, publish_ns, _, _ in whole.messages)
    assert {channel.message_encoding for channel in whole.channels} <= {"ros1"}
    if whole.channels:
        assert whole.header.profile == "ros1"
    made = {
        (channel.topic, schema.name, schema.data.decode(), channel.metadata["md5sum"])
        for channel in whole.channels
        for schema in [whole.schemas[channel.schema_id]]
        if "md5sum" in channel.metadata
    }
    assert {(topic, kind, digest) for topic, kind, _, digest in made} == {
        (topic, kind.replace("/msg/", "/"), digest) for topic, kind, _, digest in connections
    }


def folders() -> list[Any]:
    names = sorted({Path(entry.name).parent for entry in entries() if entry.name.endswith("metadata.yaml")})
    readable = [pytest.param(name, id=str(name)) for name in names if name.name not in ROSBAG2_REFUSES]
    return readable or [pytest.param(Path("recordings are missing"), id="none")]


@pytest.mark.parametrize("folder", folders())
def test_a_rosbag2_folder_becomes_one_file(folder: Path, recordings_dir: Path, tmp_path: Path) -> None:
    whole = convert(recordings_dir / folder, tmp_path / "made.mcap")
    with Rosbag2Reader(recordings_dir / folder) as reader:
        assert without_times(whole.messages) == [
            (connection.topic, stamp, data) for connection, stamp, data in reader.messages()
        ]


def test_a_split_set_becomes_one_file(recordings_dir: Path, tmp_path: Path) -> None:
    source = recordings_dir / "ros2-db3/split_no_metadata"
    whole = convert(source, tmp_path / "made.mcap")
    assert whole.messages == messages_of(source)
    names = [item["name"] for item in json.loads(whole.metadata_of(MADE_FROM)["files"])]
    assert names == [f"multiple_files_{number}.db3" for number in range(3)]
    topics = [channel.topic for channel in whole.channels]
    assert len(topics) == len(set(topics))  # equal channels of several files are one


def test_a_database_without_definitions_gets_those_of_well_known_types(tmp_path: Path) -> None:
    """So that readers without ROS decode it."""
    generate_db3(tmp_path / "drive", size_bytes=500_000)
    whole = convert(tmp_path / "drive", tmp_path / "made.mcap")
    assert whole.header.profile == "ros2"
    assert {schema.encoding for schema in whole.schemas.values()} == {"ros2msg"}
    factory = DecoderFactory()
    decoders = {
        channel.topic: factory.decoder_for(channel.message_encoding, whole.schemas[channel.schema_id])
        for channel in whole.channels
    }
    decoded = [decoder(data) for topic, _, _, _, data in whole.messages if (decoder := decoders[topic]) is not None]
    assert len(decoded) == len(whole.messages) > 100


def test_qos_and_type_hashes_of_a_database_stay(tmp_path: Path) -> None:
    make_database(tmp_path / "a.db3", schema="jazzy", messages=steady(10))
    whole = convert(tmp_path / "a.db3", tmp_path / "made.mcap")
    (properties,) = {tuple(sorted(channel.metadata.items())) for channel in whole.channels}
    assert properties == (("offered_qos_profiles", "- history: 3"), ("topic_type_hash", "RIHS01_00"))
    with Recording.open(tmp_path / "made.mcap") as again:
        again.to_mcap(tmp_path / "again.mcap")
    assert read_whole_mcap(tmp_path / "again.mcap").channels == whole.channels


@pytest.mark.parametrize(
    ("compression", "level", "stored"),
    [("zstd", None, "zstd"), ("zstd", 19, "zstd"), ("lz4", None, "lz4"), ("lz4", 9, "lz4"), ("none", None, "")],
)
def test_recompression_keeps_everything(tmp_path: Path, compression: str, level: int | None, stored: str) -> None:
    generate_mcap(tmp_path / "drive.mcap", size_bytes=2_000_000, duration_s=5)
    kind = ChunkCompression(compression)
    target = tmp_path / "made.mcap"
    whole = convert(tmp_path / "drive.mcap", target, compression=kind, level=level)
    assert whole.compressions == {stored}
    assert whole.messages == messages_of(tmp_path / "drive.mcap")
    with Recording.open(target) as made:
        assert [is_whole_mcap(made, one) for one in ChunkCompression] == [one is kind for one in ChunkCompression]


def test_a_higher_level_is_smaller(tmp_path: Path) -> None:
    generate_mcap(tmp_path / "drive.mcap", size_bytes=600_000)
    for level in (1, 19):
        convert(tmp_path / "drive.mcap", tmp_path / f"{level}.mcap", level=level)
    assert (tmp_path / "19.mcap").stat().st_size < (tmp_path / "1.mcap").stat().st_size


@pytest.mark.parametrize(("compression", "level"), [("zstd", 0), ("zstd", 23), ("lz4", 17), ("none", 1)])
def test_levels_have_bounds(compression: str, level: int) -> None:
    with pytest.raises(ValueError, match=f"^{compression} has levels "):
        McapOptions(ChunkCompression(compression), level)


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_the_same_recording_gives_the_same_bytes(tmp_path: Path, kind: str) -> None:
    make = {"mcap": generate_mcap, "bag": generate_bag, "db3": generate_db3}[kind]
    for folder in ("one", "another"):
        (tmp_path / folder).mkdir()
    name = "drive" if kind == "db3" else f"drive.{kind}"
    make(tmp_path / "one" / name, size_bytes=2_000_000)
    copy = shutil.copytree if kind == "db3" else shutil.copyfile
    copy(tmp_path / "one" / name, tmp_path / "another" / name)
    hashes = set()
    for folder in ("one", "another"):
        convert(tmp_path / folder / name, tmp_path / folder / "made.mcap")
        hashes.add(sha256((tmp_path / folder / "made.mcap").read_bytes()).hexdigest())
    assert len(hashes) == 1


def test_topics_can_be_selected(tmp_path: Path) -> None:
    generate_mcap(tmp_path / "drive.mcap", size_bytes=2_000_000)
    with Recording.open(tmp_path / "drive.mcap") as recording:
        recording.to_mcap(tmp_path / "made.mcap", ["/imu*", "/odom"], sha256={"drive.mcap": "abc"})
        with pytest.raises(NoSuchTopic):
            recording.to_mcap(tmp_path / "none.mcap", "/nothing")
    whole = read_whole_mcap(tmp_path / "made.mcap")
    assert whole.messages == [one for one in messages_of(tmp_path / "drive.mcap") if one[0] in ("/imu/data", "/odom")]
    assert {channel.topic for channel in whole.channels} == {"/imu/data", "/odom"}
    assert whole.metadata_of(MADE_FROM) == {
        "version": __version__,
        "files": '[{"name": "drive.mcap", "sha256": "abc"}]',
        "topics": '["/imu/data", "/odom"]',
    }
    assert not (tmp_path / "none.mcap").exists()


def test_progress_goes_from_0_to_1(tmp_path: Path) -> None:
    generate_mcap(tmp_path / "drive.mcap", size_bytes=2_000_000, duration_s=30)
    shares: list[float] = []
    with Recording.open(tmp_path / "drive.mcap") as recording:
        recording.to_mcap(tmp_path / "made.mcap", on_progress=shares.append)
    assert len(shares) > 3
    assert shares == sorted(shares)
    assert 0 <= shares[0] < 0.5 < shares[-1] <= 1


# Repair


@pytest.mark.parametrize("entry", params(*MESSAGE_FORMATS, broken=True))
def test_a_broken_recording_becomes_a_whole_one(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    source, target = recordings_dir / entry.name, tmp_path / "made.mcap"
    try:
        recording = Recording.open(source)
    except NotARecording:
        pytest.fail(f"{entry.name} is expected to be readable in part")
    with recording:
        result = recording.to_mcap(target)
        summaries = recording.scan_files()
        assert not is_whole_mcap(recording, ChunkCompression.zstd)
    whole = read_whole_mcap(target)
    assert whole.messages == messages_of(source)
    if entry.made_from is not None:
        intact = independent_recording(recordings_dir / entry.made_from).messages
        assert is_part(without_times(whole.messages), intact)
    measured = [summary.lost for summary in summaries if summary.lost]
    if not measured:
        assert result.losses == ()
        assert "losses" not in whole.metadata_of(MADE_FROM)
        return
    (loss,) = result.losses
    assert (loss.bytes, loss.chunks, loss.messages) == (measured[0].bytes, measured[0].chunks, measured[0].messages)
    assert loss.file == source.name
    assert loss.reason == summaries[0].reason
    (stored,) = json.loads(whole.metadata_of(MADE_FROM)["losses"])
    assert (stored["file"], stored["bytes"], stored["messages"]) == (loss.file, loss.bytes, loss.messages)


def test_the_loss_of_a_chunk_names_its_time(tmp_path: Path, recordings_dir: Path) -> None:
    source = recordings_dir / "derived/auv_zstd_bitflip_chunk2.mcap"
    with Recording.open(source) as recording:
        (loss,) = recording.to_mcap(tmp_path / "made.mcap").losses
    (place,) = loss.places
    assert place.after_ns is not None
    assert place.before_ns is not None
    whole = messages_of(recordings_dir / "derived/auv_zstd.mcap")
    saved = set(messages_of(tmp_path / "made.mcap"))
    lost = [one[1] for one in whole if one not in saved]
    assert len(lost) == loss.messages == 1328
    assert (place.after_ns, place.before_ns) == (min(lost), max(lost))


def test_a_damaged_attachment_is_a_loss(recordings_dir: Path, tmp_path: Path) -> None:
    source = recordings_dir / "conformance/OneAttachment-ax-st-sum.mcap"
    data = bytearray(source.read_bytes())
    at = data.index(b"\x01\x02\x03")
    data[at] ^= 0xFF
    with Recording.open(MemorySource(bytes(data), "a.mcap")) as recording:
        (loss,) = recording.to_mcap(tmp_path / "made.mcap").losses
    assert "its checksum is wrong" in loss.reason
    assert read_whole_mcap(tmp_path / "made.mcap").attachments == []


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an MCAP and a bag."""
    folder: Path = tmp_path_factory.mktemp("intact")
    generate_mcap(folder / "drive.mcap", size_bytes=3_000_000, duration_s=4)
    generate_bag(folder / "drive.bag", size_bytes=3_000_000, duration_s=4)
    return folder


@pytest.mark.parametrize("kind", ["mcap", "bag"])
@pytest.mark.parametrize("seed", range(12))
def test_whatever_is_damaged_the_output_is_whole(kind: str, seed: int, tmp_path: Path, intact: Path) -> None:
    """Random bytes overwritten, a part cut out, the end cut off: as many messages as the reader gives."""
    chance = random.Random(seed)
    data = bytearray((intact / f"drive.{kind}").read_bytes())
    for _ in range(chance.randrange(1, 4)):
        at, length = chance.randrange(100, len(data)), chance.choice((1, 300, 100_000))
        if chance.random() < 0.4:
            del data[at : at + length]
        else:
            data[at : at + length] = chance.randbytes(min(length, len(data) - at))
    if chance.random() < 0.5:
        del data[chance.randrange(len(data) // 2, len(data)) :]
    damaged = tmp_path / f"damaged.{kind}"
    damaged.write_bytes(data)
    with Recording.open(damaged) as recording:
        result = recording.to_mcap(tmp_path / "made.mcap")
    whole = read_whole_mcap(tmp_path / "made.mcap")
    assert whole.messages == messages_of(damaged)
    assert bool(result.losses) == (whole.messages != messages_of(intact / f"drive.{kind}"))


@pytest.mark.parametrize("number", sorted(path.parent.name.split("-")[0] for path in CASES.glob("*/make.py")))
def test_small_inputs_that_once_failed(number: str, make_case: MakeCase, tmp_path: Path) -> None:
    for at, inspection in enumerate(inspect_paths([make_case(number)])):
        source = Path(inspection.path)
        if not source.exists():
            continue  # a split set has no path of its own
        try:
            with Recording.open(source) as recording:
                recording.to_mcap(tmp_path / f"{at}.mcap")
        except (NotARecording, SeveralRecordings):
            continue
        assert read_whole_mcap(tmp_path / f"{at}.mcap").messages == messages_of(source)


# Bad outputs


def test_what_exists_is_not_replaced(tmp_path: Path) -> None:
    source = tmp_path / "drive.mcap"
    generate_mcap(source, size_bytes=500_000)
    before = source.read_bytes()
    (tmp_path / "folder").mkdir()
    with Recording.open(source) as recording:
        for path in (source, tmp_path / "folder"):
            with pytest.raises(CannotWrite, match=r"there is such a file or folder, and it is not replaced"):
                recording.to_mcap(path)
        with pytest.raises(CannotWrite, match=r"cannot be written: No such file or directory"):
            recording.to_mcap(tmp_path / "nowhere" / "made.mcap")
        with pytest.raises(CannotWrite, match=r"cannot be written: Not a directory"):
            recording.to_mcap(source / "made.mcap")
    assert source.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.mcap", "folder"]


def test_a_ulog_is_refused(recordings_dir: Path, tmp_path: Path) -> None:
    with (
        Recording.open(recordings_dir / "other/px4_sample.ulg") as recording,
        pytest.raises(CannotWrite, match="it is a ULog"),
    ):
        recording.to_mcap(tmp_path / "made.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_source_that_becomes_shorter_leaves_nothing(tmp_path: Path) -> None:
    class Shrinking(MemorySource):
        def read(self, offset: int, length: int) -> bytes:
            if self.is_gone and offset < 2_000_000:
                raise SourceError("drive.mcap: became shorter while it was read")
            return super().read(offset, length)

        is_gone = False

    out = BytesIO()
    generate_mcap(tmp_path / "drive.mcap", size_bytes=5_000_000)
    out.write((tmp_path / "drive.mcap").read_bytes())
    source = Shrinking(out.getvalue(), "drive.mcap")
    with Recording.open(source) as recording:
        source.is_gone = True
        with pytest.raises(SourceError):
            recording.to_mcap(tmp_path / "made.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["drive.mcap"]


def test_overlapping_and_disordered_files_are_put_in_order(tmp_path: Path) -> None:
    chance = random.Random(5)
    for number in range(2):
        stamps = [T0 + chance.randrange(10**9) for _ in range(300)]
        chunks = [[("/t", stamp, bytes([number])) for stamp in stamps[at : at + 20]] for at in range(0, 300, 20)]
        source = mcap_of(chunks)
        (tmp_path / f"run_{number}.mcap").write_bytes(source.read(0, source.size_bytes))
    with Recording.open(tmp_path) as recording:
        recording.to_mcap(tmp_path / "made.mcap", options=McapOptions(chunk_bytes=1000))
    assert len(read_whole_mcap(tmp_path / "made.mcap").messages) == 600
