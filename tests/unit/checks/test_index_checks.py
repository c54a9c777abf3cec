"""Checks that read no message, each on data that pass and on data with the defect."""

from dataclasses import replace
from pathlib import PurePosixPath
from typing import Any

import pytest

from kleinkram.checks.document import ChecksDocument, ImageRule, Profile, TopicRule, read_checks
from kleinkram.checks.facts import MissionFacts
from kleinkram.checks.globs import matches
from kleinkram.checks.index_checks import check_index
from kleinkram.checks.outcomes import LEFT_OUT, MAX_MADE, size
from kleinkram.contract.checks import MAX_CHECKS, CheckStatus, Verdict
from kleinkram.recordings.model import Content, Problem
from tests.unit.checks.missions import (
    END_NS,
    SECOND,
    START_NS,
    evaluated,
    file_facts,
    mission_facts,
    only,
    recording_facts,
    rules,
    topic_facts,
)

EMPTY = MissionFacts((), (), ())


def _status(section: str, glob: str, rule: str, facts: MissionFacts, name: str) -> tuple[CheckStatus, str]:
    check = only(evaluated(rules(section, glob, rule), facts), name)
    return check.status, check.message


# -- files ------------------------------------------------------------------------------------------------------------


def test_a_file_that_must_be_there() -> None:
    facts = mission_facts()
    assert _status("files", "nuc/*.mcap", "{}", facts, "file.missing") == (CheckStatus.ok, "1 file matches nuc/*.mcap")
    status, message = _status("files", "jetson/*", "{}", facts, "file.missing")
    assert (status, message) == (CheckStatus.error, "no file matches jetson/*")
    status, _ = _status("files", "jetson/*", "{severity: warning}", facts, "file.missing")
    assert status is CheckStatus.warning
    status, message = _status("files", "jetson/*", "{required: false}", facts, "file.missing")
    assert (status, message) == (CheckStatus.ok, "no file matches jetson/*, and none is required")


def test_the_number_of_files() -> None:
    facts = mission_facts()
    assert _status("files", "*", "{count: 1}", facts, "file.count")[0] is CheckStatus.ok
    assert _status("files", "*", "{count: 4}", facts, "file.count") == (CheckStatus.error, "1 file; expected 4")
    assert _status("files", "*", "{count: {min: 2}}", facts, "file.count")[1] == "1 file; expected at least 2"
    assert _status("files", "*", "{count: {min: 2, max: 3}}", facts, "file.count")[1] == "1 file; expected 2 to 3"
    none = _status("files", "*.bag", "{required: false, count: {max: 0}}", facts, "file.count")
    assert none == (CheckStatus.ok, "0 files")


def test_files_of_recordings_are_complete() -> None:
    files = (
        file_facts("a.mcap"),
        file_facts("b.mcap", content=Content.recovered, reason="it has no index"),
        file_facts("c.mcap", content=Content.pending),
        file_facts("d.mcap", content=None),
        file_facts("e.txt", content=Content.opaque),
    )
    results = evaluated(rules("files", "*", "{complete: true}"), mission_facts(files=files))
    statuses = {check.file: check.status for check in results.checks if check.name == "file.incomplete"}
    assert statuses == {
        "b.mcap": CheckStatus.error,
        "c.mcap": CheckStatus.not_made,
        "d.mcap": CheckStatus.not_made,
    }
    good = evaluated(rules("files", "*", "{complete: true}"), mission_facts(files=(files[0], files[4])))
    assert only(good, "file.incomplete").message == "1 recording complete"


def test_the_size_of_each_file() -> None:
    files = (file_facts("a.mcap", size_bytes=999), file_facts("b.mcap"))
    check = only(evaluated(rules("files", "*", "{min_size: 1kB}"), mission_facts(files=files)), "file.size")
    assert (check.status, check.file, check.value, check.limit, check.unit) == (
        CheckStatus.error,
        "a.mcap",
        999,
        1000,
        "B",
    )
    assert check.message == "it has 999 B; expected at least 1 kB"
    good = only(evaluated(rules("files", "b*", "{min_size: 1kB}"), mission_facts(files=files)), "file.size")
    assert (good.status, good.value, good.message) == (CheckStatus.ok, 50_000_000, "the smallest has 50 MB")
    close = only(evaluated(rules("files", "b*", "{min_size: 50000001}"), mission_facts(files=files)), "file.size")
    assert close.message == "it has 50 MB; expected at least 50.000001 MB"


