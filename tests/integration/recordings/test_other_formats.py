"""Files other than recordings are recognised by content, with cheap facts."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from kleinkram.recordings import Content, Depth, FileSource, Recording, RecordingFormat, RecordingSummary, summarise
from kleinkram.recordings.errors import NotARecording
from kleinkram.recordings.formats.rosbag2.metadata import parse_rosbag2_metadata
from kleinkram.recordings.formats.text_files import MAX_LINE_BYTES, parse_stamp, read_lines
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import McapWriter


def summarise_text(text: str | bytes, name: str = "file") -> RecordingSummary:
    data = text.encode() if isinstance(text, str) else text
    summary = summarise(MemorySource(data, name))
    scanned = scan(SourceReader(MemorySource(data, name)))
    assert (scanned.format, scanned.content, scanned.facts, scanned.problems) == (
        summary.format,
        summary.content,
        summary.facts,
        summary.problems,
    )
    return summary


def facts(summary: RecordingSummary) -> dict[str, object]:
    """Facts by name; those of which there are several as a list."""
    actual: dict[str, list[object]] = {}
    for fact in summary.facts:
        actual.setdefault(fact.name, []).append(fact.value)
    return {name: values[0] if len(values) == 1 else values for name, values in actual.items()}


def test_real_trajectories(recordings_dir: Path) -> None:
    """Poses and way as a straightforward reading has them."""
    for path in sorted(recordings_dir.glob("trajectories/*.tum")):
        rows = [line.split() for line in path.read_text().splitlines() if line.strip() and line[0] != "#"]
        places = [[float(cell) for cell in row[1:4]] for row in rows]
        way = sum(math.dist(a, b) for a, b in pairwise(places))
        with FileSource(path) as source:
            summary = summarise(source)
        assert (summary.format, summary.content, summary.problems) == (RecordingFormat.tum, Content.opaque, ())
        assert facts(summary)["poses"] == len(rows)
        assert facts(summary)["path_length"] == pytest.approx(way, abs=0.001)
        stamps = [round(float(row[0]), 3) for row in rows]
        assert summary.start_ns is not None
        assert summary.end_ns is not None
        assert (round(summary.start_ns / 1e9, 3), round(summary.end_ns / 1e9, 3)) == (min(stamps), max(stamps))


@pytest.mark.parametrize("seed", range(5))
def test_mutations_never_raise(seed: int, recordings_dir: Path) -> None:
    """Bytes of real files exchanged at random; a longer run than this found what the tests above keep."""
    chosen = random.Random(seed)
    names = ("other/px4_sample.ulg", "trajectories/euroc_MH_04_vislam_ba0.tum", "ros2-db3/event_camera/metadata.yaml")
    for name in (*names, "mcap/diagnostics_rosout_ros2.mcap.zstd", "trajectories/expected-evo-1.38.1.json"):
        data = bytearray((recordings_dir / name).read_bytes()[:30_000])
        for _ in range(chosen.choice((1, 5, 50))):
            data[chosen.randrange(len(data))] = chosen.randrange(256)
        summary = scan(SourceReader(MemorySource(bytes(data), name)))
        assert summary.depth is Depth.scan
        assert summary.content is not Content.error
        parse_rosbag2_metadata(bytes(data).decode("utf-8", "replace"))


def test_a_trajectory_with_faults() -> None:
    text = (
        "# timestamp tx ty tz qx qy qz qw\n"
        "1.5 0 0 0 0 0 0 1\n2.5 3 4 0 0 0 0 1\n2.0 3 4 12 0 0 0 1\nnan 0 0 0 0 0 0 1\n3 0 0 0 0 0 0 5\n"
    )
    summary = summarise_text(text, "a.tum")
    assert facts(summary) == {"poses": 4, "path_length": 30.0, "duration": 1.5}
    assert (summary.start_ns, summary.end_ns) == (1_500_000_000, 3_000_000_000)
    assert [(p.code, p.where) for p in summary.problems] == [
        ("lines-damaged", "line 5"),
        ("out-of-order", "file"),
        ("rotation-not-unit", "file"),
    ]


def test_kitti() -> None:
    text = "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 3 0 1 0 0 0 0 1 4\n"
    summary = summarise_text(text, "00.txt")
    assert (summary.format, facts(summary)) == (RecordingFormat.kitti, {"poses": 2, "path_length": 5.0})


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1403638128.545096874", 1403638128545096874),
        ("1403638128.5450968749", 1403638128545096874),
        ("12", 12_000_000_000),
        (".5", 500_000_000),
        ("1e3", 1_000_000_000_000),
    ],
)
def test_seconds_are_nanoseconds_without_rounding(text: str, expected: int) -> None:
    if text.startswith("."):
        assert parse_stamp("0" + text) == expected
    assert parse_stamp(text) == expected


@pytest.mark.parametrize("text", ["nan", "inf", "-1", "1e300", "x", "99999999999999999999"])
def test_invalid_timestamps_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        parse_stamp(text)


def test_tables() -> None:
    summary = summarise_text('#stamp, "a, b",c\n1,2,3\n4,5,6\n', "imu.csv")
    assert summary.format is RecordingFormat.csv
    summary = summarise_text("stamp,b,c\n1,2,3\n4,5,6\n", "imu.csv")
    assert facts(summary) == {"columns": 3, "rows": 2, "column": ["stamp", "b", "c"]}
    assert facts(summarise_text("1,2\n3,4\n", "a.csv")) == {"columns": 2, "rows": 2}


def test_yaml_and_calibrations() -> None:
    summary = summarise_text("robot: anymal\nlist:\n  - nested: 1\n'quoted key': 2\n# no: comment\n", "m.yaml")
    assert (summary.format, facts(summary)) == (
        RecordingFormat.yaml,
        {"keys": 3, "key": ["robot", "list", "quoted key"]},
    )
    ros = "image_width: 752\nimage_height: 480\ncamera_matrix:\n  rows: 3\ndistortion_coefficients:\n  rows: 1\n"
    assert facts(summarise_text(ros, "cam.yaml"))["kind"] == "camera calibration"
    assert facts(summarise_text("%YAML:1.0\n---\n" + ros, "cam.yml"))["kind"] == "camera calibration"
    kalibr = "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [0]\n  intrinsics: [1, 2]\n"
    assert facts(summarise_text(kalibr, "chain.yaml"))["kind"] == "camera calibration"
    assert "kind" not in facts(summarise_text("cam0: here\n", "no.yaml"))


@pytest.mark.parametrize(
    ("text", "actual"),
    [
        ('{"a": 1, "b": [2]}', {"keys": 2, "key": ["a", "b"]}),
        ("[1, 2, 3]", {"items": 3}),
        ("[]", {"items": 0}),
        ("{}", {"keys": 0}),
        ('{"long": "' + "x" * 10_000 + '"}', {"keys": 1, "key": "long"}),
    ],
)
def test_json(text: str, actual: dict[str, object]) -> None:
    summary = summarise_text(text, "a.json")
    assert (summary.format, summary.content, facts(summary)) == (RecordingFormat.json, Content.opaque, actual)
    assert summary.problems == ()


@pytest.mark.parametrize("text", ['{"a": 1', "[" * 100_000, '{"a": 1} {"b": 2}'])
def test_invalid_json(text: str) -> None:
    summary = summarise_text(text, "a.json")
    assert [p.code for p in summary.problems] == ["json-damaged"]


def test_json_files_of_the_conformance_set_are_opaque(recordings_dir: Path) -> None:
    for path in sorted(recordings_dir.glob("conformance/*.json"))[:5]:
        with FileSource(path) as source:
            summary = summarise(source)
        assert (summary.format, summary.content, summary.problems) == (RecordingFormat.json, Content.opaque, ())
        assert facts(summary)["keys"] == len(json.loads(path.read_text()))


def test_a_recording_of_a_camera(tmp_path: Path) -> None:
    path = tmp_path / "front.svo2"
    with path.open("wb") as file:
        writer = McapWriter(file, library="libmcap stereolabs")
        schema = writer.add_schema("jsonschema", "jsonschema", b"{}")
        frames = writer.add_channel("Camera_SN38486288/side_by_side", schema, "zed")
        sensors = writer.add_channel("Camera_SN38486288/sensors", schema, "json")
        for number in range(30):
            writer.add_message(frames, number * 10**7, b"h264", publish_time_ns=0)
            writer.add_message(sensors, number * 10**7, b"{}", publish_time_ns=0)
        writer.finish()
    with FileSource(path) as source:
        summary = summarise(source)
    assert (summary.format, summary.content, summary.problems) == (RecordingFormat.svo2, Content.indexed, ())
    assert (facts(summary)["camera_serial"], facts(summary)["frames"]) == ("38486288", 30)
    assert summary.message_count == 60


def test_large_files_are_only_recognised() -> None:
    text = MemorySource(b"1 0 0 0 0 0 0 1\n" * 100, "a.tum")
    summary = summarise(text, max_bytes=1000)
    assert (summary.content, summary.facts, summary.depth) == (Content.opaque, (), Depth.summary)
    assert "1600 bytes" in (summary.reason or "")


def test_lines_are_bounded() -> None:
    long = b"x" * (3 * MAX_LINE_BYTES)
    lines = [*read_lines(SourceReader(MemorySource(b"a\r\n" + long + b"\n\nb")))]
    assert [len(line) for line in lines] == [1, MAX_LINE_BYTES, 0, 1]


@pytest.mark.parametrize(("name", "unit"), [("ns.txt", "ns"), ("us.tum", "us"), ("s.tum", None), ("numpy.txt", None)])
def test_stamps_of_a_trajectory_may_be_in_any_unit(
    make_case: Callable[[str], Path], name: str, unit: str | None
) -> None:
    summary = summarise_text((make_case("20A") / name).read_text(), name)
    actual = facts(summary)
    assert (actual["poses"], actual["path_length"], actual["duration"]) == (100, 9.9, 9.9)
    assert actual.get("stamp_unit") == unit
    assert [problem.code for problem in summary.problems] == (["stamp-unit"] if unit else [])
    start_ns = 1_698_132_949_012_009_859
    assert summary.start_ns == (start_ns if unit != "us" else start_ns // 1000 * 1000)


def test_a_first_stamp_of_zero_does_not_set_the_unit() -> None:
    lines = [f"{stamp} 1 2 3 0 0 0 1\n" for stamp in (0, 1_403_636_579_500_000_000, 1_403_636_580_500_000_000)]
    summary = summarise_text("".join(lines), "a.tum")
    assert (summary.start_ns, summary.end_ns) == (0, 1_403_636_580_500_000_000)
    assert facts(summary)["poses"] == 3


@pytest.mark.parametrize("columns", [8, 17])
@pytest.mark.parametrize("header", ["#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w []", ""])
def test_poses_of_euroc(columns: int, header: str) -> None:
    start_ns = 1_403_638_128_545_096_874
    names = [*header.split(","), " q_RS_x []", " q_RS_y []", " q_RS_z []", *["b"] * 9][:columns]
    rows = [[start_ns + n * 10**8, n * 0.1, 0, 0, 1, 0, 0, 0, *[0.5] * 9][:columns] for n in range(100)]
    lines = [",".join(map(str, row)) for row in rows]
    summary = summarise_text("\n".join([",".join(names)] * bool(header) + lines) + "\n", "data.csv")
    actual = facts(summary)
    assert summary.format is RecordingFormat.csv
    assert (actual["poses"], actual["path_length"], actual["duration"]) == (100, 9.9, 9.9)
    assert (actual["columns"], actual["rows"]) == (columns, 100)
    assert (summary.start_ns, summary.end_ns) == (start_ns, start_ns + 99 * 10**8)
    assert summary.problems == ()


def test_opening_a_trajectory_names_the_tools_to_use(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text("1 0 0 0 0 0 0 1\n" * 9)
    with pytest.raises(NotARecording, match=r"trajectory.*klein inspect"):
        Recording.open(path)
