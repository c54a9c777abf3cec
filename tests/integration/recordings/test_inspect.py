"""`inspect_paths` and `combine`: several files as one recording."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest

from kleinkram.recordings import (
    Content,
    Depth,
    FileSource,
    Lost,
    NotARecording,
    Problem,
    Recording,
    RecordingFormat,
    RecordingSummary,
    TopicSummary,
    combine,
    summarise,
)
from kleinkram.recordings.inspect import InspectionKind, inspect_paths, to_plain
from kleinkram.recordings.sample import SampleFormat, generate_mission

T0 = 1_700_000_000_000_000_000


def member(first_ns: int, last_ns: int, count: int = 11, gap_ns: int = 10) -> RecordingSummary:
    topic = TopicSummary("/t", "a/B", "a/B", "ros2msg", "cdr", count, first_ns, last_ns, longest_gap_ns=gap_ns)
    topic = replace(topic, out_of_order_count=1, stored_bytes=100)
    return RecordingSummary(
        RecordingFormat.mcap,
        Content.indexed,
        message_count=count,
        start_ns=first_ns,
        end_ns=last_ns,
        compression=("zstd",),
        topics=(topic,),
    )


def test_silence_between_members_is_a_gap() -> None:
    whole = combine([member(T0, T0 + 100), member(T0 + 600, T0 + 700)])
    (topic,) = whole.topics
    assert (whole.start_ns, whole.end_ns, whole.message_count) == (T0, T0 + 700, 22)
    assert (topic.count, topic.longest_gap_ns, topic.out_of_order_count, topic.stored_bytes) == (22, 500, 2, 200)
    assert topic.rate_hz == pytest.approx(21 / 700e-9)


def test_members_may_come_in_any_order() -> None:
    one, two = member(T0, T0 + 100), member(T0 + 600, T0 + 700)
    assert combine([one, two]).topics == combine([two, one]).topics


def test_head_and_tail_gaps_are_those_of_the_combined_recording() -> None:
    other = TopicSummary("/u", "a/B", "a/B", "", "cdr", 1, T0 + 650, T0 + 650)
    second = member(T0 + 600, T0 + 700)
    whole = combine([member(T0, T0 + 100), replace(second, topics=(*second.topics, other), message_count=12)])
    assert [(t.name, t.head_gap_ns, t.tail_gap_ns) for t in whole.topics] == [("/t", 0, 0), ("/u", 650, 50)]


def test_a_member_whose_clock_was_never_set_does_not_stretch_the_span() -> None:
    whole = combine([member(5, 50, count=3), member(T0, T0 + 100)])
    assert (whole.start_ns, whole.end_ns, whole.message_count) == (T0, T0 + 100, 14)
    assert whole.topics[0].suspect_count == 3


def test_one_broken_member_leaves_the_others() -> None:
    broken = RecordingSummary(RecordingFormat.mcap, Content.broken, "cut")
    whole = combine([member(T0, T0 + 10), broken], ["a_0.mcap", "a_1.mcap"])
    assert (whole.content, whole.reason, whole.message_count) == (Content.recovered, "a_1.mcap: cut", 11)
    assert combine([broken, broken]).content is Content.broken


def test_an_unread_member_makes_the_sums_unknown() -> None:
    pending = RecordingSummary(RecordingFormat.rosbag2_db3, Content.pending, "not read")
    broken = RecordingSummary(RecordingFormat.mcap, Content.broken, "cut")
    whole = combine([member(T0, T0 + 10), broken, pending])
    assert (whole.content, whole.message_count) == (Content.pending, None)
    assert whole.reason == "not read (and 1 more files are incomplete)"


def test_a_clock_that_was_set_between_the_files_is_named() -> None:
    hour_ns = 3600 * 10**9
    first, back = member(T0, T0 + 60 * 10**9), member(T0 - hour_ns, T0 - hour_ns + 60 * 10**9)
    whole = combine([first, back], ["a_0.mcap", "a_1.mcap"])
    assert [(p.code, p.where) for p in whole.problems] == [("clock-jump", "a_1.mcap")]
    assert "3660.0 s" in whole.problems[0].message
    assert combine([back, first]).problems == ()
    overlapping = member(T0 + 55 * 10**9, T0 + 90 * 10**9)
    assert combine([first, overlapping]).problems == ()


def test_one_late_topic_is_no_clock_jump() -> None:
    """A buffer that is written late, beside topics that go on."""
    first, second = member(T0, T0 + 60 * 10**9), member(T0 + 60 * 10**9, T0 + 90 * 10**9)
    late = [TopicSummary("/late", "a/B", "a/B", "", "cdr", 5, T0 + at, T0 + at + 30 * 10**9) for at in (0, 10**9)]
    parts = [replace(one, topics=(*one.topics, topic)) for one, topic in zip((first, second), late, strict=True)]
    assert "clock-jump" not in [problem.code for problem in combine(parts).problems]


def test_recovered_recordings_always_report_what_is_lost() -> None:
    broken = RecordingSummary(RecordingFormat.mcap, Content.broken, "cut")
    assert combine([member(T0, T0 + 10), broken]).lost == Lost(0, 0, None)
    assert combine([broken, broken]).lost is None
    assert combine([member(T0, T0 + 5), member(T0 + 6, T0 + 9)]).lost is None


def test_losses_are_added() -> None:
    damaged = replace(member(T0, T0 + 10), content=Content.recovered, reason="cut", lost=Lost(100, 1, 5))
    other = replace(damaged, lost=Lost(50, 2, None))
    assert combine([member(T0, T0 + 5), damaged, damaged]).lost == Lost(200, 2, 10)
    assert combine([damaged, other]).lost == Lost(150, 3, None)


def test_a_type_that_changes_between_files_is_reported() -> None:
    one = member(T0, T0 + 10)
    other = replace(one, topics=(replace(one.topics[0], message_type="a/C"),))
    assert [(p.code, p.where) for p in combine([one, other]).problems] == [("topic-types-differ", "/t")]


def test_the_summary_of_a_single_member_is_unchanged() -> None:
    assert combine([member(T0, T0 + 10)]) == member(T0, T0 + 10)
    with pytest.raises(ValueError, match="at least one"):
        combine([])


def test_combined_splits_equal_the_unsplit_recording(recordings_dir: Path) -> None:
    folder = recordings_dir / "mcap/split_wbag"
    (actual,) = inspect_paths([folder])
    assert actual.kind is InspectionKind.recording
    assert actual.members == tuple(str(folder / f"wbag_{number}.mcap") for number in range(5))
    assert (actual.summary.message_count, actual.summary.content) == (6074, Content.indexed)
    assert (actual.summary.start_ns, actual.summary.end_ns) == (1000, 2998)
    assert sum(topic.count or 0 for topic in actual.summary.topics) == 6074


def test_a_folder_shows_each_recording_inside(tmp_path: Path) -> None:
    mission = generate_mission(tmp_path / "mission", duration_s=1, formats=[SampleFormat.mcap, SampleFormat.db3])
    (tmp_path / "mission/notes.txt").write_text("sunny")
    actual = inspect_paths([tmp_path / "mission", tmp_path / "mission/notes.txt"])
    assert [(Path(i.path).name, i.kind, i.summary.content) for i in actual] == [
        ("drive.mcap", InspectionKind.file, Content.indexed),
        ("drive_rosbag2", InspectionKind.recording, Content.indexed),
        ("notes.txt", InspectionKind.file, Content.opaque),
    ]
    with FileSource(mission.files[0].path) as source:
        assert actual[0].summary == summarise(source)


def test_a_topic_that_is_silent_in_one_file_causes_no_warning() -> None:
    """Each file of a split begins late for somebody; only the whole can say whether a sensor died."""
    unusual = Problem("stops-early", "/t", "its last message comes 60.0 s before the end of the recording")
    silent = Problem("silent-topic", "/t", "it is defined, but has no message")
    named = Problem("damaged", "byte 5", "its checksum is wrong")
    one, two = member(T0, T0 + 100), member(T0 + 200, T0 + 300)
    whole = combine([replace(one, problems=(unusual, named)), replace(two, problems=(silent,))])
    assert whole.problems == (named,)


def test_plain_inspections_have_the_documented_fields(tmp_path: Path) -> None:
    generate_mission(tmp_path, duration_s=1, formats=[SampleFormat.mcap])
    (plain,) = [to_plain(actual) for actual in inspect_paths([tmp_path / "drive.mcap"])]
    assert json.loads(json.dumps(plain)) == plain
    assert list(plain) == [
        "path", "kind", "members", "format", "content", "reason", "problems", "message_count", "start_ns", "end_ns",
        "compression", "topics", "depth", "lost", "facts",
    ]  # fmt: skip
    topics = plain["topics"]
    assert isinstance(topics, list)
    assert list(topics[0]) == [
        "name", "type", "message_encoding", "count", "first_ns", "last_ns", "rate_hz", "longest_gap_ns",
        "head_gap_ns", "tail_gap_ns", "out_of_order",
    ]  # fmt: skip


def test_a_path_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere"):
        inspect_paths([tmp_path, "/nowhere"])


def test_a_scan_reads_every_byte_and_reports_progress(tmp_path: Path) -> None:
    class Watched:
        def __init__(self) -> None:
            self.named: list[object] = []

        def began(self, path: str, size_bytes: int) -> None:
            self.named.append((path, size_bytes))

        def moved(self, size_bytes: int) -> None:
            self.named.append(size_bytes)

        def ended(self) -> None:
            self.named.append("ended")

    progress = Watched()
    generate_mission(tmp_path, duration_s=1, formats=[SampleFormat.mcap])
    path = tmp_path / "drive.mcap"
    (shallow,) = inspect_paths([path])
    (deep,) = inspect_paths([path], depth=Depth.scan, progress=progress)
    assert (shallow.summary.depth, deep.summary.depth) == (Depth.summary, Depth.scan)
    assert deep.summary.topics == shallow.summary.topics
    first, *moved, last = progress.named
    assert (first, last) == ((str(path), path.stat().st_size), "ended")
    assert sum(step for step in moved if isinstance(step, int)) == path.stat().st_size


def _write(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    generate_mission(path.parent, duration_s=1, formats=[SampleFormat.mcap]).files[0].path.rename(path)


def test_one_unreadable_file_or_folder_hides_no_other(tmp_path: Path) -> None:
    for number in (1, 3):
        _write(tmp_path / "day" / f"f{number}.mcap")
    (tmp_path / "day" / "f2.mcap").symlink_to(tmp_path / "nowhere.mcap")
    os.mkfifo(tmp_path / "day" / "pipe.bag")
    actual = {Path(item.path).name: item.summary for item in inspect_paths([tmp_path / "day"])}
    assert {name: summary.content for name, summary in actual.items()} == {
        "f1.mcap": Content.indexed,
        "f2.mcap": Content.error,
        "f3.mcap": Content.indexed,
        "pipe.bag": Content.error,
    }
    assert "f2.mcap" in (actual["f2.mcap"].reason or "")


def test_unreadable_files_are_named_and_hide_no_others(tmp_path: Path) -> None:
    for name in ("f1.mcap", "f2.mcap", "locked/f4.mcap", "f3.mcap"):
        _write(tmp_path / "day" / name)
    (tmp_path / "day" / "f2.mcap").chmod(0)
    (tmp_path / "day" / "locked").chmod(0)
    expected_names = {
        "f1.mcap": Content.indexed,
        "f2.mcap": Content.error,
        "f3.mcap": Content.indexed,
        "locked": Content.error,
    }
    for folder in (tmp_path, *tmp_path.parents):
        if any(parent.name.startswith("pytest-of-") for parent in (folder, *folder.parents)):
            folder.chmod(0o755)
    pid = os.fork()
    if pid == 0:
        status = 1
        try:
            if os.geteuid() == 0:  # who may read everything
                os.setresuid(65534, 65534, 65534)
            actual = {Path(item.path).name: item.summary.content for item in inspect_paths([tmp_path / "day"])}
            status = 0 if actual == expected_names else 1
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    (tmp_path / "day" / "locked").chmod(0o700)


def test_a_lone_metadata_file_gets_the_same_answer_everywhere(tmp_path: Path) -> None:
    folder = tmp_path / "patrol"
    folder.mkdir()
    text = "rosbag2_bagfile_information:\n  message_count: 5\n  relative_file_paths: [patrol_0.mcap]\n"
    (folder / "metadata.yaml").write_text(text)
    (one,), (other,) = inspect_paths([folder]), inspect_paths([folder / "metadata.yaml"])
    assert one.summary == other.summary
    assert one.summary.content is Content.broken
    for path in (folder, folder / "metadata.yaml"):
        with pytest.raises(NotARecording, match="names a data file with 5 messages, but none is there"):
            Recording.open(path)
    with FileSource(folder / "metadata.yaml") as source, pytest.raises(NotARecording, match="but none is there"):
        Recording.open(source)