@pytest.mark.parametrize(
    ("size_bytes", "text"),
    [
        (0, "0 B"),
        (999, "999 B"),
        (999_499, "999 kB"),
        (999_600, "1 MB"),
        (1_234_567_890, "1.23 GB"),
        (10**15, "1000 TB"),
    ],
)
def test_sizes_are_written_with_the_unit_that_suits_them(size_bytes: int, text: str) -> None:
    assert size(size_bytes) == text


# -- recordings -------------------------------------------------------------------------------------------------------


def test_a_computer_whose_recording_is_missing() -> None:
    facts = mission_facts()
    assert _status("recordings", "nuc/*", "{}", facts, "recording.missing")[0] is CheckStatus.ok
    status, message = _status("recordings", "jetson/*", "{}", facts, "recording.missing")
    assert (status, message) == (CheckStatus.error, "no recording matches jetson/*; there is nuc/drive.mcap")
    assert _status("recordings", "*", "{count: 4}", facts, "recording.count")[1] == "1 recording; expected 4"


def test_folders_above_that_of_the_computer_do_not_matter() -> None:
    name, path = "day1/run2/nuc", "day1/run2/nuc/nuc_0.mcap"  # a rosbag2 folder
    facts = mission_facts(
        topic_facts(recordings=(name,)), recordings=(recording_facts(name, paths=(path,)),), files=(file_facts(path),)
    )
    assert _status("recordings", "nuc/*", "{}", facts, "recording.missing")[0] is CheckStatus.ok
    assert _status("files", "nuc/*.mcap", "{}", facts, "file.missing")[0] is CheckStatus.ok
    assert _status("topics", "/imu/data", "{recording: nuc/*}", facts, "topic.missing")[0] is CheckStatus.ok
    assert _status("recordings", "uc/*", "{}", facts, "recording.missing")[0] is CheckStatus.error
    assert _status("files", "/nuc/*.mcap", "{}", facts, "file.missing")[0] is CheckStatus.error
    assert _status("files", "/day1/*.mcap", "{}", facts, "file.missing")[0] is CheckStatus.ok


@pytest.mark.parametrize(
    ("content", "status"),
    [
        (Content.indexed, CheckStatus.ok),
        (Content.recovered, CheckStatus.error),
        (Content.broken, CheckStatus.error),
        (Content.opaque, CheckStatus.error),
        (Content.pending, CheckStatus.not_made),
        (Content.error, CheckStatus.not_made),
    ],
)
def test_a_recording_is_complete(content: Content, status: CheckStatus) -> None:
    reason = None if content is Content.indexed else "the file ends in the middle"
    facts = mission_facts(recordings=(recording_facts(content=content, reason=reason),))
    check = only(evaluated(rules("recordings", "*"), facts), "recording.incomplete")
    assert check.status is status
    assert check.message == (reason or "complete")
    assert check.file == "nuc/drive.mcap"


@pytest.mark.parametrize("content", [one for one in Content if one is not Content.indexed])
def test_a_recording_that_is_not_complete_is_never_good(content: Content) -> None:
    file = file_facts(content=content, reason="it ends in the middle")
    facts = mission_facts(recordings=(recording_facts(content=content, reason=file.reason),), files=(file,))
    for document in (rules("topics"), rules("files", "*"), rules("recordings", "opc/*", "{required: false}")):
        results = evaluated(document, facts)
        check = only(results, "recording.incomplete")
        row = (check.status, check.file, check.message)
        assert row == (CheckStatus.not_made, "nuc/drive.mcap", "it ends in the middle")
        assert results.verdict is Verdict.warnings


def test_a_recording_that_a_rule_reports_or_allows_has_no_second_row() -> None:
    file = file_facts(content=Content.broken)
    facts = mission_facts(recordings=(recording_facts(content=Content.broken),), files=(file,))
    assert only(evaluated(rules("recordings", "*"), facts), "recording.incomplete").status is CheckStatus.error
    by_file = evaluated(rules("files", "*", "{complete: true, severity: warning}"), facts)
    assert [check.name for check in by_file.checks if check.status is not CheckStatus.ok] == ["file.incomplete"]
    for section in ("recordings", "files"):
        allowed = evaluated(rules(section, "nuc/*", "{complete: false}"), facts)
        assert (allowed.verdict, "recording.incomplete" in {check.name for check in allowed.checks}) == (
            Verdict.good,
            False,
        )


