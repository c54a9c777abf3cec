"""Grouping of files into recordings."""

from __future__ import annotations

from pathlib import Path

import pytest

from kleinkram.recordings import (
    Content,
    RecordingFormat,
    RecordingGroup,
    RecordingGroupKind,
    RecordingSummary,
    group,
)
from kleinkram.recordings.formats.rosbag2.metadata import Rosbag2Metadata, compare_metadata, parse_rosbag2_metadata
from tests.recording_files.corpus import Entry, params

SINGLE, SPLIT, ROSBAG2 = RecordingGroupKind.single, RecordingGroupKind.split_set, RecordingGroupKind.rosbag2


def shape(paths: list[str]) -> list[tuple[str, RecordingGroupKind, tuple[str, ...]]]:
    return [(actual.name, actual.kind, actual.members) for actual in group(paths)]


def test_single_files() -> None:
    assert shape(["b.bag", "a.mcap", "a.bag", "notes.txt", "cam/front.png"]) == [
        ("a.bag", SINGLE, ("a.bag",)),
        ("a.mcap", SINGLE, ("a.mcap",)),
        ("b.bag", SINGLE, ("b.bag",)),
    ]


def test_a_rosbag2_folder_is_one_recording_in_the_order_of_its_numbers() -> None:
    paths = ["x/run/run_10.mcap", "x/run/run_9.mcap", "x/run/metadata.yaml", "x/run/run_0.mcap"]
    assert group(paths) == [
        RecordingGroup(
            "x/run",
            ROSBAG2,
            ("x/run/run_0.mcap", "x/run/run_9.mcap", "x/run/run_10.mcap"),
            "x/run/metadata.yaml",
        )
    ]


def test_the_file_of_a_rosbag2_folder_may_have_any_name() -> None:
    assert shape(["bag/metadata.yaml", "bag/test.db3"]) == [("bag", ROSBAG2, ("bag/test.db3",))]
    assert shape(["metadata.yaml", "test_0.db3.zstd"]) == [(".", ROSBAG2, ("test_0.db3.zstd",))]


def test_a_metadata_file_beside_many_recordings_is_not_theirs() -> None:
    """A mission's own metadata, say."""
    assert [kind for _, kind, _ in shape(["metadata.yaml", "a.mcap", "b.mcap"])] == [SINGLE, SINGLE]


def test_a_file_of_another_stem_in_a_rosbag2_folder_is_its_own_recording() -> None:
    assert shape(["run/metadata.yaml", "run/run_0.mcap", "run/other.mcap", "run/old.bag"]) == [
        ("run", ROSBAG2, ("run/run_0.mcap",)),
        ("run/old.bag", SINGLE, ("run/old.bag",)),
        ("run/other.mcap", SINGLE, ("run/other.mcap",)),
    ]


def test_metadata_alone_is_no_recording() -> None:
    assert group(["run/metadata.yaml"]) == []


def test_a_split_set_without_metadata() -> None:
    paths = ["m/run_0.db3", "m/run_1.db3", "m/run_2.db3"]
    assert shape(paths) == [("m/run.db3", SPLIT, tuple(paths))]


def test_numbered_recordings_are_not_a_split_set() -> None:
    assert [kind for _, kind, _ in shape(["run_1.mcap", "run_2.mcap"])] == [SINGLE, SINGLE]
    assert [kind for _, kind, _ in shape(["run_0.bag", "run_1.bag"])] == [SINGLE, SINGLE]


def test_same_numbers_in_two_folders_or_formats_are_apart() -> None:
    assert len(shape(["a/run_0.mcap", "b/run_1.mcap"])) == 2
    assert [kind for _, kind, _ in shape(["run_0.mcap", "run_1.mcap", "run_0.db3", "run_1.db3"])] == [SPLIT, SPLIT]


def test_split_bags() -> None:
    first = ["field_2024-05-01-10-00-00_0.bag", "field_2024-05-01-10-05-00_1.bag"]
    second = ["field_2024-05-01-11-00-00_0.bag", "field_2024-05-01-11-05-00_1.bag"]
    alone = "field_2024-05-01-12-00-00_0.bag"
    assert shape([alone, *second, *first]) == [
        (first[0], SPLIT, tuple(first)),
        (second[0], SPLIT, tuple(second)),
        (alone, SINGLE, (alone,)),
    ]


def test_names_and_kinds_are_unique() -> None:
    paths = ["run.mcap", "run_0.mcap", "run_1.mcap", "run.bag", "RUN.mcap", "run.db3", "x/metadata.yaml", "x/x.db3"]
    names = [(name, kind) for name, kind, _ in shape(paths)]
    assert len(names) == len(set(names))
    assert sum(len(members) for _, _, members in shape(paths)) == 7


