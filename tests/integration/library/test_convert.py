"""`convert`: recordings become MCAPs or tables of the mission, and what was lost or left out is said."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import pytest

from kleinkram.action.testing import TryOutResult, try_out
from kleinkram.client.actions import read_manifest
from kleinkram.contract.access import Right
from kleinkram.contract.actions import Network
from kleinkram.library import slam_evaluate
from kleinkram.recordings import Recording
from kleinkram.recordings.sample import generate_bag, generate_db3, generate_mcap
from kleinkram.recordings.writing.conversion import target_names
from tests.recording_files.builders import T0, mcap_of
from tests.recording_files.tables import as_arrow
from tests.recording_files.whole_mcap import read_whole_mcap
from tests.recording_files.writers import McapWriter

CONVERT = Path(slam_evaluate.__file__).parent / "convert.py"


def convert(tmp_path: Path, files: Mapping[str, Path | bytes], **parameters: str | int | bool) -> TryOutResult:
    return try_out(CONVERT, tmp_path / "run", files=files, parameters={**parameters}, timeout_s=100)


@pytest.fixture(autouse=True)
def _run_folder(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    generate_mcap(folder / "drive.mcap", size_bytes=2_000_000)
    generate_bag(folder / "drive.bag", size_bytes=2_000_000)
    generate_db3(folder / "ros2", size_bytes=2_000_000)
    return folder


def test_the_script_describes_itself() -> None:
    manifest = read_manifest(CONVERT)
    assert (manifest.name, manifest.right) == ("convert", Right.create)
    assert manifest.network is Network.none
    assert not manifest.inputs.derived


def test_a_mission_of_every_format(drives: Path, tmp_path: Path) -> None:
    """The bag and the database are converted; the MCAP is one already."""
    database = next((drives / "ros2").glob("*.db3"))
    files: dict[str, Path | bytes] = {
        "nuc/drive.bag": drives / "drive.bag",
        "drive.mcap": drives / "drive.mcap",
        "ros2/metadata.yaml": drives / "ros2" / "metadata.yaml",
        f"ros2/{database.name}": database,
    }
    ran = convert(tmp_path, files)
    assert ran.exit_code == 0, ran.log
    made = {file.to: file.derived_from for file in ran.report.mission_files}
    assert made == {
        "derived/nuc/drive.mcap": ["nuc/drive.bag"],
        "derived/ros2.mcap": ["ros2/metadata.yaml", f"ros2/{database.name}"],
    }
    (finding,) = ran.report.findings
    assert (finding.severity.value, finding.code, finding.file) == ("info", "convert.unchanged", "drive.mcap")
    whole = read_whole_mcap(ran.out / "nuc/drive.mcap")
    with Recording.open(drives / "drive.bag") as source:
        assert [one[4] for one in whole.messages] == [message.data for message in source.raw_messages()]
    assert ran.metric("messages", "nuc/drive.bag") == len(whole.messages)
    sizes = (drives / "drive.bag").stat().st_size, (ran.out / "nuc/drive.mcap").stat().st_size
    assert (ran.metric("bytes_in", "nuc/drive.bag"), ran.metric("bytes_out", "nuc/drive.bag")) == sizes
    assert ran.metric("size_ratio", "nuc/drive.bag") == sizes[1] / sizes[0]
    assert ran.metric("lost_messages", "nuc/drive.bag") == 0


def test_recompression_of_selected_topics_as_artifacts(drives: Path, tmp_path: Path) -> None:
    ran = convert(
        tmp_path,
        {"drive.mcap": drives / "drive.mcap", "drive.bag": drives / "drive.bag"},
        recordings="*.mcap",
        topics="/imu*, /odom",
        compression="lz4",
        level=9,
        to_mission=False,
    )
    assert ran.exit_code == 0, ran.log
    assert ran.report.mission_files == []
    whole = read_whole_mcap(ran.out / "drive.mcap")
    assert whole.compressions == {"lz4"}
    assert {channel.topic for channel in whole.channels} == {"/imu/data", "/odom"}
    assert not (ran.out / "drive.bag.mcap").exists()


def test_a_damaged_recording_is_repaired_and_its_loss_reported(drives: Path, tmp_path: Path) -> None:
    data = (drives / "drive.mcap").read_bytes()
    cut = data[: len(data) * 6 // 10]
    ran = convert(tmp_path, {"cut.mcap": cut})
    assert ran.exit_code == 0, ran.log
    (made,) = ran.report.mission_files
    assert made.to == "derived/cut.mcap"
    whole = read_whole_mcap(ran.out / "cut.mcap")
    assert 0 < len(whole.messages) == ran.metric("messages", "cut.mcap")
    assert ran.codes() == {"convert.loss", "convert.lost_place"}
    (loss,) = (finding for finding in ran.report.findings if finding.code == "convert.loss")
    assert "messages can be read; lost:" in loss.message
    with pytest.raises(KeyError):  # how many are lost is unknown
        ran.metric("lost_messages", "cut.mcap")


def test_what_cannot_be_read_fails_and_the_rest_is_converted(drives: Path, tmp_path: Path) -> None:
    ran = convert(tmp_path, {"drive.bag": drives / "drive.bag", "noise.mcap": b"\x89MCAP0\r\n" + bytes(100)})
    assert ran.exit_code == 1
    assert "Traceback" not in ran.log
    assert ran.log.strip().splitlines()[-1] == "not converted: noise.mcap"
    assert [file.to for file in ran.report.mission_files] == ["derived/drive.mcap"]
    failures = [finding for finding in ran.report.findings if finding.code == "convert.failed"]
    assert [(finding.file, finding.message) for finding in failures] == [
        ("noise.mcap", "noise.mcap: nothing of it can be read")
    ]
    assert not (ran.out / "noise.mcap").exists()


def test_messages_are_re_encoded_if_requested(drives: Path, tmp_path: Path) -> None:
    """A bag for ROS 2; a second run over the result has nothing to do."""
    ran = convert(tmp_path, {"drive.bag": drives / "drive.bag"}, ros1="reencode")
    assert ran.exit_code == 0, ran.log
    assert not ran.report.findings
    whole = read_whole_mcap(ran.out / "drive.mcap")
    assert {channel.message_encoding for channel in whole.channels} == {"cdr"}
    assert ran.metric("messages", "drive.bag") == len(whole.messages)
    (tmp_path / "again" / "run").mkdir(parents=True)
    ran = convert(tmp_path / "again", {"drive.mcap": ran.out / "drive.mcap"}, ros1="reencode")
    assert ran.codes() == {"convert.unchanged"}


def test_an_mcap_becomes_a_bag(drives: Path, tmp_path: Path) -> None:
    ran = convert(tmp_path, {"drive.mcap": drives / "drive.mcap"}, to="bag", compression="bz2")
    assert ran.exit_code == 0, ran.log
    assert {file.to: file.derived_from for file in ran.report.mission_files} == {"derived/drive.bag": ["drive.mcap"]}
    with Recording.open(drives / "drive.mcap") as source, Recording.open(ran.out / "drive.bag") as made:
        assert [(one.topic, one.log_time_ns) for one in made.raw_messages()] == [
            (one.topic, one.log_time_ns) for one in source.raw_messages()
        ]
        assert {topic.message_encoding for topic in made.topics} == {"ros1"}


def test_messages_that_a_bag_cannot_store_are_findings(drives: Path, tmp_path: Path) -> None:
    out = BytesIO()
    writer = McapWriter(out, profile="ros2")
    for topic, definition in (("/a", "int8 data\n"), ("/wide", "wstring data\n")):
        name = f"my_msgs/msg/{topic[1:].title()}"
        channel = writer.add_channel(topic, writer.add_schema(name, "ros2msg", definition.encode()), "cdr")
        writer.add_message(channel, T0, b"\0\1\0\0" + bytes(1 if topic == "/a" else 4))
    writer.finish()
    ran = convert(tmp_path, {"a.mcap": out.getvalue()}, to="bag")
    assert ran.exit_code == 0, ran.log
    (finding,) = ran.report.findings
    assert (finding.code, finding.topic, finding.file) == ("convert.topic", "/wide", "a.mcap")
    assert finding.message.startswith("1 message left out: ")
    assert ran.metric("messages", "a.mcap") == 1


def test_topics_become_tables(drives: Path, tmp_path: Path) -> None:
    ran = convert(
        tmp_path, {"drive.bag": drives / "drive.bag"}, to="parquet", topics="/imu/data /odom", folder="tables"
    )
    assert ran.exit_code == 0, ran.log
    made = {file.to: file.derived_from for file in ran.report.mission_files}
    assert made == {
        "tables/drive/imu.data.parquet": ["drive.bag"],
        "tables/drive/odom.parquet": ["drive.bag"],
    }
    with Recording.open(drives / "drive.bag") as source:
        expected = source.to_arrow("/odom")
    table = as_arrow(ran.out / "drive/odom.parquet")
    assert table.equals(expected)
    assert ran.metric("messages", "drive.bag") > table.num_rows


@pytest.mark.parametrize(
    ("files", "parameters", "sentence"),
    [
        ({}, {}, "the mission has no recording that can be read (MCAP, ROS 1 bag, rosbag2)"),
        ({"notes.txt": b"x"}, {}, "the mission has no recording that can be read (MCAP, ROS 1 bag, rosbag2)"),
        (None, {"recordings": "nuc/*"}, "no recording is called nuc/*; there are drive.bag"),
        (None, {"compression": "lz4", "level": 20}, "level: lz4 has levels 0 to 16, not 20"),
        (None, {"compression": "bz2"}, "compression: an MCAP has zstd, lz4 or none, and no bz2"),
    ],
)
def test_nothing_to_convert(
    drives: Path,
    tmp_path: Path,
    files: dict[str, Path | bytes] | None,
    parameters: dict[str, str | int],
    sentence: str,
) -> None:
    ran = convert(tmp_path, {"drive.bag": drives / "drive.bag"} if files is None else files, **parameters)
    assert ran.exit_code == 1
    assert ran.log.strip() == sentence
    (finding,) = ran.report.findings
    assert (finding.code, finding.message) == ("convert.nothing", sentence)
    assert not ran.report.mission_files


def test_an_unknown_topic_names_those_that_there_are(drives: Path, tmp_path: Path) -> None:
    ran = convert(tmp_path, {"drive.bag": drives / "drive.bag"}, topics="/lidar2/*")
    assert ran.exit_code == 1
    (finding,) = ran.report.findings
    assert finding.message.startswith(
        "no recording has a topic /lidar2/*; there are /camera/image/compressed, /gps/fix"
    )
    assert not ran.report.mission_files


def test_recordings_without_the_topics_are_left_out(drives: Path, tmp_path: Path) -> None:
    other = mcap_of([[("/other", T0, b"x")]])
    files: dict[str, Path | bytes] = {
        "drive.bag": drives / "drive.bag",
        "other.mcap": other.read(0, other.size_bytes),
    }
    ran = convert(tmp_path, files, topics="/odom")
    assert ran.exit_code == 0, ran.log
    assert [file.to for file in ran.report.mission_files] == ["derived/drive.mcap"]
    (finding,) = ran.report.findings
    assert (finding.code, finding.file) == ("convert.unchanged", "other.mcap")
    assert finding.message == "left out: it has none of the topics"


def test_a_ulog_becomes_tables_only(recordings_dir: Path, tmp_path: Path) -> None:
    files: dict[str, Path | bytes] = {"flight.ulg": recordings_dir / "other/px4_sample.ulg"}
    ran = convert(tmp_path, files)
    assert ran.exit_code == 0, ran.log
    assert not ran.report.mission_files
    assert ran.codes() == {"convert.unchanged"}
    (tmp_path / "tables" / "run").mkdir(parents=True)
    ran = convert(tmp_path / "tables", files, to="parquet")
    assert ran.exit_code == 0, ran.log
    assert len(ran.report.mission_files) > 10


def test_names_of_results() -> None:
    names = ["a/run.bag", "a/run.mcap", "folder", ".", "x.mcap.zstd", "y.bag.active", "split.mcap"]
    assert list(target_names(names)) == ["a/run", "a/run-mcap", "folder", "recording", "x", "y", "split"]
