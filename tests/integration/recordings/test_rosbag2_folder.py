"""A rosbag2 folder as one recording: missing files, extra files, and wrong metadata.yaml."""

from __future__ import annotations

import shutil
import time
from dataclasses import replace
from pathlib import Path

import pytest

from kleinkram.recordings import Content, Lost, Problem, Recording, RecordingFormat, RecordingSummary, TopicSummary
from kleinkram.recordings.formats.rosbag2.metadata import (
    Member,
    MetadataFile,
    MetadataTopic,
    Rosbag2Metadata,
    compare_metadata,
    parse_rosbag2_metadata,
)
from kleinkram.recordings.inspect import Inspection, InspectionKind, inspect_paths
from kleinkram.recordings.sample.writers import Db3Writer
from tests.recording_files.databases import T0, faults

STATED = Rosbag2Metadata(
    files=("run/a_0.db3", "run/a_1.db3"),
    message_count=30,
    duration_ns=2_000_000_000,
    start_ns=T0,
    storage="sqlite3",
    version=5,
    topics=(MetadataTopic("/imu", "sensor_msgs/msg/Imu", "cdr", 30), MetadataTopic("/never", "a/msg/B", "cdr", 0)),
    file_entries=(MetadataFile("run/a_0.db3", 20, T0, 1_000_000_000), MetadataFile("run/a_1.db3", 10, T0, 1)),
)


def member(name: str, count: int | None = None, start_ns: int | None = None, end_ns: int | None = None) -> Member:
    return name, RecordingSummary(
        RecordingFormat.rosbag2_db3, Content.indexed, message_count=count, start_ns=start_ns, end_ns=end_ns
    )


MEMBERS = [
    member("a_0.db3", 20, T0, T0 + 1_000_000_000),
    member("a_1.db3", 10, T0 + 1_500_000_000, T0 + 2_000_000_000),
]
TOPICS = [TopicSummary("/imu", "sensor_msgs/msg/Imu", "sensor_msgs/msg/Imu", "ros2msg", "cdr", 30)]


def codes(problems: list[Problem] | tuple[Problem, ...]) -> list[tuple[str, str]]:
    return [(problem.code, problem.where) for problem in problems]


def test_matching_metadata_causes_no_problem() -> None:
    assert compare_metadata(STATED, MEMBERS, TOPICS) == []
    old_type = [replace(TOPICS[0], message_type="sensor_msgs/Imu")]
    assert compare_metadata(STATED, MEMBERS, old_type) == []
    within = replace(STATED, start_ns=T0 + 900_000, duration_ns=1_999_100_000)
    assert compare_metadata(within, MEMBERS, TOPICS) == []


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        (replace(STATED, message_count=31), [("metadata-count", "metadata.yaml")]),
        (replace(STATED, start_ns=T0 + 2_000_000), [("metadata-span", "metadata.yaml")]),
        (replace(STATED, duration_ns=5), [("metadata-span", "metadata.yaml")]),
        (replace(STATED, storage="mcap"), [("metadata-storage", "a_0.db3"), ("metadata-storage", "a_1.db3")]),
        (replace(STATED, topics=(MetadataTopic("/imu", "a/msg/Imu", "cdr", 30),)), [("metadata-type", "/imu")]),
        (
            replace(STATED, topics=(MetadataTopic("/imu", "sensor_msgs/msg/Imu", "xyz", 30),)),
            [("metadata-encoding", "/imu")],
        ),
        (
            replace(STATED, topics=(MetadataTopic("/imu", "sensor_msgs/msg/Imu", "ros1", 30),)),
            [("metadata-encoding", "/imu")],
        ),
        (
            replace(STATED, topics=(MetadataTopic("/imu", "sensor_msgs/msg/Imu", "cdr", 29),)),
            [("metadata-topic-count", "/imu")],
        ),
        (
            replace(STATED, topics=(*STATED.topics, MetadataTopic("/gps", "a/msg/B", "cdr", 3))),
            [("metadata-topic-count", "/gps")],
        ),
        (replace(STATED, file_entries=(MetadataFile("a_1.db3", 9, None, None),)), [("metadata-count", "a_1.db3")]),
        (replace(STATED, files=("a_0.db3",)), [("member-unlisted", "a_1.db3")]),
        (
            replace(STATED, files=("a_0.db3", "a_2.db3")),
            [("member-missing", "a_2.db3"), ("member-unlisted", "a_1.db3")],
        ),
    ],
)
def test_disagreements_with_the_metadata_are_named(stated: Rosbag2Metadata, expected: list[tuple[str, str]]) -> None:
    assert codes(compare_metadata(stated, MEMBERS, TOPICS)) == expected