@pytest.mark.parametrize("entry", params("rosbag2 metadata.yaml") + params("rosbag2 metadata.yaml", broken=True))
def test_metadata_of_real_recordings(entry: Entry, recordings_dir: Path) -> None:
    expected = entry.expected
    actual = parse_rosbag2_metadata((recordings_dir / entry.name).read_text())
    assert actual is not None
    assert (actual.message_count, actual.duration_ns) == (expected["messages_claimed"], expected["duration_ns_claimed"])
    assert (actual.storage, list(actual.files)) == (expected["storage"], expected["files"])
    assert actual.version == expected["version"]
    assert sum(topic.message_count or 0 for topic in actual.topics) >= (actual.message_count or 0)
    assert all(topic.name and topic.message_type and topic.serialization_format for topic in actual.topics)
    assert [actual.compression, actual.compression_mode] == [
        (word and word.lower()) or "" for word in expected["compression"]
    ]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[",
        "rosbag2_bagfile_information: 3",
        "rosbag2_bagfile_information: {}",
        "\t\x00",
        "- 1\n- 2",
        "&a [*a]",
    ],
)
def test_invalid_metadata_is_refused(text: str) -> None:
    assert parse_rosbag2_metadata(text) is None


def test_incomplete_metadata_is_read_as_far_as_possible() -> None:
    text = "rosbag2_bagfile_information:\n  message_count: many\n  files:\n    - path: a.db3\n    - 3\n"
    actual = parse_rosbag2_metadata(text)
    assert actual is not None
    assert (actual.files, actual.message_count, actual.storage) == (("a.db3",), None, None)


def test_the_metadata_decides_the_files_and_their_order() -> None:
    stated = Rosbag2Metadata(files=("run/b.db3", "a.db3"))
    paths = ["run/metadata.yaml", "run/a.db3", "run/b.db3", "run/a_1.db3", "run/other.bag"]
    assert group(paths, {"run/metadata.yaml": stated}) == [
        RecordingGroup("run", ROSBAG2, ("run/b.db3", "run/a.db3", "run/a_1.db3"), "run/metadata.yaml"),
        RecordingGroup("run/other.bag", SINGLE, ("run/other.bag",)),
    ]


def test_data_files_that_were_renamed_are_still_those_of_their_folder() -> None:
    stated = Rosbag2Metadata(files=("run_0.db3",))
    actual = group(["field/metadata.yaml", "field/field_0.db3"], {"field/metadata.yaml": stated})
    assert actual == [RecordingGroup("field", ROSBAG2, ("field/field_0.db3",), "field/metadata.yaml")]


def test_metadata_that_name_files_are_a_recording_without_them() -> None:
    stated = Rosbag2Metadata(files=("run_0.db3",))
    assert group(["run/metadata.yaml"], {"run/metadata.yaml": stated}) == [
        RecordingGroup("run", ROSBAG2, (), "run/metadata.yaml")
    ]


def test_recordings_of_cameras_are_recordings() -> None:
    assert shape(["front.svo2", "a.bag.zst"]) == [
        ("a.bag.zst", SINGLE, ("a.bag.zst",)),
        ("front.svo2", SINGLE, ("front.svo2",)),
    ]


def test_timed_names_of_rosbag2_form_one_recording_in_numeric_order() -> None:
    paths = [f"patrol/{k}_patrol_2026_01_17-10_{k:02d}_30.mcap" for k in range(12)]
    (actual,) = group(reversed(paths))
    assert (actual.kind, list(actual.members)) == (RecordingGroupKind.split_set, paths)
    (actual,) = group([*paths, "patrol/metadata.yaml"])
    assert (actual.kind, actual.name, list(actual.members)) == (RecordingGroupKind.rosbag2, "patrol", paths)


def test_a_smaller_number_begins_the_next_recording_of_that_name() -> None:
    first = [f"{k}_patrol_2026_01_17-10_0{k}_30.db3" for k in range(3)]
    second = [f"{k}_patrol_2026_01_17-11_0{k}_30.db3" for k in range(2)]
    assert [list(actual.members) for actual in group([*second, *first])] == [first, second]


@pytest.mark.parametrize(
    "names",
    [
        ["rosbag2_2026_01_17-10_00_00.mcap", "rosbag2_2026_01_17-10_00_45.mcap"],
        ["run_20260117_000000.mcap", "run_20260117_000130.mcap"],
        ["run_2026-01-17-10-00-00.mcap", "run_2026-01-17-10-00-45.mcap"],
        ["run_2026_01_17T10_00.db3", "run_2026_01_17T10_45.db3"],
    ],
)
def test_a_time_at_the_end_of_a_name_is_no_split_number(names: list[str]) -> None:
    assert [list(actual.members) for actual in group(names)] == [[name] for name in names]


def test_a_number_after_a_time_is_a_split_number() -> None:
    names = [f"rosbag2_2026_01_17-10_00_00_{k}.mcap" for k in (0, 1, 2, 10)]
    assert [list(actual.members) for actual in group(names)] == [names]


def test_paths_that_windows_wrote_name_the_same_files() -> None:
    text = "rosbag2_bagfile_information:\r\n  relative_file_paths:\r\n    - bag\\bag_0.mcap\r\n"
    stated = parse_rosbag2_metadata(text)
    assert stated is not None
    (actual,) = group(["bag/bag_0.mcap", "bag/metadata.yaml"], {"bag/metadata.yaml": stated})
    assert actual.members == ("bag/bag_0.mcap",)
    assert compare_metadata(stated, [("bag_0.mcap", RecordingSummary(RecordingFormat.mcap, Content.indexed))]) == []


def test_bags_still_being_written_are_recordings() -> None:
    names = ["night/run.bag.active", "x_2024-05-01-10-00-00_0.bag", "x_2024-05-01-10-05-00_1.bag.active"]
    assert [list(actual.members) for actual in group(names)] == [names[:1], names[1:]]