def test_only_profiles_that_apply_doubt_a_recording() -> None:
    facts = mission_facts(recordings=(recording_facts(content=Content.broken),))
    document = read_checks("version: 1\nprofiles:\n- {when: {robot: spot}, topics: {/imu/data: {}}}\n")
    assert evaluated(document, facts).checks == ()
    healthy = evaluated(rules("topics"), mission_facts())
    assert (healthy.verdict, {check.name for check in healthy.checks}) == (Verdict.good, {"topic.missing"})


@pytest.mark.parametrize(
    ("rule", "name", "start_s", "end_s", "status", "message"),
    [
        ("covers: 90%", "recording.coverage", 0, 60, CheckStatus.ok, "it covers 100% of the mission"),
        (
            "covers: 90%",
            "recording.coverage",
            20,
            50,
            CheckStatus.error,
            "it covers 50% of the mission; expected at least 90%",
        ),
        ("max_start_skew: 2s", "recording.start_skew", 1, 60, CheckStatus.ok, "it starts 1 s after the mission"),
        (
            "max_start_skew: 2s",
            "recording.start_skew",
            2.5,
            60,
            CheckStatus.error,
            "it starts 2.5 s after the mission; allowed are 2 s",
        ),
        (
            "max_start_skew: 2s",
            "recording.start_skew",
            -1_700_000_000,
            -1_699_999_900,
            CheckStatus.error,
            "it starts 53.9 years before the mission: its clock is off; allowed are 2 s",
        ),
        (
            "max_end_skew: 500ms",
            "recording.end_skew",
            0,
            57,
            CheckStatus.error,
            "it ends 3 s before the mission; allowed are 500 ms",
        ),
    ],
)
def test_when_a_recording_runs(
    rule: str, name: str, start_s: float, end_s: float, status: CheckStatus, message: str
) -> None:
    times = {"start_ns": START_NS + int(start_s * SECOND), "end_ns": START_NS + int(end_s * SECOND)}
    facts = mission_facts(recordings=(recording_facts(), recording_facts("opc/drive.mcap", **times)))
    assert _status("recordings", "opc/*", f"{{{rule}}}", facts, name) == (status, message)


def test_the_span_of_a_recording_without_messages_cannot_be_checked() -> None:
    facts = mission_facts(recordings=(recording_facts(), recording_facts("opc/a.mcap", start_ns=None, end_ns=None)))
    status, message = _status("recordings", "opc/*", "{covers: 90%}", facts, "recording.coverage")
    assert (status, message) == (CheckStatus.not_made, "it has no messages")


# -- topics -----------------------------------------------------------------------------------------------------------


def test_a_topic_that_must_be_there() -> None:
    facts = mission_facts(topic_facts(), topic_facts("/camera/front", count=0, recordings=()))
    assert _status("topics", "/imu/data", "{}", facts, "topic.missing") == (CheckStatus.ok, "12001 messages")
    assert _status("topics", "/imu/*", "{}", facts, "topic.missing")[1] == "1 topic matches /imu/*"
    missing = _status("topics", "/gnss", "{}", facts, "topic.missing")
    assert missing == (CheckStatus.error, "it is not recorded")
    assert _status("topics", "/gnss/*", "{}", facts, "topic.missing")[1] == "no topic matches /gnss/*"
    silent = _status("topics", "/camera/front", "{}", facts, "topic.missing")
    assert silent == (CheckStatus.error, "it is defined, but has no message")
    optional = _status("topics", "/gnss", "{required: false}", facts, "topic.missing")
    assert optional == (CheckStatus.ok, "no topic matches /gnss, and none is required")


def test_a_topic_is_in_the_recording_of_its_computer() -> None:
    facts = mission_facts()
    assert _status("topics", "/imu/data", "{recording: nuc/*}", facts, "topic.missing")[0] is CheckStatus.ok
    status, message = _status("topics", "/imu/data", "{recording: jetson/*}", facts, "topic.missing")
    assert status is CheckStatus.error
    assert message == "it is in nuc/drive.mcap, but in no recording that matches jetson/*"