def test_unknown_values_are_not_compared() -> None:
    assert compare_metadata(Rosbag2Metadata(files=("a_0.db3", "a_1.db3")), MEMBERS, TOPICS) == []
    unknown = [member("a_0.db3"), member("a_1.db3")]
    assert compare_metadata(replace(STATED, message_count=31), unknown) == []


def test_the_span_that_early_recorders_wrote_is_accepted() -> None:
    old = replace(STATED, version=4, start_ns=T0 + 1_500_000_000, duration_ns=1_000_000_000, file_entries=())
    assert compare_metadata(old, MEMBERS, TOPICS) == []
    assert codes(compare_metadata(replace(old, version=5), MEMBERS, TOPICS)) == [("metadata-span", "metadata.yaml")]


def inspect_one(folder: Path) -> Inspection:
    (actual,) = inspect_paths([folder])
    return actual


WHOLE = {
    "ros2-db3/vicon_test6": 7396,
    "ros2-db3/vicon_standard2": 15883,
    "ros2-db3/event_camera": 517,
    "ros2-db3/all_types_94_topics": 188,
    "ros2-db3/old_schema": 7,
    "ros2-db3/empty_bag": 0,
    "ros2-db3/file_zstd_split": 775,
    "mcap/split_wbag": 6074,
    "mcap/SO_bag": 2671,
    "mcap/services": 10,
    "mcap/all_types_94_topics": 188,
    "mcap/base_msgs": 3,
    "mcap/talker": 20,
    "mcap/cdr_test": 7,
    "mcap/seek": 5,
    "mcap/rewriter_b": 75,
}


@pytest.mark.parametrize("folder", WHOLE)
def test_complete_folders_agree_with_their_metadata(folder: str, recordings_dir: Path) -> None:
    actual = inspect_one(recordings_dir / folder)
    assert (actual.kind.value, actual.summary.content) == ("recording", Content.indexed)
    assert faults(actual.summary.problems) == []
    assert actual.summary.message_count == WHOLE[folder]
    assert list(actual.members) == sorted(actual.members)


def test_the_missing_file_of_a_split_is_named(recordings_dir: Path) -> None:
    summary = inspect_one(recordings_dir / "derived/split_missing_file").summary
    assert codes(summary.problems) == [("member-missing", "wbag_2.mcap")]
    assert (summary.content, summary.message_count) == (Content.recovered, 4834)
    assert summary.reason == "wbag_2.mcap is missing; 4834 of 6074 messages can be read"
    assert summary.lost == Lost(0, 0, 1240)


def test_wrong_counts_are_named(recordings_dir: Path) -> None:
    summary = inspect_one(recordings_dir / "derived/metadata_wrong_counts").summary
    first, *others = faults(summary.problems)
    assert first == Problem("metadata-count", "metadata.yaml", "it says 2678 messages, the files hold 2671")
    stated = parse_rosbag2_metadata((recordings_dir / "derived/metadata_wrong_counts/metadata.yaml").read_text())
    assert stated is not None
    assert codes(others) == [("metadata-topic-count", name) for name in sorted(t.name for t in stated.topics)]
    assert (summary.content, summary.message_count, summary.lost) == (Content.indexed, 2671, None)


