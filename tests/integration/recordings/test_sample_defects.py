"""Each defect of a sample mission changes what it says, and nothing else."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from PIL import Image

from kleinkram.recordings import Content, FileSource, Recording, RecordingSummary, summarise
from kleinkram.recordings.sample import (
    Defect,
    Faults,
    MissionTruth,
    SampleFormat,
    generate_file,
    generate_mission,
    generate_rig,
)
from kleinkram.recordings.sample.robots import Robot, legged, vehicle
from tests.klein import run_klein

pytestmark = pytest.mark.usefixtures("remembered_scenes")
SECOND = 1_000_000_000
SECONDS = 3.0
VEHICLE, LEGGED = vehicle(camera_bytes=4000, lidar_points=64), legged()
ROBOTS = {"vehicle": VEHICLE, "legged": LEGGED}
EVERY = [
    pytest.param(name, defect, id=f"{name}-{defect.value}")
    for name, robot in ROBOTS.items()
    for defect in robot.targets
]
Messages = list[tuple[int, bytes]]


Make = Callable[..., MissionTruth]


def generate(robot: str, folder: Path, *defects: Defect) -> MissionTruth:
    faults = Faults(defects=frozenset(defects))
    if robot == "legged":
        return generate_rig(folder, duration_s=SECONDS, seed=5, faults=faults)
    return generate_mission(
        folder, duration_s=SECONDS, size_bytes=1_000_000, seed=5, formats=[SampleFormat.mcap], faults=faults
    )


@pytest.fixture(scope="module", name="make")
def _make(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Make]:
    """Makes a mission of a robot with some defects, once for all tests."""
    folder = tmp_path_factory.mktemp("missions")

    @cache
    def make(robot: str, *defects: Defect) -> MissionTruth:
        return generate(robot, folder / "-".join([robot, *(defect.value for defect in defects)]), *defects)

    yield make
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def good(make: Make) -> dict[str, MissionTruth]:
    return {name: make(name) for name in ROBOTS}


@pytest.fixture(scope="module")
def good_messages(good: dict[str, MissionTruth]) -> dict[str, dict[tuple[str, str], Messages]]:
    return {name: messages_of(mission) for name, mission in good.items()}


def messages_of(mission: MissionTruth) -> dict[tuple[str, str], Messages]:
    """Return log time and bytes of all messages, by file and topic, in the order of the file."""
    contents: dict[tuple[str, str], Messages] = {}
    for file in mission.files:
        with file.path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                topic = (file.path.stem, channel.topic)
                contents.setdefault(topic, []).append((message.log_time, message.data))
    return contents


def recorded(robot: Robot, target: str) -> set[tuple[str, str]]:
    """Return the files and topics of a topic, or of a computer."""
    return {
        (computer, sensor.topic)
        for sensor in robot.sensors
        for computer in sensor.computers
        if target in (sensor.topic, computer)
    }


@pytest.mark.parametrize(("name", "defect"), EVERY)
def test_a_defect_changes_only_its_target(
    name: str,
    defect: Defect,
    make: Make,
    good: dict[str, MissionTruth],
    good_messages: dict[str, dict[tuple[str, str], Messages]],
) -> None:
    mission = make(name, defect)
    if defect is Defect.truncated:
        sound, cut = (
            next(f for f in m.files if f.path.stem == ROBOTS[name].targets[defect]) for m in (good[name], mission)
        )
        assert sound.path.read_bytes().startswith(cut.path.read_bytes())
        assert cut.truncated
        assert [f.truncated for f in mission.files].count(True) == 1
        return
    before, after = good_messages[name], messages_of(mission)
    changed = {topic for topic in before | after if before.get(topic) != after.get(topic)}
    expected = set() if defect is Defect.missing_file else recorded(ROBOTS[name], ROBOTS[name].targets[defect])
    if defect is Defect.clock_jump:
        expected -= {("drive", "/tf_static")}  # was recorded before the jump
    assert changed == expected


def test_the_legged_robot_can_have_every_defect() -> None:
    assert set(LEGGED.targets) == set(Defect)
    assert set(VEHICLE.targets) < set(Defect)


def test_a_defect_that_the_vehicle_cannot_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"vehicle cannot have the defect missing-computer; the legged robot can"):
        generate("vehicle", tmp_path, Defect.missing_computer)


def test_an_unknown_defect_is_refused_with_a_similar_name() -> None:
    with pytest.raises(ValueError, match=r"no defect is called 'black-cam'; did you mean 'black-camera'\?"):
        Defect("black-cam")


def test_defects_combine(make: Make) -> None:
    mission = make("legged", Defect.missing_computer, Defect.gap, Defect.no_fix)
    assert [file.path.stem for file in mission.files] == ["nuc", "jetson", "lpc"]
    assert longest_gap_s(mission, "/lidar/hesai/points") > 0.7
    assert {fix.status.status for fix in values(mission, "/gnss/fix")} == {-1, 0}


# What each defect does.


def summary_of(mission: MissionTruth, stem: str) -> RecordingSummary:
    with FileSource(next(file.path for file in mission.files if file.path.stem == stem)) as source:
        return summarise(source)


def longest_gap_s(mission: MissionTruth, topic: str) -> float:
    return max(t.longest_gap_ns for f in mission.files for t in f.topics if t.name == topic) / SECOND


def values(mission: MissionTruth, topic: str) -> list[Any]:
    """Return the decoded messages of a topic."""
    file = next(file for file in mission.files if topic in {t.name for t in file.topics})
    with Recording.open(file.path) as recording:
        return [message.value for message in recording.messages(topic)]


def offsets_s(mission: MissionTruth, topic: str) -> list[float]:
    """Return the header stamps minus the log times."""
    file = next(file for file in mission.files if topic in {t.name for t in file.topics})
    with Recording.open(file.path) as recording:
        return [((m.stamp_ns or 0) - m.log_time_ns) / SECOND for m in recording.messages(topic)]


def pictures(mission: MissionTruth, robot: str) -> list[np.ndarray[Any, Any]]:
    return [
        np.asarray(Image.open(BytesIO(bytes(picture.data)))).astype(float)
        for picture in values(mission, ROBOTS[robot].targets[Defect.black_camera])
    ]


def sharpness(picture: np.ndarray[Any, Any]) -> float:
    """Return the variance of the Laplacian of the picture at a width of 320 pixels."""
    small = np.asarray(Image.fromarray(picture.astype(np.uint8)).resize((320, 240), Image.Resampling.BOX)).astype(float)
    laplacian = small[:-2, 1:-1] + small[2:, 1:-1] + small[1:-1, :-2] + small[1:-1, 2:] - 4 * small[1:-1, 1:-1]
    return float(laplacian.var())


def late(items: Sequence[Any]) -> list[Any]:
    """Return the items after the onset of a defect."""
    return list(items[round(len(items) * 0.35) :])


BOTH = pytest.mark.parametrize("robot", [*ROBOTS])


@BOTH
def test_good_pictures(robot: str, good: dict[str, MissionTruth]) -> None:
    brightness = [picture.mean() for picture in pictures(good[robot], robot)]
    assert all(60 < mean < 180 for mean in brightness)
    assert all(sharpness(picture) > 100 for picture in pictures(good[robot], robot))
    assert all((a != b).any() for a, b in pairwise(pictures(good[robot], robot)))


@BOTH
def test_black_camera(robot: str, make: Make) -> None:
    dark = pictures(make(robot, Defect.black_camera), robot)
    assert all(picture.max() < 8 for picture in late(dark))
    assert dark[0].mean() > 60


@BOTH
def test_overexposed_camera(robot: str, make: Make) -> None:
    bright = pictures(make(robot, Defect.overexposed_camera), robot)
    assert all(picture.min() > 245 for picture in late(bright))
    assert bright[0].mean() < 180


@BOTH
def test_frozen_camera(robot: str, make: Make) -> None:
    mission = make(robot, Defect.frozen_camera)
    topic = ROBOTS[robot].targets[Defect.frozen_camera]
    assert len({bytes(picture.data) for picture in late(values(mission, topic))}) == 1
    assert all(-0.1 < offset < 0 for offset in offsets_s(mission, topic))


@BOTH
def test_blurred_camera(robot: str, make: Make) -> None:
    blurry = pictures(make(robot, Defect.blurred_camera), robot)
    assert all(sharpness(picture) < 10 for picture in late(blurry))
    assert all(60 < picture.mean() < 180 for picture in blurry)
    assert sharpness(blurry[0]) > 100


@BOTH
def test_gap(robot: str, good: dict[str, MissionTruth], make: Make) -> None:
    topic = ROBOTS[robot].targets[Defect.gap]
    assert longest_gap_s(good[robot], topic) < 0.2
    assert longest_gap_s(make(robot, Defect.gap), topic) == pytest.approx(0.2 * SECONDS, abs=0.11)


@BOTH
def test_wrong_rate(robot: str, good: dict[str, MissionTruth], make: Make) -> None:
    mission, topic = make(robot, Defect.wrong_rate), ROBOTS[robot].targets[Defect.wrong_rate]
    assert len(values(mission, topic)) == pytest.approx(len(values(good[robot], topic)) / 2, abs=1)


@BOTH
def test_dropped_topic(robot: str, make: Make) -> None:
    mission = make(robot, Defect.dropped_topic)
    dropped = ROBOTS[robot].targets[Defect.dropped_topic]
    for file in mission.files:
        assert dropped not in {topic.name for topic in summary_of(mission, file.path.stem).topics}


@BOTH
def test_wrong_type(robot: str, make: Make) -> None:
    mission = make(robot, Defect.wrong_type)
    types = {topic.name: topic.message_type for file in mission.files for topic in file.topics}
    assert types["/odom"] == "geometry_msgs/msg/PoseWithCovarianceStamped"
    assert all(math.hypot(p.pose.pose.position.x, p.pose.pose.position.y) < 40 for p in values(mission, "/odom"))


@BOTH
def test_repeated_static_transforms(robot: str, good: dict[str, MissionTruth], make: Make) -> None:
    assert len(values(good[robot], "/tf_static")) == 1
    assert len(values(make(robot, Defect.repeated_static), "/tf_static")) == SECONDS


@BOTH
def test_silent_start_and_end(robot: str, make: Make) -> None:
    mission = make(robot, Defect.silent_start, Defect.silent_end)
    start, end = (min(f.start_ns for f in mission.files), max(f.end_ns for f in mission.files))
    spans = {topic.name: (topic.first_ns, topic.last_ns) for file in mission.files for topic in file.topics}
    first, last = spans[ROBOTS[robot].targets[Defect.silent_start]]
    assert (first - start) / SECOND == pytest.approx(0.4 * SECONDS, abs=0.2)
    assert (end - last) / SECOND < 0.3
    first, last = spans[ROBOTS[robot].targets[Defect.silent_end]]
    assert (end - last) / SECOND == pytest.approx(0.4 * SECONDS, abs=0.2)
    assert (first - start) / SECOND < 0.3


@BOTH
def test_clock_jump(robot: str, good: dict[str, MissionTruth], make: Make) -> None:
    stem = ROBOTS[robot].targets[Defect.clock_jump]
    assert all(topic.out_of_order_count == 0 for topic in summary_of(good[robot], stem).topics)
    mission = make(robot, Defect.clock_jump)
    topics = summary_of(mission, stem).topics
    assert all(topic.out_of_order_count for topic in topics if (topic.count or 0) > 30)
    imu = "/imu/data" if robot == "vehicle" else "/imu/zed"
    times = [time for time, _ in messages_of(mission)[stem, imu]]
    steps = [round((after - before) / SECOND, 1) for before, after in pairwise(times)]
    assert steps.count(-15) == 1
    assert max(steps) < 0.1


@BOTH
@pytest.mark.parametrize(
    ("defect", "expected"),
    [
        (Defect.stamp_offset, lambda sound, seconds: sound - 0.5),
        (Defect.stamp_drift, lambda sound, seconds: sound + 0.02 * seconds),
        (Defect.stamp_jump, lambda sound, seconds: sound - (seconds >= SECONDS / 2)),
    ],
)
def test_stamps(
    robot: str,
    defect: Defect,
    expected: Callable[[float, float], float],
    good: dict[str, MissionTruth],
    make: Make,
) -> None:
    topic = ROBOTS[robot].targets[defect]
    sound, wrong = offsets_s(good[robot], topic), offsets_s(make(robot, defect), topic)
    assert all(-0.1 < offset < 0 for offset in sound)
    predicted = [expected(offset, number / 10) for number, offset in enumerate(sound)]
    assert wrong == pytest.approx(predicted, abs=0.001)


def accelerations(mission: MissionTruth, topic: str) -> list[tuple[float, float, float]]:
    return [(a.x, a.y, a.z) for a in (imu.linear_acceleration for imu in values(mission, topic))]


@BOTH
def test_gravity(robot: str, good: dict[str, MissionTruth], make: Make) -> None:
    topic = ROBOTS[robot].targets[Defect.tilted_gravity]
    sound = accelerations(good[robot], topic)[0]
    assert math.hypot(*sound) == pytest.approx(9.81, abs=0.2)
    assert math.acos(sound[2] / math.hypot(*sound)) < 0.03
    tilted = accelerations(make(robot, Defect.tilted_gravity), topic)[0]
    assert math.hypot(*tilted) == pytest.approx(9.81, abs=0.2)
    assert math.degrees(math.acos(tilted[2] / math.hypot(*tilted))) == pytest.approx(30, abs=2)
    wrong = accelerations(make(robot, Defect.wrong_gravity), topic)[0]
    assert math.hypot(*wrong) == pytest.approx(10.79, abs=0.2)


@BOTH
def test_saturated_and_constant_imu(robot: str, make: Make) -> None:
    topic = ROBOTS[robot].targets[Defect.saturated_imu]
    saturated = accelerations(make(robot, Defect.saturated_imu), topic)
    assert {abs(x) for x, _, _ in late(saturated)} == {156.96}
    assert abs(saturated[0][0]) < 1
    constant = accelerations(make(robot, Defect.constant_imu), topic)
    assert len(set(constant)) == 1


@BOTH
def test_position_without_fix_and_with_jumps(robot: str, make: Make) -> None:
    topic = ROBOTS[robot].targets[Defect.no_fix]
    fixes = values(make(robot, Defect.no_fix), topic)
    assert {fix.status.status for fix in late(fixes)} == {-1}
    jumping = values(make(robot, Defect.position_jump), topic)
    metres = [
        111_320 * math.cos(math.radians(a.latitude)) * abs(b.longitude - a.longitude) for a, b in pairwise(jumping)
    ]
    assert max(metres) == pytest.approx(300, abs=5)
    assert {fix.status.status for fix in jumping} == {0}


@BOTH
def test_empty_clouds_and_far_points(robot: str, good: dict[str, MissionTruth], make: Make) -> None:
    topic = ROBOTS[robot].targets[Defect.empty_clouds]
    clouds = values(make(robot, Defect.empty_clouds), topic)
    assert {(cloud.width, len(cloud.data)) for cloud in late(clouds)} == {(0, 0)}
    assert ranges(values(good[robot], topic)[-1]).max() < 80
    assert ranges(values(good[robot], topic)[-1]).min() > 0.5
    distances = ranges(values(make(robot, Defect.far_points), topic)[-1])
    assert 0.05 < (distances > 80).mean() <= 0.25


def ranges(cloud: Any) -> np.ndarray[Any, Any]:
    points = np.frombuffer(bytes(cloud.data), np.float32).reshape(-1, 4)
    distances: np.ndarray[Any, Any] = np.linalg.norm(points[:, :3], axis=1)
    return distances


@BOTH
def test_disconnected_transforms(robot: str, good: dict[str, MissionTruth], make: Make) -> None:
    assert roots(good[robot]) == {"odom"}
    assert roots(make(robot, Defect.disconnected_tf)) == {"odom", "payload"}


def roots(mission: MissionTruth) -> set[str]:
    transforms = [t for topic in ("/tf", "/tf_static") for m in values(mission, topic) for t in m.transforms]
    return {t.header.frame_id for t in transforms} - {t.child_frame_id for t in transforms}


@BOTH
def test_odometry_with_jumps_and_nan(robot: str, make: Make) -> None:
    jumping = [m.pose.pose.position.x for m in values(make(robot, Defect.odometry_jump), "/odom")]
    assert max(abs(b - a) for a, b in pairwise(jumping)) == pytest.approx(300, abs=1)
    positions = [m.pose.pose.position for m in values(make(robot, Defect.nan), "/odom")]
    assert all(math.isnan(position.x) for position in late(positions))
    assert not any(math.isnan(position.y) for position in positions)


def test_joints_and_battery(good: dict[str, MissionTruth], make: Make) -> None:
    sound = values(good["legged"], "/joint_states")
    assert all(len({joint.position[number] for joint in sound}) > 100 for number in range(12))
    assert max(position for joint in sound for position in joint.position) < 2
    stuck = values(make("legged", Defect.stuck_value), "/joint_states")
    assert {tuple(joint.position) for joint in stuck} == {(0.4,) * 12}
    high = values(make("legged", Defect.value_range), "/joint_states")
    assert {joint.position[0] for joint in late(high)} == {1e6}
    assert values(good["legged"], "/battery")[-1].percentage == pytest.approx(0.8, abs=0.01)
    low = values(make("legged", Defect.low_battery), "/battery")
    assert (low[0].percentage, low[0].voltage) == pytest.approx((0.08, 41), abs=0.1)


def test_computers(good: dict[str, MissionTruth], make: Make) -> None:
    missing = make("legged", Defect.missing_computer)
    assert [file.path.stem for file in missing.files] == ["nuc", "jetson", "lpc"]
    assert not (missing.directory / "opc").exists()
    starts, ends = ({f.path.stem: t for f, t in times} for times in skews(good["legged"]))
    assert max(starts.values()) < 0.1
    assert max(ends.values()) < 0.1
    starts, ends = ({f.path.stem: t for f, t in times} for times in skews(make("legged", Defect.late_computer)))
    assert starts.pop("jetson") == pytest.approx(0.4 * SECONDS, abs=0.1)
    assert max(*starts.values(), *ends.values()) < 0.1
    starts, ends = ({f.path.stem: t for f, t in times} for times in skews(make("legged", Defect.early_end)))
    assert ends.pop("jetson") == pytest.approx(0.4 * SECONDS, abs=0.1)
    assert max(*starts.values(), *ends.values()) < 0.1


def skews(mission: MissionTruth) -> tuple[list[tuple[Any, float]], list[tuple[Any, float]]]:
    """Return of each file how much later it starts, and how much earlier it ends, than the mission."""
    start, end = min(f.start_ns for f in mission.files), max(f.end_ns for f in mission.files)
    return (
        [(f, (f.start_ns - start) / SECOND) for f in mission.files],
        [(f, (end - f.end_ns) / SECOND) for f in mission.files],
    )


@pytest.mark.parametrize("kind", [*SampleFormat])
def test_an_empty_recording_is_readable(kind: SampleFormat, tmp_path: Path) -> None:
    mission = generate_rig(
        tmp_path, duration_s=0.5, kind=kind, faults=Faults(defects=frozenset({Defect.empty_recording}))
    )
    empty = next(file for file in mission.files if "opc" in file.path.stem)
    assert (empty.message_count, empty.topics) == (0, ())
    assert empty.size_bytes < 50_000
    with FileSource(empty.path) as source:
        summary = summarise(source)
    assert (summary.content, summary.message_count) == (Content.indexed, 0)


def test_a_truncated_computer_is_recovered(make: Make) -> None:
    mission = make("legged", Defect.truncated)
    contents = {file.path.stem: summary_of(mission, file.path.stem).content for file in mission.files}
    assert contents.pop("nuc") is Content.recovered
    assert set(contents.values()) == {Content.indexed}


def test_a_missing_file(good: dict[str, MissionTruth], make: Make) -> None:
    assert "lidar_hesai:" in (good["legged"].directory / "calibration.yaml").read_text()
    mission = make("legged", Defect.missing_file)
    assert sorted(path.name for path in mission.directory.iterdir()) == ["jetson", "lpc", "nuc", "opc"]


def test_recorder_offset(good: dict[str, MissionTruth], make: Make) -> None:
    def differences_s(mission: MissionTruth, topic: str, *stems: str) -> list[float]:
        """Return the differences between the log times that two files have for the same bytes."""
        times, others = ({data: time for time, data in messages_of(mission)[stem, topic]} for stem in stems)
        assert len(times) > 200
        assert times.keys() == others.keys()
        return [(times[data] - others[data]) / SECOND for data in times]

    for topic, *stems in (("/imu/base", "nuc", "lpc"), ("/tf", "lpc", "opc")):
        assert set(differences_s(good["legged"], topic, *stems)) == {0}
    wrong = make("legged", Defect.recorder_offset)
    assert set(differences_s(wrong, "/imu/base", "nuc", "lpc")) == {0.25}
    assert set(differences_s(wrong, "/tf", "lpc", "opc")) == {0}
    assert offsets_s(wrong, "/gnss/fix") == pytest.approx(offsets_s(good["legged"], "/gnss/fix"))


def test_defects_of_a_drive_of_a_size(tmp_path: Path) -> None:
    """A drive that ends at a size ends although topics are silent."""
    faults = Faults(defects=frozenset({Defect.silent_end, Defect.silent_start, Defect.gap}))
    truth = generate_file(tmp_path / "a.mcap", kind=SampleFormat.mcap, size_bytes=3_000_000, faults=faults)
    assert truth.size_bytes == pytest.approx(3_000_000, rel=0.2)


def klein(*arguments: object) -> subprocess.CompletedProcess[str]:
    return run_klein([*map(str, arguments)], os.environ)


def test_the_help_lists_every_defect() -> None:
    words = klein("sample", "--help").stdout.replace("-\n  ", "-").replace(".", " ").split()
    assert not {defect.value for defect in Defect} - set(words)


def test_defects_on_the_command_line(tmp_path: Path) -> None:
    made = klein(
        "sample", tmp_path / "m", "--rig", "legged", "--duration", 1, "--defect", "missing-computer", "--defect", "nan"
    )
    assert made.returncode == 0, made.stderr
    assert sorted(path.name for path in (tmp_path / "m").iterdir()) == ["calibration.yaml", "jetson", "lpc", "nuc"]
    refused = klein("sample", tmp_path / "n", "--defect", "missing-computer")
    assert refused.returncode == 2
    assert "the vehicle cannot have the defect missing-computer" in refused.stderr
    assert not (tmp_path / "n").exists()
