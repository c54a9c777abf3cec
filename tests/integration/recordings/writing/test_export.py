"""Exports of the recordings of a mission: one file a topic, by log time; they continue after an interruption."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kleinkram.recordings import (
    CannotWrite,
    ExportFormat,
    ExportOptions,
    ExportResult,
    NamedRecording,
    NoSuchTopic,
    OutsideRecording,
    Recording,
    export_recordings,
)
from kleinkram.recordings.sample import generate_bag, generate_db3, generate_mcap
from tests.recording_files.builders import T0
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.ros_messages import SECOND, TimedMessage, ros1_bag, ros2_mcap
from tests.recording_files.tables import json_mcap

MAX_MB = 200
REQUEST = ("to", "recordings", "sources", "source_bytes", "topics", "start_ns", "end_ns")


def imu(*numbers: int, topic: str = "/imu", values: dict[str, object] | None = None) -> list[TimedMessage]:
    return [TimedMessage(topic, "sensor_msgs/Imu", T0 + n, values or {}, T0 + n) for n in numbers]


def export(
    sources: dict[str, MemorySource | Path],
    folder: Path,
    to: ExportFormat = ExportFormat.parquet,
    options: ExportOptions | None = None,
    *,
    resume: bool = False,
) -> ExportResult:
    with ExitStack() as stack:
        opened = [NamedRecording(name, stack.enter_context(Recording.open(what))) for name, what in sources.items()]
        return export_recordings(opened, folder, to, options, resume=resume)


def rows(path: Path) -> list[tuple[int, str]]:
    table = pq.read_table(path)
    return [*zip(table["log_time"].cast(pa.int64()).to_pylist(), table["recording"].to_pylist(), strict=True)]


def test_recordings_are_merged_by_log_time(tmp_path: Path) -> None:
    sources: dict[str, MemorySource | Path] = {"a.mcap": ros2_mcap(imu(1, 3, 5, 9)), "b.mcap": ros2_mcap(imu(2, 3, 6))}
    result = export(sources, tmp_path / "out")
    assert [(t - T0, name[0]) for t, name in rows(tmp_path / "out" / "imu.parquet")] == [
        (1, "a"),
        (2, "b"),
        (3, "a"),
        (3, "b"),
        (5, "a"),
        (6, "b"),
        (9, "a"),
    ]
    (file,) = result.files
    assert (file.row_count, file.recordings) == (7, ("a.mcap", "b.mcap"))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["imu.parquet", "index.json"]


@settings(max_examples=40)
@given(st.lists(st.lists(st.integers(0, 60), max_size=12), min_size=1, max_size=5))
def test_any_recordings_are_merged_by_log_time(
    tmp_path_factory: pytest.TempPathFactory, parts: Sequence[Sequence[int]]
) -> None:
    folder = tmp_path_factory.mktemp("export") / "out"
    named = {f"{number}.mcap": sorted(times) for number, times in enumerate(parts) if times}
    if not named:
        return
    export({name: ros2_mcap(imu(*times), chunk_bytes=400) for name, times in named.items()}, folder)
    expected = sorted((T0 + time, name) for name, times in named.items() for time in times)
    assert rows(folder / "imu.parquet") == expected


def test_the_index_lists_files_topics_and_problems(tmp_path: Path) -> None:
    sources: dict[str, MemorySource | Path] = {
        "a.mcap": ros2_mcap(imu(1, 2, values={"header": {"frame_id": "base"}})),
        "b.mcap": json_mcap([{"x": 1}]),
    }
    export(sources, tmp_path / "out", options=ExportOptions(["/imu", "/st*"], start=T0))
    index = json.loads((tmp_path / "out" / "index.json").read_bytes())
    assert (index["to"], index["recordings"], index["topics"]) == ("parquet", ["a.mcap", "b.mcap"], ["/imu", "/st*"])
    assert (index["start_ns"], index["end_ns"]) == (T0, None)
    files = {file["topic"]: file for file in index["files"]}
    assert files["/imu"]["path"] == "imu.parquet"
    assert files["/imu"]["frame_id"] == "base"
    assert files["/imu"]["units"]["angular_velocity.x"] == "rad/s"
    assert files["/state"]["recordings"] == ["b.mcap"]
    assert files["/state"]["message_type"] == "State"
    assert (index["left_out"], index["problems"]) == ([], [])


def test_a_topic_of_several_types_has_several_files(tmp_path: Path) -> None:
    """ROS 1's header has a sequence number, which ROS 2's lacks; another type has other columns anyway."""
    odometry = [TimedMessage("/imu", "nav_msgs/Odometry", T0, {}, T0)]
    sources: dict[str, MemorySource | Path] = {
        "a.mcap": ros2_mcap(imu(1)),
        "b.bag": ros1_bag(imu(2)),
        "c.mcap": ros2_mcap(odometry),
        "d.mcap": ros2_mcap(imu(3)),
    }
    result = export(sources, tmp_path / "out")
    assert [(file.path.name, file.recordings) for file in result.files] == [
        ("imu.parquet", ("a.mcap", "d.mcap")),
        ("imu-2.parquet", ("b.bag",)),
        ("imu-3.parquet", ("c.mcap",)),
    ]


@pytest.mark.parametrize("to", [*ExportFormat])
def test_exports_of_several_formats_of_recordings(tmp_path: Path, to: ExportFormat) -> None:
    generate_mcap(tmp_path / "drive.mcap", duration_s=1, size_bytes=1_000_000)
    generate_bag(tmp_path / "drive.bag", duration_s=1, size_bytes=1_000_000)
    generate_db3(tmp_path / "drive", duration_s=1, size_bytes=1_000_000)
    sources: dict[str, MemorySource | Path] = {name: tmp_path / name for name in ("drive.mcap", "drive.bag", "drive")}
    result = export(sources, tmp_path / "out", to)
    counts = dict.fromkeys((file.topic for file in result.files), 0)
    for file in result.files:
        counts[file.topic] += file.row_count
    with Recording.open(tmp_path / "drive.mcap") as recording:
        expected = {topic.name: 3 * (topic.count or 0) for topic in recording.topics if topic.name in counts}
    assert counts == expected != {}


def test_a_folder_that_exists_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    for resume, reason in ((False, "there is such a file or folder"), (True, "there is no export in it")):
        with pytest.raises(CannotWrite, match=reason):
            export({"a": ros2_mcap(imu(1))}, tmp_path / "out", resume=resume)
    assert [*(tmp_path / "out").iterdir()] == []


def test_nothing_to_export_makes_no_folder(tmp_path: Path) -> None:
    source = ros2_mcap(imu(1))
    assert export({"a": source}, tmp_path / "out", ExportFormat.images).files == ()
    for options, error in (
        (ExportOptions("/nothing"), NoSuchTopic),
        (ExportOptions(start=T0 + SECOND), OutsideRecording),
    ):
        with pytest.raises(error):
            export({"a": source}, tmp_path / "out", options=options)
    assert not (tmp_path / "out").exists()


def test_an_export_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is full in the middle; complete files stay as they are, and the rest follows."""
    source = ros2_mcap([*imu(1), *imu(2, topic="/second"), *imu(3, topic="/third")])
    real = os.fsync
    calls = 0

    def full(descriptor: int) -> None:
        nonlocal calls
        calls += 1
        if calls > 5:
            raise OSError(28, "No space left on device")
        real(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(CannotWrite, match="No space left on device"):
            export({"a": source}, tmp_path / "out")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert ".export.jsonl" in names
    assert "imu.parquet" in names
    assert "index.json" not in names
    before = (tmp_path / "out" / "imu.parquet").stat().st_mtime_ns
    with pytest.raises(CannotWrite, match="other recordings or options"):
        export({"a": source}, tmp_path / "out", ExportFormat.csv, resume=True)
    with pytest.raises(CannotWrite, match="there is such a file or folder"):
        export({"a": source}, tmp_path / "out")
    result = export({"a": source}, tmp_path / "out", resume=True)
    assert [file.topic for file in result.files] == ["/imu", "/second", "/third"]
    assert (tmp_path / "out" / "imu.parquet").stat().st_mtime_ns == before
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *(file.path.name for file in result.files),
        "index.json",
    }
    assert export({"a": source}, tmp_path / "out", resume=True) == result, "a complete export is left alone"
    with pytest.raises(CannotWrite, match="other recordings or options"):
        export({"b": source}, tmp_path / "out", resume=True)
    with pytest.raises(CannotWrite, match="other recordings or options"):
        export({"a": ros2_mcap(imu(1, 2))}, tmp_path / "out", resume=True)


