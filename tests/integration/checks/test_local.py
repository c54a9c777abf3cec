"""Local files as a mission: the facts that its checks are made from."""

import os
from pathlib import Path
from typing import Any

import pytest

from kleinkram.checks.document import ChecksDocument, read_checks
from kleinkram.checks.facts import MissionFacts, TopicFacts
from kleinkram.checks.local import LocalMission, read_mission
from kleinkram.checks.results import evaluate, evaluate_index
from kleinkram.checks.suggest import measure_up_axes, suggest_checks
from kleinkram.contract.checks import CheckDepth, CheckStatus, Verdict
from kleinkram.recordings import Content
from kleinkram.recordings.sample import Defect, Faults, SampleFormat, generate_mission, generate_rig
from tests.recording_files.builders import T0, mcap_of

pytestmark = pytest.mark.usefixtures("remembered_scenes")

MS = 1_000_000


def _files(folder: Path) -> dict[str, Path]:
    return {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}


def _mcap(path: Path, *messages: tuple[str, int]) -> Path:
    """Write an MCAP with messages: their topics and log times in ms after T0."""
    path.parent.mkdir(parents=True, exist_ok=True)
    source = mcap_of([[(topic, T0 + at * MS, b"x") for topic, at in messages]])
    path.write_bytes(source.read(0, source.size_bytes))
    return path


def _topic(facts: MissionFacts, name: str) -> TopicFacts:
    (topic,) = (topic for topic in facts.topics if topic.name == name)
    return topic


@pytest.mark.parametrize("kind", [*SampleFormat])
def test_the_facts_of_a_sample_are_those_that_it_was_made_with(kind: SampleFormat, tmp_path: Path) -> None:
    truth = generate_mission(tmp_path, duration_s=2, size_bytes=1_000_000, formats=[kind])
    facts = read_mission(_files(tmp_path)).facts
    assert (facts.start_ns, facts.end_ns) == (truth.files[0].start_ns, truth.files[0].end_ns)
    (recording,) = facts.recordings
    assert (recording.content, recording.start_ns) == (Content.indexed, truth.files[0].start_ns)
    assert [topic.name for topic in facts.topics] == [topic.name for topic in truth.files[0].topics]
    for topic, true in zip(facts.topics, truth.files[0].topics, strict=True):
        assert (topic.count, topic.first_ns, topic.last_ns) == (true.count, true.first_ns, true.last_ns)
        assert topic.message_type == true.message_type
        assert topic.recordings == (recording.name,)
        if true.count > 1:
            assert topic.longest_gap_ns == true.longest_gap_ns


def test_topics_of_several_computers_are_merged(tmp_path: Path) -> None:
    _mcap(tmp_path / "nuc" / "a.mcap", *(("/tf", at) for at in range(0, 1001, 100)), ("/imu", 0), ("/imu", 1000))
    _mcap(tmp_path / "opc" / "a.mcap", *(("/tf", at) for at in range(500, 1501, 50)))
    facts = read_mission(_files(tmp_path)).facts
    assert [recording.name for recording in facts.recordings] == ["nuc/a.mcap", "opc/a.mcap"]
    assert (facts.start_ns, facts.end_ns) == (T0, T0 + 1500 * MS)
    tf = _topic(facts, "/tf")
    assert (tf.count, tf.recordings) == (11 + 21, ("nuc/a.mcap", "opc/a.mcap"))
    # 10 intervals in 1 s and 20 in 1 s, not 31 in 1.5 s; the gap is that of one recording.
    assert tf.rate_hz == pytest.approx(15)
    assert tf.longest_gap_ns == 100 * MS
    assert _topic(facts, "/imu").recordings == ("nuc/a.mcap",)


def test_silence_between_the_files_of_one_recording_is_a_gap(tmp_path: Path) -> None:
    _mcap(tmp_path / "run_0.mcap", ("/a", 0), ("/a", 100))
    _mcap(tmp_path / "run_1.mcap", ("/a", 900), ("/a", 1000))
    facts = read_mission(_files(tmp_path)).facts
    (recording,) = facts.recordings
    assert recording.paths == ("run_0.mcap", "run_1.mcap")
    assert _topic(facts, "/a").longest_gap_ns == 800 * MS


