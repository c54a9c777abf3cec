"""`slam-evaluate`: its numbers are those of evo; what cannot be compared is said in one sentence."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from kleinkram.action.testing import TryOutResult, try_out
from kleinkram.client.actions import read_manifest
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.checks import Verdict
from kleinkram.library.slam_evaluate import pairs_by_time, yaw_alignment
from kleinkram.recordings.sample import generate_mcap
from tests.integration.library.packages import SLAM_EVALUATE, slow_with_packages, with_packages

REFERENCE, ESTIMATE = "truth.tum", "derived/estimate.tum"
T0 = 1_700_000_000


def line(seconds: float, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> str:
    return f"{T0 + seconds:.6f} {x!r} {y!r} 0 0 0 {math.sin(yaw / 2)!r} {math.cos(yaw / 2)!r}\n"


def square(*, delay_s: float = 0.0, turn: float = 0.0, scale: float = 1.0, shift: float = 0.0) -> bytes:
    """A drive along a square with sides of 10 m at 1 m/s and 10 Hz, as another frame would have it."""
    rows = []
    for number in range(400):
        side, along = divmod(number / 10, 10)
        corner = [(0, 0), (10, 0), (10, 10), (0, 10)][int(side)]
        heading = side * math.pi / 2
        x, y = (corner[0] + along * math.cos(heading)) * scale, (corner[1] + along * math.sin(heading)) * scale
        turned = x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn)
        rows.append(line(number / 10 + delay_s, turned[0] + shift, turned[1], heading + turn))
    return "".join(rows).encode()


def evaluate(
    folder: Path,
    files: Mapping[str, Path | bytes],
    *,
    reference: str | None = REFERENCE,
    **parameters: str | float,
) -> TryOutResult:
    metadata: dict[str, Any] = {} if reference is None else {"reference": reference}
    return try_out(SLAM_EVALUATE, folder, files=files, parameters={**parameters}, metadata=metadata, timeout_s=120)


def refusal_of(ran: TryOutResult) -> str:
    """The sentence of a run that failed: the last line of its log, and its only finding."""
    assert ran.exit_code == 1, ran.log
    (finding,) = ran.report.findings
    assert ran.log.strip().splitlines()[-1] == finding.message
    assert "Traceback" not in ran.log
    assert not ran.report.metrics
    return finding.message


GOOD = square()


@pytest.mark.parametrize(
    ("estimate", "sentence"),
    [
        (
            line(2) + line(1),
            "line 2: its stamp 1700000001.000000000 s is earlier than 1700000002.000000000 s of the pose",
        ),
        (line(1) + line(1), "line 2: its stamp 1700000001.000000000 s is that of the pose before it, too"),
        ("1 0 0 7 0 1 0 8 0 0 1 9\n", "has no stamps, so it cannot be compared with truth.tum, which has"),
        (line(100) + line(101), "does not overlap in time with the reference truth.tum: it is 60.100 s after it"),
        (line(-9) + line(-8), "does not overlap in time with the reference truth.tum: it is 8.000 s before it"),
        ("no trajectory\n", "line 1 has 2 values; a pose of TUM has 8 values"),
    ],
    ids=["unsorted", "doubled", "no-stamps", "later", "earlier", "no-trajectory"],
)
def test_an_unusable_estimate_fails_with_a_sentence(tmp_path: Path, estimate: str, sentence: str) -> None:
    refusal = refusal_of(evaluate(tmp_path, {REFERENCE: GOOD, ESTIMATE: estimate.encode()}))
    assert refusal.startswith(f"{ESTIMATE}: ")
    assert sentence in refusal


@pytest.mark.parametrize("estimate", [REFERENCE, "*.tum"])
def test_the_reference_is_not_compared_with_itself(tmp_path: Path, estimate: str) -> None:
    refusal = refusal_of(evaluate(tmp_path, {REFERENCE: GOOD}, estimate=estimate))
    assert refusal == f"{REFERENCE}: is the reference itself; name another estimate"


def test_a_mission_without_a_reference_fails_and_says_how_to_name_one(tmp_path: Path) -> None:
    refusal = refusal_of(evaluate(tmp_path, {ESTIMATE: GOOD}, reference=None))
    assert refusal.startswith("reference: the mission mission names none: set its metadata field reference, the key ")


@pytest.mark.parametrize(
    ("parameter", "metadata", "named"),
    [("run.tum", "mission.tum", "run.tum"), ("", "mission.tum", "mission.tum"), ("", None, "project.tum")],
)
def test_the_parameter_comes_before_the_mission_and_the_mission_before_the_project(
    tmp_path: Path, parameter: str, metadata: str | None, named: str
) -> None:
    checks = "version: 1\nprofiles: [{reference: project.tum}]\n"
    refusal = refusal_of(
        try_out(
            SLAM_EVALUATE,
            tmp_path,
            files={ESTIMATE: GOOD},
            parameters={"reference": parameter},
            metadata={"reference": metadata},
            checks=checks,
        )
    )
    assert refusal.startswith(f"reference {named}: the inputs have no such file or topic")


@pytest.mark.parametrize(
    ("reference", "sentence"),
    [
        ("lost.tum", "reference lost.tum: the inputs have no such file or topic; the files are derived/estimate.tum"),
        ("*.tum", "reference *.tum: 2 files match, but one is needed: derived/estimate.tum, truth.tum"),
        ("/odom", "reference /odom: the inputs have no such file or topic"),
        ("tf:map", "reference tf:map: transforms are named like tf:map->base_link"),
        ("nuc.mcap:/odom", "reference nuc.mcap:/odom: no recording is called nuc.mcap; there are none"),
    ],
)
def test_a_reference_that_is_not_there_fails_with_a_sentence(tmp_path: Path, reference: str, sentence: str) -> None:
    files = {REFERENCE: GOOD, ESTIMATE: GOOD}
    assert sentence in refusal_of(evaluate(tmp_path, files, reference=reference))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.mcap"
    generate_mcap(path, duration_s=12, size_bytes=3_000_000)
    return path


def test_a_topic_of_the_wrong_type_fails_with_a_sentence(tmp_path: Path, drive: Path) -> None:
    refusal = refusal_of(evaluate(tmp_path, {"drive.mcap": drive}, reference="/odom", estimate="/imu/data"))
    assert refusal == "/imu/data: is of type sensor_msgs/msg/Imu, which has no poses; topics with poses: /odom"


def test_a_topic_in_several_recordings_must_be_named_with_one(tmp_path: Path, drive: Path) -> None:
    files = {"a.mcap": drive, "b.mcap": drive}
    refusal = refusal_of(evaluate(tmp_path, files, reference="/odom", estimate="a.mcap:tf:odom->base_link"))
    assert refusal == "reference /odom: 2 recordings have it: a.mcap, b.mcap; name one, such as a.mcap:/odom"


@pytest.mark.parametrize("deltas", ["1 km", "0 m", "", "1.5 frames", "-1 s"])
def test_a_delta_that_is_none_fails_with_a_sentence(tmp_path: Path, deltas: str) -> None:
    refusal = refusal_of(evaluate(tmp_path, {REFERENCE: GOOD, ESTIMATE: GOOD}, deltas=deltas))
    assert refusal.startswith(f"deltas: '{deltas}' is none: write metres, seconds or frames")


def test_an_alignment_that_there_is_not_is_refused_before_the_run(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="'alignment' is one of se3, sim3, yaw, origin, none"):
        evaluate(tmp_path, {REFERENCE: GOOD, ESTIMATE: GOOD}, alignment="SE3")


def test_pairs_by_time_follow_each_other_and_skip_gaps() -> None:
    import numpy as np

    times = np.array([0.0, 0.5, 1.02, 1.5, 2.0, 5.0, 6.0])
    assert pairs_by_time(times, 1.0) == [(0, 2), (2, 4), (5, 6)]
    assert pairs_by_time(times[:5], 2.05) == []
    assert pairs_by_time(times[:1], 1.0) == []


def test_yaw_alignment_turns_about_z_only() -> None:
    import numpy as np

    points = np.random.default_rng(1).normal(size=(20, 3))
    cosine, sine = math.cos(2.0), math.sin(2.0)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    rotation, translation = yaw_alignment(points, points @ turn.T + [1, 2, 3])
    assert rotation == pytest.approx(turn)
    assert translation == pytest.approx(np.array([1, 2, 3]))


def test_the_script_describes_itself() -> None:
    manifest = read_manifest(SLAM_EVALUATE)
    assert (manifest.name, manifest.dependencies) == ("slam-evaluate", ["open-kleinkram", "evo==1.38.1"])
    assert manifest.inputs.derived
    better = {metric.name: (metric.unit, metric.better.value) for metric in manifest.metrics}
    assert better["ate_rmse"] == ("m", "lower")
    assert better["rpe_rotation_max"] == ("deg", "lower")
    assert better["coverage"] == (None, "higher")


# From here on with evo.


@pytest.fixture
def _evo(monkeypatch: pytest.MonkeyPatch) -> None:
    with_packages(monkeypatch, SLAM_EVALUATE)


@pytest.fixture(scope="module")
def expected(recordings_dir: Path) -> Mapping[str, Any]:
    loaded: Mapping[str, Any] = json.loads((recordings_dir / "trajectories" / "expected-evo-1.38.1.json").read_text())
    return loaded


ESTIMATES = [f"euroc_MH_04_vislam_{kind}{number}.tum" for kind in ("rp", "ba") for number in range(3)]
TRUTH = "euroc_MH_04_groundtruth.tum"
STATISTICS = ("rmse", "mean", "median", "std", "min", "max")


def test_all_pairs_are_compared(expected: Mapping[str, Any]) -> None:
    assert set(expected) == {f"{TRUTH} vs {estimate}" for estimate in ESTIMATES}


def as_evo_prints(values: Mapping[str, float]) -> dict[str, str]:
    return {statistic: f"{values[statistic]:.6f}" for statistic in STATISTICS}


def statistics(ran: TryOutResult, prefix: str, labels: Mapping[str, str]) -> dict[str, float]:
    return {statistic: ran.metric(f"{prefix}_{statistic}", labels=labels) for statistic in STATISTICS}


# `test_alignments` covers them in every round; their relative errors are those of se3.
_SIMPLER = ("none", "origin")


@slow_with_packages
@pytest.mark.usefixtures("_evo")
@pytest.mark.parametrize("alignment", ["se3", "sim3", *(pytest.param(it, marks=pytest.mark.soak) for it in _SIMPLER)])
def test_the_numbers_are_those_of_evo(
    tmp_path: Path, recordings_dir: Path, expected: Mapping[str, Any], alignment: str
) -> None:
    """All six estimates of EuRoC MH_04, to the last digit that evo prints."""
    folder = recordings_dir / "trajectories"
    files: dict[str, Path | bytes] = {name: folder / name for name in (TRUTH, *ESTIMATES)}
    ran = evaluate(
        tmp_path,
        files,
        reference=TRUTH,
        estimate="*.tum",
        alignment=alignment,
        tolerance=0.02,
        deltas="1 frame, 1 m, 10 m",
    )
    assert ran.exit_code == 0, ran.log
    assert not ran.report.findings
    for estimate in ESTIMATES:
        numbers = expected[f"{TRUTH} vs {estimate}"]
        labels = {"estimate": estimate, "reference": TRUTH, "alignment": alignment, "tolerance": "0.02 s"}
        name = {"none": "ape_trans_no_align"}.get(alignment, f"ape_trans_{alignment}")
        assert as_evo_prints(statistics(ran, "ate", labels)) == as_evo_prints(numbers[name])
        assert ran.metric("matched_poses", labels=labels) == numbers["matched"]
        assert ran.metric("estimate_poses", labels=labels) == numbers["est_poses"]
        assert ran.metric("estimate_path_length", labels=labels) == pytest.approx(numbers["est_path_length_m"])
        assert ran.metric("reference_path_length", labels=labels) == pytest.approx(numbers["ref_path_length_m"])
        if alignment == "se3":
            rotation = statistics(ran, "ate_rotation", labels)
            assert as_evo_prints(rotation) == as_evo_prints(numbers["ape_rot_deg_se3"])
        if alignment == "sim3":
            assert ran.metric("scale", labels=labels) == pytest.approx(numbers["sim3_scale"], rel=1e-9)
            continue  # the relative errors are those of the scaled estimate
        for delta, name in (
            ("1 frame", "rpe_trans_1frame"),
            ("1 m", "rpe_trans_1m_consecutive"),
            ("10 m", "rpe_trans_10m_consecutive"),
        ):
            relative = statistics(ran, "rpe", {**labels, "delta": delta})
            assert as_evo_prints(relative) == as_evo_prints(numbers[name]), (estimate, delta)
        rotation = statistics(ran, "rpe_rotation", {**labels, "delta": "1 frame"})
        assert as_evo_prints(rotation) == as_evo_prints(numbers["rpe_rot_deg_1frame"])
    assert [preview.path for preview in ran.report.previews] == ["trajectories.png", "errors.png"]
    for preview in ran.report.previews:
        assert (ran.out / preview.path).read_bytes().startswith(b"\x89PNG")
    assert len((ran.out / "errors.csv").read_text().splitlines()) == 1 + sum(
        expected[f"{TRUTH} vs {estimate}"]["matched"] for estimate in ESTIMATES
    )


LABELS = {"estimate": ESTIMATE, "reference": REFERENCE, "tolerance": "0.01 s"}


@slow_with_packages
@pytest.mark.usefixtures("_evo")
@pytest.mark.parametrize(
    ("alignment", "estimate", "ate_m"),
    [
        ("none", square(shift=2.0), 2.0),
        ("se3", square(shift=2.0, turn=1.0), 0.0),
        ("yaw", square(shift=2.0, turn=1.0), 0.0),
        ("origin", square(shift=2.0, turn=1.0), 0.0),
        ("sim3", square(shift=2.0, turn=1.0, scale=0.5), 0.0),
    ],
)
def test_alignments(tmp_path: Path, alignment: str, estimate: bytes, ate_m: float) -> None:
    ran = evaluate(tmp_path, {REFERENCE: GOOD, ESTIMATE: estimate}, alignment=alignment)
    assert ran.exit_code == 0, ran.log
    labels = {**LABELS, "alignment": alignment}
    assert ran.metric("ate_rmse", labels=labels) == pytest.approx(ate_m, abs=1e-6)
    assert ran.metric("coverage", labels=labels) == pytest.approx(1)
    declared = {metric.name: metric.unit for metric in read_manifest(SLAM_EVALUATE).metrics}
    assert {entry.name: entry.unit for entry in ran.report.metrics}.items() <= declared.items()
    if alignment == "sim3":
        assert ran.metric("scale", labels=labels) == pytest.approx(2)
    assert {entry.unit for entry in ran.report.metrics if entry.name.startswith("ate_rotation")} == {"deg"}


@slow_with_packages
@pytest.mark.usefixtures("_evo")
def test_drift_is_measured_per_metre_and_per_second(tmp_path: Path) -> None:
    """At 1 m/s, both are the tenth by which the estimate is too long; no two poses are 100 m apart."""
    files = {REFERENCE: GOOD, ESTIMATE: square(scale=1.1)}
    ran = evaluate(tmp_path, files, alignment="origin", deltas="1 s, 5 s, 100 m")
    labels = {**LABELS, "alignment": "origin"}
    for delta, drift_m in (("1 s", 0.1), ("5 s", 0.5)):
        assert ran.metric("rpe_median", labels={**labels, "delta": delta}) == pytest.approx(drift_m, abs=1e-4)
        assert ran.metric("rpe_rotation_max", labels={**labels, "delta": delta}) == pytest.approx(0, abs=1e-5)
    assert ran.metric("rpe_pairs", labels={**labels, "delta": "1 s"}) == 39
    assert [finding.message for finding in ran.report.findings] == [
        f"no two poses of {ESTIMATE} are 100 m apart: no relative error"
    ]


@slow_with_packages
@pytest.mark.usefixtures("_evo")
def test_a_topic_is_compared_with_transforms(tmp_path: Path, drive: Path) -> None:
    """The odometry of the sample has noise of 1 cm on each axis, its transforms have none."""
    files = {"drive.mcap": drive}
    ran = evaluate(tmp_path, files, reference="tf:odom->base_link", estimate="drive.mcap:/odom", alignment="none")
    assert ran.exit_code == 0, ran.log
    labels = {**LABELS, "estimate": "/odom", "reference": "tf:odom->base_link", "alignment": "none"}
    assert ran.metric("ate_rmse", labels=labels) == pytest.approx(0.01 * math.sqrt(2), rel=0.1)
    assert ran.metric("matched_poses", labels=labels) == pytest.approx(600, abs=2)


@slow_with_packages
@pytest.mark.usefixtures("_evo")
def test_files_of_kitti_are_compared_pose_by_pose(tmp_path: Path) -> None:
    rows = [f"1 0 0 {number} 0 1 0 {number % 3} 0 0 1 0\n" for number in range(30)]
    shifted = [f"1 0 0 {number + 2} 0 1 0 {number % 3} 0 0 1 0\n" for number in range(30)]
    files = {REFERENCE: "".join(rows).encode(), ESTIMATE: "".join(shifted).encode()}
    ran = evaluate(tmp_path, files, alignment="none")
    labels = {**LABELS, "alignment": "none"}
    assert ran.metric("ate_max", labels=labels) == pytest.approx(2)
    assert ran.metric("rpe_max", labels={**labels, "delta": "1 m"}) == pytest.approx(0)
    assert [finding.code for finding in ran.report.findings] == ["trajectory.pairs"]  # per second


@slow_with_packages
@pytest.mark.usefixtures("_evo")
def test_kitti_files_of_different_length_are_refused(tmp_path: Path) -> None:
    row = b"1 0 0 7 0 1 0 8 0 0 1 9\n"
    refusal = refusal_of(evaluate(tmp_path, {REFERENCE: row * 3, ESTIMATE: row * 2}))
    assert refusal == f"{ESTIMATE}: has 2 poses without stamps, but the reference {REFERENCE} has 3"


@slow_with_packages
@pytest.mark.usefixtures("_evo")
def test_poses_that_match_nothing_or_do_not_determine_an_alignment(tmp_path_factory: pytest.TempPathFactory) -> None:
    between = evaluate(tmp_path_factory.mktemp("a"), {REFERENCE: GOOD, ESTIMATE: square(delay_s=0.05)})
    assert (
        refusal_of(between) == f"{ESTIMATE}: no pose has a pose of the reference {REFERENCE} within 0.01 s (tolerance)"
    )
    still = "".join(line(number / 10) for number in range(400)).encode()
    resting = evaluate(tmp_path_factory.mktemp("b"), {REFERENCE: GOOD, ESTIMATE: still})
    assert "its 400 matched poses lie on a line or in a point, which determines no alignment by se3" in refusal_of(
        resting
    )


@slow_with_packages
@pytest.mark.usefixtures("_evo")
def test_one_unusable_file_of_several_is_a_finding_and_rare_matches_are_a_warning(tmp_path: Path) -> None:
    sparse = b"".join(GOOD.splitlines(keepends=True)[::5]) + square(delay_s=0.05).partition(b"\n")[2]
    rows = sorted(sparse.splitlines(keepends=True))
    files: dict[str, Path | bytes] = {REFERENCE: GOOD, "derived/a.tum": b"".join(rows), "derived/b.tum": b"broken\n"}
    ran = evaluate(tmp_path, files)
    assert ran.exit_code == 0, ran.log
    assert {(finding.code, finding.severity.value) for finding in ran.report.findings} == {
        ("trajectory.unusable", "error"),
        ("trajectory.matches", "warning"),
    }
    assert ran.verdict is Verdict.bad
    assert {entry.labels["estimate"] for entry in ran.report.metrics} == {"derived/a.tum"}
