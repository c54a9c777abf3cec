"""Known defects of sample missions: which checks find each, from the index and from the content; no false alarms.

Prints a table: `pytest -s tests/integration/checks/test_defects.py -k table`.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from kleinkram.checks.document import ChecksDocument, read_checks
from kleinkram.checks.local import LocalMission, read_mission
from kleinkram.checks.results import CheckResults, evaluate
from kleinkram.contract.checks import CheckDepth, CheckStatus, Verdict
from kleinkram.recordings.sample import Defect, Faults, SampleFormat, generate_mission, generate_rig
from kleinkram.recordings.sample.robots import legged, vehicle

pytestmark = pytest.mark.usefixtures("remembered_scenes")
ROOT = Path(__file__).parents[3]
SECONDS = 3.0
VEHICLE_CHECKS = """
version: 1
profiles:
- name: vehicle
  files:
    "drive*": {complete: true}
  recordings:
    "drive*": {count: 1, covers: 95%, max_start_skew: 500ms, max_end_skew: 500ms}
  topics:
    /camera/image/compressed: {type: sensor_msgs/CompressedImage, rate: 10 Hz, max_gap: 500ms, max_silence_at_end: 1s}
    /lidar/points: {type: sensor_msgs/PointCloud2, rate: 10 Hz, max_gap: 500ms, max_silence_at_start: 1s, covers: 95%}
    /imu/data: {type: sensor_msgs/Imu, rate: 200 Hz, max_gap: 100ms}
    /gps/fix: {type: sensor_msgs/NavSatFix, rate: 5 Hz}
    /odom: {type: nav_msgs/Odometry, rate: 50 Hz}
    /tf: {type: tf2_msgs/TFMessage, rate: 50 Hz}
    /tf_static: {count: 1}
  clocks:
    "*": {no_jump: true}
    /lidar/*: {max_stamp_offset: 150ms, max_stamp_drift: 200, max_stamp_jump: 100ms}
  images:
    /camera/*: {max_frozen: 1s, min_sharpness: 20}
  imu:
    /imu/*: {gravity_tolerance: 0.4, up: z, max_acceleration: 150}
  positions:
    /gps/fix: {max_speed: 10}
  point_clouds:
    /lidar/*: {min_points: 16, min_range: 0.1, max_range: 150}
  transforms:
    /tf*: {}
  odometry:
    /odom: {max_speed: 5}
  values:
    /odom: {}
"""


class Outcome(NamedTuple):
    """The checks that must find a defect by the index or by the content, and others that may fail because of it."""

    from_index: set[str]
    from_content: set[str]
    consequences: set[str]


def by_index(*names: str, also: str = "") -> Outcome:
    return Outcome(set(names), set(), set(also.split()))


def by_content(*names: str, also: str = "") -> Outcome:
    return Outcome(set(), set(names), set(also.split()))


EXPECTED = {
    Defect.gap: by_index("topic.gap", also="topic.rate"),
    Defect.wrong_rate: by_index("topic.rate"),
    Defect.dropped_topic: by_index("topic.missing", also="position.fix position.jump"),
    Defect.wrong_type: by_index("topic.type"),
    Defect.repeated_static: by_index("topic.count"),
    Defect.silent_start: by_index("topic.silent_start", also="topic.coverage"),
    Defect.silent_end: by_index("topic.silent_end", also="topic.coverage"),
    Defect.clock_jump: by_index(
        "clock.jump",
        also="topic.gap topic.rate topic.coverage topic.silent_start topic.silent_end recording.coverage "
        "recording.start_skew recording.end_skew odometry.jump position.jump",
    ),
    Defect.stamp_offset: by_content("clock.stamp_offset"),
    Defect.stamp_drift: by_content("clock.stamp_drift", also="clock.stamp_offset"),
    Defect.stamp_jump: by_content("clock.stamp_jump", also="clock.stamp_offset clock.stamp_drift"),
    Defect.black_camera: by_content("image.black", also="image.blurred"),
    Defect.overexposed_camera: by_content("image.overexposed", also="image.blurred"),
    Defect.frozen_camera: by_content("image.frozen"),
    Defect.blurred_camera: by_content("image.blurred"),
    Defect.tilted_gravity: by_content("imu.tilt"),
    Defect.wrong_gravity: by_content("imu.gravity"),
    Defect.saturated_imu: by_content("imu.saturated", also="imu.gravity"),
    Defect.constant_imu: by_content("imu.constant"),
    Defect.no_fix: by_content("position.fix"),
    Defect.position_jump: by_content("position.jump"),
    Defect.empty_clouds: by_content("cloud.empty"),
    Defect.far_points: by_content("cloud.range"),
    Defect.disconnected_tf: by_content("transform.connected"),
    Defect.odometry_jump: by_content("odometry.jump"),
    Defect.nan: by_content("value.nan", "odometry.jump"),
    Defect.stuck_value: by_content("value.constant"),
    Defect.value_range: by_content("value.range"),
    Defect.low_battery: by_content("battery.low"),
    Defect.truncated: by_index(
        "recording.incomplete",
        also="file.incomplete recording.coverage recording.end_skew topic.coverage topic.silent_end",
    ),
    Defect.missing_computer: by_index("recording.missing", "topic.missing", also="recording.count"),
    Defect.late_computer: by_index(
        "recording.start_skew", "recording.coverage", also="topic.silent_start topic.coverage"
    ),
    Defect.early_end: by_index("recording.end_skew", "recording.coverage", also="topic.silent_end topic.coverage"),
    Defect.empty_recording: by_index(
        "topic.missing", also="recording.coverage recording.start_skew recording.end_skew file.size"
    ),
    Defect.recorder_offset: by_content(
        "clock.recorder_offset", also="clock.stamp_offset topic.coverage recording.coverage"
    ),
    Defect.missing_file: by_index("file.missing"),
}
ROBOTS = {"vehicle": vehicle(camera_bytes=4000, lidar_points=64), "legged": legged()}
EVERY = [
    # What the vehicle can have, too, the legged robot with its four computers has in the soak.
    pytest.param(
        name,
        defect,
        id=f"{name}-{defect.value}",
        marks=pytest.mark.soak if name == "legged" and defect in ROBOTS["vehicle"].targets else [],
    )
    for name, robot in ROBOTS.items()
    for defect in robot.targets
]
found_by: dict[tuple[str, Defect], tuple[list[str], list[str]]] = {}


def rules(robot: str) -> ChecksDocument:
    example = (ROOT / "examples/checks/legged-robot.yaml").read_text()
    return read_checks(example if robot == "legged" else VEHICLE_CHECKS)


def read_folder(folder: Path) -> LocalMission:
    return read_mission({path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()})


def failing(results: CheckResults) -> set[str]:
    """Return the names of the checks that failed or could not be made."""
    fine = (CheckStatus.ok, CheckStatus.needs_content)
    return {check.name for check in results.checks if check.status not in fine}


def failed_topics(results: CheckResults) -> set[str]:
    """Return the topics of the checks that failed; some name several."""
    bad = (CheckStatus.error, CheckStatus.warning)
    return {check.topic for check in results.checks if check.status in bad and check.topic is not None}


@pytest.mark.parametrize(("robot", "defect"), EVERY)
def test_each_defect_is_found(robot: str, defect: Defect, tmp_path: Path) -> None:
    faults = Faults(defects=frozenset({defect}))
    # The offset must be less than the share of the mission that a topic need not cover.
    seconds = 3 * SECONDS if defect is Defect.recorder_offset else SECONDS
    if robot == "legged":
        generate_rig(tmp_path, duration_s=seconds, faults=faults)
    else:
        generate_mission(tmp_path, duration_s=seconds, size_bytes=4_000_000, formats=[SampleFormat.mcap], faults=faults)
    mission, expected = read_folder(tmp_path), EXPECTED[defect]
    index = evaluate(rules(robot), mission, CheckDepth.index)
    content = evaluate(rules(robot), mission, CheckDepth.content)
    assert expected.from_index <= failing(index)
    assert expected.from_index | expected.from_content <= failing(content)
    assert failing(content) <= expected.from_index | expected.from_content | expected.consequences
    assert index.verdict in (
        (Verdict.bad, Verdict.warnings) if expected.from_index else (Verdict.unchecked, Verdict.warnings)
    )
    assert content.verdict in (Verdict.bad, Verdict.warnings)
    target = ROBOTS[robot].targets[defect]
    if target.startswith("/"):
        assert any(target in topics for topics in failed_topics(content))
    names = expected.from_index | expected.from_content
    found_by[robot, defect] = sorted(names & failing(index)), sorted(names & failing(content))


GOOD = [
    *(("vehicle", kind, seed, seconds) for kind in SampleFormat for seed, seconds in ((1, 10.0), (2, 3.0), (3, 30.0))),
    *(("legged", SampleFormat.mcap, seed, seconds) for seed, seconds in ((1, 7.0), (2, 5.0), (3, 9.0), (4, 3.0))),
    *(("legged", kind, 5, 4.0) for kind in (SampleFormat.bag, SampleFormat.db3)),
]
# Each format and each robot is in every round; more random missions are in the soak.
_IN_EVERY_ROUND = (
    ("vehicle", SampleFormat.mcap, 1, 10.0),
    ("vehicle", SampleFormat.bag, 2, 3.0),
    ("vehicle", SampleFormat.db3, 2, 3.0),
    ("legged", SampleFormat.mcap, 4, 3.0),
    *GOOD[-2:],
)


@pytest.mark.parametrize(
    ("robot", "kind", "seed", "seconds"),
    [pytest.param(*good, marks=[] if good in _IN_EVERY_ROUND else pytest.mark.soak) for good in GOOD],
)
def test_no_false_alarm_on_good_missions(
    robot: str, kind: SampleFormat, seed: int, seconds: float, tmp_path: Path
) -> None:
    """15 of the 20 good missions; the others are real recordings, in `test_real_recordings.py`."""
    if robot == "legged":
        generate_rig(tmp_path, duration_s=seconds, seed=seed, kind=kind)
    else:
        generate_mission(tmp_path, duration_s=seconds, size_bytes=4_000_000, seed=seed, formats=[kind])
    results = evaluate(rules(robot), read_folder(tmp_path), CheckDepth.content)
    assert [check for check in results.checks if check.status is not CheckStatus.ok] == []
    assert results.verdict is Verdict.good


FILE_CHECKS = """
version: 1
profiles:
- files: {"*/*.mcap": {count: 4, complete: true, min_size: 10KB}}
  recordings: {"*": {count: 4}}
  topics: {/camera/*: {covers: 90%}}
"""


@pytest.mark.parametrize(
    ("defect", "names"),
    [
        (None, set()),
        (Defect.missing_computer, {"file.count", "recording.count"}),
        (Defect.truncated, {"file.incomplete", "recording.incomplete", "topic.coverage"}),
        (Defect.empty_recording, {"file.size"}),
        (Defect.silent_start, {"topic.coverage"}),
        (Defect.silent_end, {"topic.coverage"}),
    ],
)
def test_defects_of_files_are_found(defect: Defect | None, names: set[str], tmp_path: Path) -> None:
    generate_rig(tmp_path, duration_s=3, faults=Faults(defects=frozenset({defect} if defect else ())))
    results = evaluate(read_checks(FILE_CHECKS), read_folder(tmp_path), CheckDepth.index)
    assert failing(results) == names


@pytest.mark.parametrize("is_allowed", [False, True])
def test_a_cut_recording_is_never_good_unless_a_rule_allows_it(is_allowed: bool, tmp_path: Path) -> None:
    generate_rig(tmp_path, duration_s=3, faults=Faults(defects=frozenset({Defect.truncated})))
    (tmp_path / "nuc.mcap").touch()
    (tmp_path / "a.mcap").write_text("These are notes.\n")
    allowed = '  recordings: {"*": {complete: false}}\n' if is_allowed else ""
    document = read_checks(f"version: 1\nprofiles:\n- topics: {{/imu/data: {{required: false}}}}\n{allowed}")
    results = evaluate(document, read_folder(tmp_path), CheckDepth.index)
    rows = {check.file: check.message for check in results.checks if check.name == "recording.incomplete"}
    if is_allowed:
        assert (results.verdict, rows) == (Verdict.good, {})
        return
    assert results.verdict is Verdict.warnings
    assert len(rows) == 3
    assert rows["nuc.mcap"] == "the file has 0 bytes"
    assert rows["a.mcap"] == "not a known recording format"


def test_every_defect_has_an_expected_outcome() -> None:
    assert set(EXPECTED) == set(Defect)


def test_table_of_defects() -> None:
    """Print where each defect was found by the tests above."""
    print()  # noqa: T201 - for `pytest -s`
    for line in table():
        print(line)  # noqa: T201
    assert all(index or content for index, content in found_by.values())


def table() -> Iterator[str]:
    yield "| robot | defect | from the index | from the content |"
    yield "|---|---|---|---|"
    for (robot, defect), (index, content) in found_by.items():
        more = [name for name in content if name not in index]
        yield f"| {robot} | {defect.value} | {', '.join(index) or '-'} | {', '.join(more) or '-'} |"