def test_an_encoding_that_does_not_exist_is_named(recordings_dir: Path) -> None:
    summary = inspect_one(recordings_dir / "broken/wrong_rmw_db3").summary
    assert codes(summary.problems) == [("metadata-encoding", "/test_topic"), ("metadata-encoding", "/array_topic")]
    assert (summary.content, summary.message_count) == (Content.indexed, 7)


def test_metadata_whose_data_are_missing(recordings_dir: Path) -> None:
    actual = inspect_one(recordings_dir / "broken/metadata_only_data_missing")
    assert (actual.kind.value, actual.members) == ("recording", ())
    assert (actual.summary.format, actual.summary.content) == (RecordingFormat.rosbag2_db3, Content.broken)
    assert actual.summary.reason == "metadata.yaml names a data file with 27792 messages, but none is there"
    assert codes(actual.summary.problems) == [("member-missing", "rosbag2_2025_12_06-03_46_47_0.db3")]
    assert actual.summary.lost == Lost(0, 0, 27792)


def test_a_split_set_without_metadata_is_one_recording(recordings_dir: Path) -> None:
    summary = inspect_one(recordings_dir / "ros2-db3/split_no_metadata").summary
    assert (summary.content, summary.message_count, summary.problems) == (Content.indexed, 3177, ())
    assert [(topic.name, topic.count) for topic in summary.topics] == [("/chatter", 3177)]