@pytest.mark.parametrize("expected", ["sensor_msgs/Imu", "sensor_msgs/msg/Imu"])
def test_types_of_ros_1_and_ros_2_are_equal(expected: str) -> None:
    for recorded in ("sensor_msgs/Imu", "sensor_msgs/msg/Imu"):
        facts = mission_facts(topic_facts(message_type=recorded))
        assert _status("topics", "/imu/data", f"{{type: {expected}}}", facts, "topic.type")[0] is CheckStatus.ok


def test_another_type() -> None:
    facts = mission_facts(topic_facts(message_type="std_msgs/msg/String"))
    status, message = _status("topics", "/imu/data", "{type: sensor_msgs/Imu}", facts, "topic.type")
    assert (status, message) == (CheckStatus.error, "its type is std_msgs/msg/String; expected sensor_msgs/Imu")
    facts = mission_facts(topic_facts(message_type=None))
    assert _status("topics", "/imu/data", "{type: sensor_msgs/Imu}", facts, "topic.type")[0] is CheckStatus.not_made


@pytest.mark.parametrize(
    ("rate_hz", "status"),
    [
        (200.0, CheckStatus.ok),
        (180.0, CheckStatus.ok),
        (220.0, CheckStatus.ok),
        (179.9, CheckStatus.error),
        (220.1, CheckStatus.error),
        (100.0, CheckStatus.error),
        (None, CheckStatus.not_made),
    ],
)
def test_the_rate_within_its_tolerance(rate_hz: float | None, status: CheckStatus) -> None:
    facts = mission_facts(topic_facts(rate_hz=rate_hz))
    check = only(evaluated(rules("topics", rule="{rate: 200}"), facts), "topic.rate")
    assert check.status is status
    assert (check.value, check.unit) == (rate_hz, "Hz" if rate_hz else None)
    assert "expected 200 Hz ± 10%" in check.message


@pytest.mark.parametrize(("count", "what"), [(0, "no message"), (1, "1 message")])
def test_a_rate_needs_two_messages(count: int, what: str) -> None:
    facts = mission_facts(topic_facts(), topic_facts("/imu/b", count=count, rate_hz=None, longest_gap_ns=None))
    results = evaluated(rules("topics", "/imu/*", "{rate: 200}"), facts)
    check = next(one for one in results.checks if one.topic == "/imu/b")
    assert (check.status, check.message) == (CheckStatus.error, f"{what}; expected 200 Hz ± 10%")


def test_the_longest_gap() -> None:
    facts = mission_facts(topic_facts(longest_gap_ns=2_130_000_000))
    check = only(evaluated(rules("topics", rule="{max_gap: 50ms}"), facts), "topic.gap")
    assert check.message == "longest gap 2.13 s; allowed are 50 ms"
    assert (check.status, check.value, check.limit, check.unit) == (CheckStatus.error, 2.13, 0.05, "s")
    assert _status("topics", "/imu/data", "{max_gap: 3s}", facts, "topic.gap")[0] is CheckStatus.ok


def test_a_gap_just_over_the_limit_is_written_with_enough_digits() -> None:
    facts = mission_facts(topic_facts(longest_gap_ns=50_000_001))
    message = only(evaluated(rules("topics", rule="{max_gap: 50ms}"), facts), "topic.gap").message
    assert message == "longest gap 50.000001 ms; allowed are 50 ms"


def test_one_message_makes_no_gap() -> None:
    facts = mission_facts(topic_facts(count=1, longest_gap_ns=None))
    status, message = _status("topics", "/imu/data", "{max_gap: 50ms}", facts, "topic.gap")
    assert (status, message) == (CheckStatus.not_made, "1 message, which makes no gap")


def test_a_gap_that_is_only_an_upper_bound_is_no_failure() -> None:
    problem = Problem("gaps-upper-bound", "/imu/data", "too far out of order")
    facts = mission_facts(topic_facts(longest_gap_ns=SECOND), recordings=(recording_facts(problems=(problem,)),))
    status, message = _status("topics", "/imu/data", "{max_gap: 50ms}", facts, "topic.gap")
    assert status is CheckStatus.not_made
    assert "only an upper bound" in message
    assert _status("topics", "/imu/data", "{max_gap: 2s}", facts, "topic.gap")[0] is CheckStatus.ok