def test_a_cut_line_of_the_journal_is_ignored(tmp_path: Path) -> None:
    source = ros2_mcap([*imu(1), *imu(2, topic="/second")])
    export({"a": source}, tmp_path / "out")
    folder = tmp_path / "out"
    index = json.loads((folder / "index.json").read_bytes())
    request = {name: index[name] for name in REQUEST}
    first, second = index["files"]
    lines = [{"request": request}, {"file": first, "problems": []}, {"file": second, "problems": []}]
    (folder / "index.json").unlink()
    (folder / ".export.jsonl").write_text("\n".join(json.dumps(line) for line in lines)[:-10])
    result = export({"a": source}, folder, resume=True)
    assert [file.topic for file in result.files] == ["/imu", "/second"]


@pytest.mark.parametrize("text", ["no JSON\n", "[1]\n", '{"request": null}\n{"file": {}}\n'])
def test_a_journal_that_says_something_else_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".export.jsonl").write_text(text)
    with pytest.raises(CannotWrite, match=r"cannot be read|other recordings or options"):
        export({"a": ros2_mcap(imu(1))}, tmp_path / "out", resume=True)


def test_an_export_that_was_interrupted_at_its_very_start_or_end_continues(tmp_path: Path) -> None:
    """Before the journal has its first line, and after the index is written."""
    source, folder = ros2_mcap(imu(1)), tmp_path / "out"
    folder.mkdir()
    (folder / ".export.jsonl").write_text('{"request": {"to')
    result = export({"a": source}, folder, resume=True)
    index = json.loads((folder / "index.json").read_bytes())
    request = {name: index[name] for name in REQUEST}
    lines = [{"request": request}, {"file": index["files"][0], "problems": []}]
    (folder / ".export.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert export({"a": source}, folder, resume=True) == result
    assert sorted(path.name for path in folder.iterdir()) == ["imu.parquet", "index.json"]


_WRITE = r"""
import re, sys
from pathlib import Path
from kleinkram.recordings import ExportFormat, NamedRecording, Recording, export_recordings

source, target, to, limit = sys.argv[1:]

def show(share):
    if share > float(limit):
        print("far enough", flush=True)
        sys.stdin.read()

with Recording.open(source) as recording:
    export_recordings([NamedRecording("drive", recording)], target, ExportFormat(to), on_progress=show)
print(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1])
"""


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", _WRITE, *arguments]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("to", [ExportFormat.csv, ExportFormat.images])
def test_a_killed_export_continues(tmp_path: Path, to: ExportFormat) -> None:
    generate_mcap(tmp_path / "drive.mcap", size_bytes=8_000_000, duration_s=10)
    process = start(str(tmp_path / "drive.mcap"), str(tmp_path / "out"), to.value, "0.5")
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "far enough\n"
        with pytest.raises(CannotWrite, match="another process is writing it"):
            export({"drive": tmp_path / "drive.mcap"}, tmp_path / "out", to, resume=True)
        process.send_signal(signal.SIGKILL)
    continued = export({"drive": tmp_path / "drive.mcap"}, tmp_path / "out", to, resume=True)
    whole = export({"drive": tmp_path / "drive.mcap"}, tmp_path / "whole", to)
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")
    assert len(continued.files) == len(whole.files) > 0


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("to", [pytest.param(ExportFormat.csv, marks=pytest.mark.soak), ExportFormat.images])
def test_memory_is_bounded(tmp_path: Path, large_mcap: Path, to: ExportFormat) -> None:
    process = start(str(large_mcap), str(tmp_path / "out"), to.value, "2")
    output, errors = process.communicate(timeout=110)
    assert process.returncode == 0, errors
    assert int(output) / 1024 < MAX_MB


def test_damage_is_in_the_result(tmp_path: Path) -> None:
    generate_mcap(tmp_path / "drive.mcap", duration_s=3, size_bytes=6_000_000)
    data = bytearray((tmp_path / "drive.mcap").read_bytes())
    data[len(data) // 2 : len(data) // 2 + 200] = bytes(200)
    (tmp_path / "drive.mcap").write_bytes(data)
    result = export({"drive.mcap": tmp_path / "drive.mcap"}, tmp_path / "out")
    assert {problem.recording for problem in result.problems} == {"drive.mcap"}
    assert any(re.search("damaged", problem.code) for problem in result.problems)