def test_a_recording_whose_clock_was_never_set_does_not_stretch_the_mission(tmp_path: Path) -> None:
    _mcap(tmp_path / "good.mcap", ("/a", 0), ("/a", 1000))
    _mcap(tmp_path / "unset.mcap", ("/b", -T0 // MS + 1), ("/b", -T0 // MS + 1001))
    facts = read_mission(_files(tmp_path)).facts
    assert (facts.start_ns, facts.end_ns) == (T0, T0 + 1000 * MS)
    unset = _topic(facts, "/b")
    assert (unset.count, unset.first_ns, unset.rate_hz) == (2, None, None)
    assert unset.recordings == ("unset.mcap",)


def test_a_rosbag2_folder_that_lacks_a_file_is_not_complete(recordings_dir: Path) -> None:
    facts = read_mission(_files(recordings_dir / "derived" / "split_missing_file")).facts
    (recording,) = facts.recordings
    assert recording.content is Content.recovered
    document = read_checks("version: 1\nprofiles:\n- recordings: {'*': {}}\n")
    (check,) = (check for check in evaluate_index(document, facts).checks if check.status is CheckStatus.error)
    assert check.name == "recording.incomplete"
    assert "wbag_2.mcap is missing" in check.message


@pytest.mark.skipif(os.geteuid() == 0, reason="root can read everything")
def test_a_file_that_cannot_be_read_hides_no_other(tmp_path: Path) -> None:
    _mcap(tmp_path / "a.mcap", ("/a", 0))
    _mcap(tmp_path / "b.mcap", ("/b", 0)).chmod(0)
    _check_unreadable(tmp_path)


def test_a_file_that_is_gone_hides_no_other(tmp_path: Path) -> None:
    _mcap(tmp_path / "a.mcap", ("/a", 0))
    files = {**_files(tmp_path), "b.mcap": tmp_path / "b.mcap"}
    facts = read_mission(files).facts
    assert [file.content for file in facts.files] == [Content.indexed, Content.error]
    assert _topic(facts, "/a").count == 1


def _check_unreadable(folder: Path) -> None:
    facts = read_mission(_files(folder)).facts
    assert [recording.content for recording in facts.recordings] == [Content.indexed, Content.error]
    document = read_checks("version: 1\nprofiles:\n- {topics: {/b: {}}, recordings: {'*': {}}}\n")
    statuses = {check.name: check.status for check in evaluate_index(document, facts).checks if check.status != "ok"}
    assert statuses == {"topic.missing": CheckStatus.not_made, "recording.incomplete": CheckStatus.not_made}


def test_an_empty_folder_is_a_mission_without_recordings() -> None:
    assert read_mission({}).facts == MissionFacts((), (), ())


def test_no_broken_file_ends_the_checks(recordings_dir: Path) -> None:
    document = read_checks(
        "version: 1\nprofiles:\n- topics: {'*': {rate: 1, max_gap: 1s, covers: 90%}}\n"
        "  recordings: {'*': {covers: 90%, max_start_skew: 1s}}\n  files: {'*': {complete: true}}\n"
        "  clocks: {'*': {no_jump: true}}\n"
    )
    for name in ("broken", "derived", "other"):
        mission = read_mission(_files(recordings_dir / name))
        results = evaluate_index(document, mission.facts)
        incomplete = {check.file for check in results.checks if check.name == "file.incomplete"}
        damaged = {
            path
            for path, summary in mission.summaries.items()
            if summary.content in (Content.recovered, Content.broken)
        }
        assert damaged <= incomplete


# -- suggestions ------------------------------------------------------------------------------------------------------


def _sample(folder: Path, seed: int, **faults: Any) -> MissionFacts:
    return _sample_mission(folder, seed, **faults).facts


def _sample_mission(folder: Path, seed: int, **faults: Any) -> LocalMission:
    formats = [SampleFormat.mcap]
    generate_mission(folder, duration_s=4, size_bytes=1_000_000, seed=seed, formats=formats, faults=Faults(**faults))
    return read_mission(_files(folder))


def test_good_missions_pass_the_checks_that_are_made_from_them(tmp_path: Path) -> None:
    missions = [_sample(tmp_path / str(seed), seed) for seed in (1, 2, 3)]
    text = suggest_checks(missions)
    document = read_checks(text)
    for mission in missions:
        assert _statuses(document, mission) == {CheckStatus.ok, CheckStatus.needs_content}
    assert "/imu/data: {type: sensor_msgs/Imu, rate: 200," in text
    assert "imu:\n    /imu/data: {}" in text
    assert 'values:\n    /imu/data: {fields: ["linear_acceleration.*", "angular_velocity.*"]}' in text
    unseen = _sample(tmp_path / "unseen", 4)
    assert _statuses(document, unseen) == {CheckStatus.ok, CheckStatus.needs_content}


def _statuses(document: ChecksDocument, mission: MissionFacts) -> set[CheckStatus]:
    return {check.status for check in evaluate_index(document, mission).checks}


def test_the_axis_of_an_imu_that_points_up_is_measured_where_it_is_clear(tmp_path: Path) -> None:
    good = [_sample_mission(tmp_path / str(seed), seed) for seed in (1, 2)]
    assert measure_up_axes(good) == {"/imu/data": "z"}
    text = suggest_checks([mission.facts for mission in good], {"/imu/data": "z"})
    assert "imu:\n    /imu/data: {up: z}" in text
    tilted = _sample_mission(tmp_path / "tilted", 3, defects=frozenset({Defect.tilted_gravity}))
    results = evaluate(read_checks(text), tilted, CheckDepth.content)
    assert [check.name for check in results.checks if check.status is CheckStatus.error] == ["imu.tilt"]
    assert measure_up_axes([*good, tilted]) == {}, "the missions do not agree"
    assert measure_up_axes([_sample_mission(tmp_path / "none", 4, dropped_topic="/imu/data")]) == {}


def test_imus_of_different_axes_have_rules_of_their_own(tmp_path: Path) -> None:
    generate_rig(tmp_path, duration_s=3)
    facts = read_mission(_files(tmp_path)).facts
    imus = sorted(topic.name for topic in facts.topics if topic.name.startswith("/imu/"))
    same = read_checks(suggest_checks([facts], dict.fromkeys(imus, "-y"))).profiles[0]
    assert {name: rule.up for name, (rule,) in same.imu.items()} == {"/imu/*": "-y"}
    axes = dict(zip(imus, ["x", "y", "-z"], strict=False))
    different = read_checks(suggest_checks([facts], axes)).profiles[0]
    assert {name: rule.up for name, (rule,) in different.imu.items()} == {name: axes.get(name) for name in imus}


def test_nan_fails_the_checks_of_good_missions(tmp_path: Path) -> None:
    good = _sample_mission(tmp_path / "good", 1)
    document = read_checks(suggest_checks([good.facts]))
    assert evaluate(document, good, CheckDepth.content).verdict is Verdict.good
    bad = _sample_mission(tmp_path / "nan", 1, defects=frozenset({Defect.nan}))
    results = evaluate(document, bad, CheckDepth.content)
    assert [(check.name, check.topic) for check in results.checks if check.status is CheckStatus.error] == [
        ("value.nan", "/odom")
    ]


def test_the_messages_of_an_optional_topic_are_checked_where_it_is_recorded(tmp_path: Path) -> None:
    document = read_checks("version: 1\nprofiles:\n- topics: {/imu/data: {required: false}}\n  imu: {/imu/data: {}}\n")
    there = evaluate(document, _sample_mission(tmp_path / "there", 1), CheckDepth.content)
    assert {check.name for check in there.checks} == {"topic.missing", "imu.gravity", "imu.constant"}
    missing = _sample_mission(tmp_path / "missing", 1, dropped_topic="/imu/data")
    for depth in CheckDepth:
        results = evaluate(document, missing, depth)
        assert (results.verdict, [check.name for check in results.checks]) == (Verdict.good, ["topic.missing"])


def test_a_mission_that_lacks_a_topic_fails_the_checks_of_good_ones(tmp_path: Path) -> None:
    document = read_checks(suggest_checks([_sample(tmp_path / "good", 1)]))
    bad = _sample(tmp_path / "bad", 1, dropped_topic="/imu/data")
    failing = {check.name for check in evaluate_index(document, bad).checks if check.status is CheckStatus.error}
    assert failing == {"topic.missing"}


def test_topics_that_only_some_missions_have_are_comments(tmp_path: Path) -> None:
    missions = [_sample(tmp_path / "all", 1), _sample(tmp_path / "without", 2, dropped_topic="/gps/fix")]
    text = suggest_checks(missions)
    assert "# /gps/fix is in 1 of 2 missions." in text
    assert "/gps/fix" not in read_checks(text).profiles[0].topics


def test_each_computer_has_a_rule(tmp_path: Path) -> None:
    missions = []
    for number in (1, 2):
        folder = tmp_path / str(number)
        for computer in ("nuc", "opc"):
            _mcap(folder / computer / f"day{number}.mcap", *(("/tf", at) for at in range(0, 3000, 10)))
        missions.append(read_mission(_files(folder)).facts)
    document = read_checks(suggest_checks(missions))
    assert set(document.profiles[0].recordings) == {"nuc/*", "opc/*"}
    without = read_mission({path: local for path, local in _files(tmp_path / "1").items() if path.startswith("nuc/")})
    failing = [check for check in evaluate_index(document, without.facts).checks if check.status is CheckStatus.error]
    assert [(check.name, check.file) for check in failing] == [("recording.missing", "opc/*")]


def test_many_topics_of_a_kind_have_one_rule_for_their_content(tmp_path: Path) -> None:
    generate_rig(tmp_path, duration_s=3)
    facts = read_mission(_files(tmp_path)).facts
    profile = read_checks(suggest_checks([facts])).profiles[0]
    assert set(profile.images) == {"/camera/*"}
    assert set(profile.imu) == {"/imu/*"}
    assert set(profile.point_clouds) == {"/lidar/hesai/points", "/lidar/livox/points"}
    assert len([name for name in profile.topics if name.startswith("/camera/")]) == 12


def test_unusual_names_are_quoted_or_left_out(tmp_path: Path) -> None:
    names = ["/a[1]", "/with space", "/x: {y}", "/'\"", "*", "/naïve", "/line\nbreak", "no", "# comment", "1"]
    _mcap(tmp_path / "a.mcap", *((name, at) for name in names for at in range(0, 3000, 10)))
    facts = read_mission(_files(tmp_path)).facts
    document = read_checks(suggest_checks([facts]))
    assert len(document.profiles[0].topics) == len(names) - 1
    assert evaluate_index(document, facts).verdict is Verdict.good


def test_real_missions_pass_the_checks_that_are_made_from_them(recordings_dir: Path) -> None:
    for path in [*(recordings_dir / "mcap").iterdir(), *(recordings_dir / "ros1").iterdir()]:
        files = _files(path) if path.is_dir() else {path.name: path}
        facts = read_mission(files).facts
        if not any(topic.count for topic in facts.topics) or facts.recordings[0].content is not Content.indexed:
            continue
        document = read_checks(suggest_checks([facts]))
        bad = [check for check in evaluate_index(document, facts).checks if check.status is not CheckStatus.ok]
        assert {check.status for check in bad} <= {CheckStatus.needs_content}, (path, bad)


def test_without_messages_there_is_nothing_to_suggest() -> None:
    with pytest.raises(ValueError, match="it has no messages"):
        suggest_checks([MissionFacts((), (), ())])