@pytest.mark.parametrize(
    ("rule", "name", "message"),
    [
        ("covers: 90%", "topic.coverage", "its messages cover 50% of the mission; expected at least 90%"),
        (
            "max_silence_at_start: 1s",
            "topic.silent_start",
            "first message 10 s after the start of the mission; allowed are 1 s",
        ),
        (
            "max_silence_at_end: 1s",
            "topic.silent_end",
            "last message 20 s before the end of the mission; allowed are 1 s",
        ),
    ],
)
def test_silence_at_the_start_and_at_the_end(rule: str, name: str, message: str) -> None:
    late = mission_facts(topic_facts(first_ns=START_NS + 10 * SECOND, last_ns=END_NS - 20 * SECOND))
    assert _status("topics", "/imu/data", f"{{{rule}}}", late, name) == (CheckStatus.error, message)
    assert _status("topics", "/imu/data", f"{{{rule}}}", mission_facts(), name)[0] is CheckStatus.ok
    unplaced = mission_facts(topic_facts(first_ns=None, last_ns=None))
    assert _status("topics", "/imu/data", f"{{{rule}}}", unplaced, name)[0] is CheckStatus.not_made


def test_the_number_of_messages() -> None:
    facts = mission_facts()
    assert _status("topics", "/imu/data", "{count: {min: 100}}", facts, "topic.count")[0] is CheckStatus.ok
    status, message = _status("topics", "/imu/data", "{count: {min: 20000}}", facts, "topic.count")
    assert (status, message) == (CheckStatus.error, "12001 messages; expected at least 20000")
    unknown = mission_facts(topic_facts(count=None))
    assert _status("topics", "/imu/data", "{count: {min: 1}}", unknown, "topic.count")[0] is CheckStatus.not_made


def test_each_of_several_topics_has_a_row() -> None:
    cameras = [topic_facts(f"/camera/{number}", rate_hz=10.0 if number != 3 else 4.0) for number in range(12)]
    results = evaluated(rules("topics", "/camera/*", "{rate: 10}"), mission_facts(*cameras))
    rates = [check for check in results.checks if check.name == "topic.rate"]
    assert len(rates) == 12
    assert [check.topic for check in rates if check.status is CheckStatus.error] == ["/camera/3"]
    assert results.verdict is Verdict.bad


def test_topics_that_are_not_required_may_be_silent() -> None:
    facts = mission_facts(topic_facts("/camera/front", count=0, rate_hz=None, recordings=()))
    results = evaluated(rules("topics", "/camera/*", "{required: false, rate: 10, max_gap: 1s}"), facts)
    assert [check.name for check in results.checks] == ["topic.missing"]
    assert results.verdict is Verdict.good


# -- what is not known ------------------------------------------------------------------------------------------------


def test_what_a_file_that_was_not_read_may_contain_is_not_reported_as_missing() -> None:
    unread = recording_facts("opc/drive.bag", content=Content.pending, start_ns=None, end_ns=None)
    facts = mission_facts(recordings=(recording_facts(), unread))
    status, message = _status("topics", "/gnss", "{}", facts, "topic.missing")
    assert (status, message) == (CheckStatus.not_made, "it is not recorded, but opc/drive.bag was not read")
    status, _ = _status("topics", "/imu/data", "{count: {min: 20000}}", facts, "topic.count")
    assert status is CheckStatus.not_made
    status, _ = _status("topics", "/imu/data", "{count: {max: 20000}}", facts, "topic.count")
    assert status is CheckStatus.not_made, "the file that was not read may have more"
    status, _ = _status("topics", "/imu/data", "{count: {min: 100}}", facts, "topic.count")
    assert status is CheckStatus.ok
    status, _ = _status("topics", "/imu/data", "{covers: 90%}", facts, "topic.coverage")
    assert status is CheckStatus.not_made, "the mission may be longer"


@pytest.mark.parametrize(("rate_hz", "gap_ns"), [(150.0, 2 * SECOND), (200.0, 5_000_000)])
def test_times_of_a_clock_that_was_set_are_not_judged(rate_hz: float, gap_ns: int) -> None:
    problem = Problem("clock-jump", "/imu/data", "log times jump back by 2.0 s")
    facts = mission_facts(
        topic_facts(longest_gap_ns=gap_ns, rate_hz=rate_hz), recordings=(recording_facts(problems=(problem,)),)
    )
    results = evaluated(rules("topics", rule="{rate: 200, max_gap: 50ms, covers: 10%}"), facts)
    assert results.verdict is Verdict.warnings
    for name in ("topic.gap", "topic.rate", "topic.coverage"):
        check = only(results, name)
        assert check.status is CheckStatus.not_made
        assert check.message.endswith("but the clock was set while nuc/drive.mcap was recorded")
    rule = "{covers: 10%, max_start_skew: 1s, max_end_skew: 1s}"
    of_recording = evaluated(rules("recordings", "nuc/*", rule), facts)
    for name in ("recording.coverage", "recording.start_skew", "recording.end_skew"):
        assert only(of_recording, name).status is CheckStatus.not_made