def test_files_that_are_compressed_one_by_one(recordings_dir: Path) -> None:
    summary = inspect_one(recordings_dir / "ros2-db3/file_zstd_split").summary
    assert (summary.format, summary.compression) == (RecordingFormat.rosbag2_db3, ("file-zstd",))
    assert {topic.name: topic.count for topic in summary.topics} == {
        "/parameter_events": 0,
        "/rosout": 392,
        "/topic": 383,
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    writer = Db3Writer(tmp_path / "run")
    topic = writer.add_topic("/imu", "sensor_msgs/msg/Imu")
    for number in range(500):
        writer.add_message(topic, T0 + number * 10_000_000, b"x" * 300)
    writer.finish()
    return tmp_path / "run"


def edit(folder: Path, old: str, new: str) -> None:
    path = folder / "metadata.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_message_compression_is_known_from_metadata_only(folder: Path) -> None:
    edit(
        folder,
        'compression_format: ""\n  compression_mode: ""',
        "compression_format: zstd\n  compression_mode: MESSAGE",
    )
    assert inspect_one(folder).summary.compression == ("message-zstd",)
    stated = parse_rosbag2_metadata((folder / "metadata.yaml").read_text())
    assert stated is not None
    assert (stated.compression_mode, stated.compression) == ("message", "zstd")


def test_the_loss_of_a_cut_database_is_what_its_metadata_claim(folder: Path) -> None:
    path = folder / "run_0.db3"
    path.write_bytes(path.read_bytes()[:100_000])
    summary = inspect_one(folder).summary
    assert summary.content is Content.recovered
    assert summary.message_count is not None
    assert 0 < summary.message_count < 500
    assert summary.lost is not None
    assert summary.lost.messages == 500 - summary.message_count
    assert (summary.reason or "").endswith(f"{summary.message_count} of 500 messages can be read")


def test_a_metadata_yaml_of_another_kind_is_ignored(folder: Path) -> None:
    (folder / "metadata.yaml").write_text("robot: anymal\noperator: Ada\n")
    (database,) = folder.glob("*.db3")
    actual = inspect_one(folder)
    assert (actual.kind, actual.path) == (InspectionKind.file, str(database))
    assert (codes(actual.summary.problems), actual.summary.message_count) == ([], 500)
    with Recording.open(folder) as recording:
        assert (len(list(recording.raw_messages())), recording.problems) == (500, ())


def test_damaged_metadata_leave_the_data(folder: Path) -> None:
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    summary = inspect_one(folder).summary
    assert codes(summary.problems) == [("metadata-damaged", "metadata.yaml")]
    assert (summary.content, summary.message_count) == (Content.indexed, 500)


def test_a_surplus_file_is_named_and_counted(folder: Path) -> None:
    shutil.copy(folder / "run_0.db3", folder / "run_1.db3")
    actual = inspect_one(folder)
    assert [Path(member).name for member in actual.members] == ["run_0.db3", "run_1.db3"]
    assert codes(actual.summary.problems) == [("member-unlisted", "run_1.db3")]


@pytest.mark.parametrize("version", range(1, 10))
def test_metadata_of_every_version(version: int) -> None:
    topic = "topic_and_type" if version == 1 else "topic_metadata"
    text = (
        f"rosbag2_bagfile_information:\n  version: {version}\n  storage_identifier: sqlite3\n"
        "  relative_file_paths:\n    - a_0.db3\n  duration:\n    nanoseconds: 5\n"
        "  starting_time:\n    nanoseconds_since_epoch: 7\n  message_count: 2\n"
        f"  topics_with_message_count:\n    - {topic}:\n        name: /a\n        type: std_msgs/msg/String\n"
        "        serialization_format: cdr\n"
    )
    if version >= 4:
        qos = '"- history: 3"' if version < 9 else "\n          - history: keep_last\n            depth: 3"
        text += f"        offered_qos_profiles: {qos}\n"
    if version >= 7:
        text += "        type_description_hash: RIHS01_00\n"
    text += "      message_count: 2\n"
    if version >= 3:
        text += '  compression_format: ""\n  compression_mode: ""\n'
    if version >= 5:
        text += (
            "  files:\n    - path: a_0.db3\n      starting_time:\n        nanoseconds_since_epoch: 7\n"
            "      duration:\n        nanoseconds: 5\n      message_count: 2\n"
        )
    if version >= 6:
        text += "  custom_data: ~\n"
    if version >= 8:
        text += "  ros_distro: jazzy\n"
    stated = parse_rosbag2_metadata(text)
    assert stated == Rosbag2Metadata(
        files=("a_0.db3",),
        message_count=2,
        duration_ns=5,
        start_ns=7,
        storage="sqlite3",
        version=version,
        topics=(MetadataTopic("/a", "std_msgs/msg/String", "cdr", 2),),
        file_entries=(MetadataFile("a_0.db3", 2, 7, 5),) if version >= 5 else (),
        ros_distro="jazzy" if version >= 8 else "",
    )


def test_a_summary_without_topics_can_be_compared() -> None:
    summary = RecordingSummary(RecordingFormat.mcap, Content.indexed, message_count=20, start_ns=T0, end_ns=T0 + 5)
    stated = replace(STATED, files=("a_0.db3",), message_count=20, duration_ns=5)
    assert codes(compare_metadata(stated, [("a_0.db3", summary)])) == [("metadata-storage", "a_0.db3")]


def test_merge_keys_do_not_unfold() -> None:
    levels = "".join(f"a{n}: &a{n} {{<<: [*a{n - 1}, *a{n - 1}]}}\n" for n in range(1, 200))
    text = f"a0: &a0 {{k: 1}}\n{levels}rosbag2_bagfile_information: {{version: 4, message_count: 12}}\n"
    stated = parse_rosbag2_metadata(text)
    assert stated is not None
    assert (stated.version, stated.message_count) == (4, 12)


@pytest.mark.parametrize(
    "value", ["!!bool x", "!!int ''", "!!timestamp x", '"\\U99999999"', "9" * 5000, "-3", "1.5", "~"]
)
def test_a_value_that_is_no_number_is_left_out(value: str) -> None:
    stated = parse_rosbag2_metadata(f"rosbag2_bagfile_information: {{version: 4, message_count: {value}}}")
    assert stated is None or (stated.version, stated.message_count) == (4, None)


@pytest.mark.parametrize("text", ["[" * 4_000_000, "rosbag2_bagfile_information:\n  x: " + "[" * 3000, "- " * 100_000])
def test_deeply_nested_metadata_is_refused_at_once(text: str) -> None:
    began = time.thread_time()
    assert parse_rosbag2_metadata(text) is None
    assert time.thread_time() - began < 1