def test_a_mission_without_recordings_lacks_everything() -> None:
    text = """
version: 1
profiles:
- files: {"*.mcap": {}}
  recordings: {"nuc/*": {covers: 90%}}
  topics: {/imu/data: {rate: 200}}
  clocks: {"*": {no_jump: true}}
  images: {"/camera/*": {}}
"""
    results = evaluated(read_checks(text), EMPTY)
    assert results.verdict is Verdict.bad
    failing = {check.name for check in results.checks if check.status is CheckStatus.error}
    assert failing == {"file.missing", "recording.missing", "topic.missing"}
    assert only(results, "clock.jump").status is CheckStatus.not_made


def test_recordings_without_messages() -> None:
    facts = replace(EMPTY, recordings=(recording_facts(start_ns=None, end_ns=None),), files=(file_facts(),))
    results = evaluated(rules("recordings", "*", "{covers: 90%, max_start_skew: 1s}"), facts)
    assert only(results, "recording.coverage").status is CheckStatus.not_made
    assert only(results, "recording.start_skew").message == "it has no messages"


# -- clocks -----------------------------------------------------------------------------------------------------------


def _jump(where: str) -> MissionFacts:
    problem = Problem("clock-jump", where, "log times jump back by 2.0 s at 2023-11-14T22:13:20Z")
    return mission_facts(topic_facts(), topic_facts("/odom"), recordings=(recording_facts(problems=(problem,)),))


def test_a_clock_that_jumps_back() -> None:
    for where in ("/imu/data", "12 topics", "drive_1.mcap"):
        check = only(evaluated(rules("clocks", "/imu/*", "{no_jump: true}"), _jump(where)), "clock.jump")
        assert (check.status, check.file) == (CheckStatus.error, "nuc/drive.mcap")
        assert check.message.startswith(f"{where}: log times jump back by 2.0 s")


def test_a_jump_of_another_topic_is_not_of_this_rule() -> None:
    check = only(evaluated(rules("clocks", "/imu/*", "{no_jump: true}"), _jump("/odom")), "clock.jump")
    assert (check.status, check.message) == (CheckStatus.ok, "log times do not jump back")


def test_a_clock_rule_that_matches_no_topic() -> None:
    check = only(evaluated(rules("clocks", "/gnss", "{no_jump: true}"), mission_facts()), "clock.jump")
    assert (check.status, check.message) == (CheckStatus.not_made, "no topic with messages matches /gnss")


# -- checks of the content --------------------------------------------------------------------------------------------


def test_nothing_is_good_while_checks_of_the_content_are_to_be_made() -> None:
    text = """
version: 1
profiles:
- topics: {/imu/data: {}}
  imu: {"/imu/*": {up: z, max_acceleration: 160}}
  clocks: {"/imu/*": {max_stamp_offset: 10ms}}
"""
    results = evaluated(read_checks(text), mission_facts())
    names = {check.name for check in results.checks if check.status is CheckStatus.needs_content}
    assert names == {"imu.gravity", "imu.tilt", "imu.saturated", "imu.constant", "clock.stamp_offset"}
    assert results.verdict is Verdict.unchecked
    assert results.counts[CheckStatus.needs_content] == 5


def test_a_missing_topic_is_reported_once_and_not_by_each_check_that_needs_it() -> None:
    text = """
version: 1
profiles:
- topics: {/camera: {}, "/imu/*": {}, /odd: {required: false}}
- name: content
  images: {/camera: {}, "/other/*": {}}
  imu: {"/imu/*": {}}
  values: {/odd: {fields: ["*"]}}
  clocks: {/camera: {no_jump: true}}
"""
    results = evaluated(read_checks(text), mission_facts())
    listed = {(check.name, check.topic) for check in results.checks if check.topic in ("/camera", "/other/*", "/odd")}
    assert ("topic.missing", "/camera") in listed
    assert not [name for name, topic in listed if topic == "/camera" and name != "topic.missing"]
    assert ("image.black", "/other/*") in listed, "nothing else says that no topic matches"
    assert ("value.nan", "/odd") not in listed, "it may be missing"
    assert results.verdict is Verdict.bad


def test_checks_of_the_content_alone_leave_a_mission_unchecked() -> None:
    assert evaluated(rules("imu", "/imu/*"), mission_facts()).verdict is Verdict.unchecked


def test_a_rule_of_the_content_that_matches_no_topic_is_known_from_the_index() -> None:
    results = evaluated(rules("images", "/camera/*"), mission_facts())
    assert {check.status for check in results.checks} == {CheckStatus.not_made}
    assert {check.message for check in results.checks} == {"no topic matches /camera/*"}
    assert results.verdict is Verdict.warnings


# -- names from strangers, many rows ----------------------------------------------------------------------------------


def test_names_that_cannot_be_stored_do_not_end_the_checks() -> None:
    names = ["/a\x00b", "/\ud800", "/" + "x" * 5000, "", "/line\nbreak"]
    facts = mission_facts(
        *(topic_facts(name, rate_hz=1.0, message_type="\x00" * 5000) for name in names),
        recordings=(recording_facts("../up"), recording_facts(".")),
        files=(file_facts("/absolute"),),
    )
    text = (
        'version: 1\nprofiles:\n- topics: {"*": {rate: 200, type: a/B}}\n  recordings: {"*": {}}\n  files: {"*": {}}\n'
    )
    results = evaluated(read_checks(text), facts)
    assert len([check for check in results.checks if check.name == "topic.rate"]) == len(names)
    assert all(check.file is None or not PurePosixPath(check.file).is_absolute() for check in results.checks)


def _many(rate_of: Any) -> MissionFacts:
    return mission_facts(*(topic_facts(f"/t{number}", rate_hz=rate_of(number)) for number in range(MAX_CHECKS + 10)))


def test_many_checks_are_bounded_and_the_failing_ones_come_first() -> None:
    results = evaluated(
        rules("topics", "*", "{rate: 200}"), _many(lambda number: 1.0 if number == MAX_CHECKS else 200.0)
    )
    assert len(results.checks) == MAX_CHECKS
    assert results.checks[0].topic == f"/t{MAX_CHECKS}"
    assert (results.checks[-1].name, results.checks[-1].status) == ("checks.left_out", CheckStatus.ok)
    assert results.checks[-1].message == "12 more checks are not listed"
    assert results.counts[CheckStatus.error] == 1


def test_more_failing_checks_than_are_listed() -> None:
    results = evaluated(rules("topics", "*", "{rate: 200}"), _many(lambda number: 1.0))
    assert results.checks[-1].status is CheckStatus.not_made
    assert results.counts[CheckStatus.error] == MAX_CHECKS + 10
    assert results.verdict is Verdict.bad


def test_the_same_check_of_two_profiles_is_one_row() -> None:
    profile = "- {{name: {}, topics: {{/imu/data: {{rate: 200}}}}}}\n"
    text = f"version: 1\nprofiles:\n{profile.format('a')}{profile.format('b')}"
    document = read_checks(text)
    assert [check.name for check in check_index(document.profiles, mission_facts())] == ["topic.missing", "topic.rate"]


def test_rules_that_ask_for_very_many_checks_are_not_made_to_the_end() -> None:
    topics = [topic_facts(f"/t{number}") for number in range(1000)]
    profiles = "\n".join(
        f"- {{name: p{number}, topics: {{'*': [{', '.join(['{rate: 200}'] * 20)}]}}}}" for number in range(20)
    )
    results = evaluated(read_checks(f"version: 1\nprofiles:\n{profiles}\n"), mission_facts(*topics))
    assert results.verdict is Verdict.warnings
    assert results.checks[0].name == LEFT_OUT
    assert f"more than {MAX_MADE:,}" in results.checks[0].message


def test_globs_are_compared_up_to_a_number_of_steps_and_a_row_says_so() -> None:
    topics = [topic_facts(f"/robot/sensor_{number}/image") for number in range(2000)]
    globs = {f"*s*n*o*{number}*m*{number}*": [TopicRule(required=False)] for number in range(999)}
    document = ChecksDocument(version=1, profiles=[Profile(topics={"/robot/sensor_1/image": [TopicRule()], **globs})])
    results = evaluated(document, mission_facts(*topics))
    assert results.verdict is Verdict.warnings
    made, left_out = [check for check in results.checks if check.name != LEFT_OUT], only(results, LEFT_OUT)
    assert left_out.status is CheckStatus.not_made
    assert "too many names" in left_out.message
    assert made[0].topic == "/robot/sensor_1/image"
    assert 500 < len(made) < 1000

    shorter = ChecksDocument(version=1, profiles=[Profile(topics=dict([*globs.items()][:500]))])
    assert len(evaluated(shorter, mission_facts(*topics)).checks) == 500


def test_globs_for_content_are_compared_up_to_a_number_of_steps() -> None:
    topics = [topic_facts(f"/robot/sensor_{number}/image") for number in range(2000)]
    globs = {f"*s*n*o*{number}*m*{number}*": [ImageRule()] for number in range(1000)}
    document = ChecksDocument(version=1, profiles=[Profile(topics={"*/image": [TopicRule()]}, images=globs)])
    results = evaluated(document, mission_facts(*topics))
    assert "too many names" in only(results, LEFT_OUT).message
    assert only(results, "topic.missing").status is CheckStatus.ok


@pytest.mark.parametrize(
    ("glob", "name", "does_match"),
    [
        ("/a/**/b", "/a/x/y/b", True),
        ("/a/***", "/a/", True),
        ("*a" * 16, "/" + "a" * 1000, True),
        ("*a" * 16 + "b", "a" * 1000, False),
        ("*" + "a" * 500 + "b", "a" * 1000, False),
        ("*[ab]*?c", "xbyc", True),
    ],
)
def test_long_globs_and_names_are_compared(glob: str, name: str, does_match: bool) -> None:
    assert matches(name, glob) is does_match


# -- profiles ---------------------------------------------------------------------------------------------------------

PROFILES = """
version: 1
profiles:
- name: all robots
  topics: {/imu/data: {rate: 200}}
- name: night
  when: {night: true}
  topics: {/camera/*: {}}
- name: spot
  when: {robot: [spot, spot-*]}
  topics: {/spot/status: {}}
"""


def test_profiles_that_do_not_apply_are_named_with_the_reason() -> None:
    results = evaluated(read_checks(PROFILES), mission_facts(metadata={"robot": "anymal"}))
    assert results.profiles_applied == ("all robots",)
    assert [(profile.name, profile.reason) for profile in results.profiles_left_out] == [
        ("night", "night is not set; it must be true"),
        ("spot", "robot is anymal; it must be spot or spot-*"),
    ]
    assert results.verdict is Verdict.good


def test_several_profiles_apply() -> None:
    results = evaluated(read_checks(PROFILES), mission_facts(metadata={"robot": "spot-2", "night": True}))
    assert results.profiles_applied == ("all robots", "night", "spot")
    assert {check.topic for check in results.checks if check.status is CheckStatus.error} == {
        "/camera/*",
        "/spot/status",
    }


def test_without_a_profile_that_applies_the_mission_is_unchecked() -> None:
    document = read_checks("version: 1\nprofiles:\n- when: {robot: spot}\n  topics: {/imu/data: {}}\n")
    results = evaluated(document, mission_facts())
    assert (results.verdict, results.checks) == (Verdict.unchecked, ())


def test_a_rule_about_messages_of_an_optional_topic_that_is_missing_is_left_out() -> None:
    content = "images: {/cam: {}, '/cam/*': {}}\n  clocks: {/cam: {no_jump: true, max_stamp_offset: 1s}}\n"
    optional = f"version: 1\nprofiles:\n- {content}  topics: {{/cam: {{required: false}}}}\n"
    results = evaluated(read_checks(optional), mission_facts())
    assert {check.topic for check in results.checks if check.status is CheckStatus.not_made} == {"/cam/*"}
    assert only(results, "topic.missing").status is CheckStatus.ok
    another = f"version: 1\nprofiles:\n- {content}- {{name: b, topics: {{/cam: {{required: false}}}}}}\n"
    assert "/cam" not in {
        check.topic for check in evaluated(read_checks(another), mission_facts()).checks if check.status != "ok"
    }
    there = evaluated(read_checks(optional), mission_facts(topic_facts("/cam", message_type="sensor_msgs/Image")))
    assert CheckStatus.needs_content in {check.status for check in there.checks if check.topic == "/cam"}
