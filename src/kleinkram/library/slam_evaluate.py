# /// script
# requires-python = ">=3.11"
# dependencies = ["open-kleinkram", "evo==1.38.1"]
#
# [tool.kleinkram]
# name = "slam-evaluate"
# description = "Absolute and relative errors (ATE, RPE) of trajectories against a reference, by evo."
# metrics = [
#   {name = "ate_rmse", unit = "m", better = "lower", description = "absolute error, translation"},
#   {name = "ate_mean", unit = "m", better = "lower", description = "absolute error, translation"},
#   {name = "ate_median", unit = "m", better = "lower", description = "absolute error, translation"},
#   {name = "ate_std", unit = "m", better = "lower", description = "absolute error, translation"},
#   {name = "ate_min", unit = "m", better = "lower", description = "absolute error, translation"},
#   {name = "ate_max", unit = "m", better = "lower", description = "absolute error, translation"},
#   {name = "ate_rotation_rmse", unit = "deg", better = "lower", description = "absolute error, angle"},
#   {name = "ate_rotation_mean", unit = "deg", better = "lower", description = "absolute error, angle"},
#   {name = "ate_rotation_median", unit = "deg", better = "lower", description = "absolute error, angle"},
#   {name = "ate_rotation_std", unit = "deg", better = "lower", description = "absolute error, angle"},
#   {name = "ate_rotation_min", unit = "deg", better = "lower", description = "absolute error, angle"},
#   {name = "ate_rotation_max", unit = "deg", better = "lower", description = "absolute error, angle"},
#   {name = "rpe_rmse", unit = "m", better = "lower", description = "relative error over delta, translation"},
#   {name = "rpe_mean", unit = "m", better = "lower", description = "relative error over delta, translation"},
#   {name = "rpe_median", unit = "m", better = "lower", description = "relative error over delta, translation"},
#   {name = "rpe_std", unit = "m", better = "lower", description = "relative error over delta, translation"},
#   {name = "rpe_min", unit = "m", better = "lower", description = "relative error over delta, translation"},
#   {name = "rpe_max", unit = "m", better = "lower", description = "relative error over delta, translation"},
#   {name = "rpe_rotation_rmse", unit = "deg", better = "lower", description = "relative error over delta, angle"},
#   {name = "rpe_rotation_mean", unit = "deg", better = "lower", description = "relative error over delta, angle"},
#   {name = "rpe_rotation_median", unit = "deg", better = "lower", description = "relative error over delta, angle"},
#   {name = "rpe_rotation_std", unit = "deg", better = "lower", description = "relative error over delta, angle"},
#   {name = "rpe_rotation_min", unit = "deg", better = "lower", description = "relative error over delta, angle"},
#   {name = "rpe_rotation_max", unit = "deg", better = "lower", description = "relative error over delta, angle"},
#   {name = "coverage", better = "higher", description = "matched span as a share of the reference's"},
#   {name = "matched_poses"},
#   {name = "estimate_poses"},
#   {name = "rpe_pairs"},
#   {name = "estimate_path_length", unit = "m"},
#   {name = "reference_path_length", unit = "m"},
#   {name = "scale"},
# ]
# resources = {cores = 1, memory = "2GB", disk = "1GB", time = "1h"}
#
# [tool.kleinkram.inputs]
# derived = true
# reference = true
# paths = [
#   "*.tum", "*.txt", "*.csv",
#   "*.mcap", "*.bag", "*.db3", "*.mcap.zst*", "*.db3.zst*", "*.bag.zst*", "*metadata.yaml",
# ]
#
# [[tool.kleinkram.parameters]]
# name = "estimate"
# type = "string"
# default = "derived/*.tum"
# description = "Files (a glob), a topic such as /odom, or transforms such as tf:map->base_link."
#
# [[tool.kleinkram.parameters]]
# name = "reference"
# type = "string"
# default = ""
# description = "One file, topic or pair of frames; by default the reference of the mission or its project."
#
# [[tool.kleinkram.parameters]]
# name = "alignment"
# type = "choice"
# choices = ["se3", "sim3", "yaw", "origin", "none"]
# default = "se3"
# description = "How the estimate is moved onto the reference: sim3 also scales, yaw turns about z only."
#
# [[tool.kleinkram.parameters]]
# name = "tolerance"
# type = "number"
# unit = "s"
# minimum = 0
# default = 0.01
# description = "Poses whose stamps differ by at most this are compared."
#
# [[tool.kleinkram.parameters]]
# name = "deltas"
# type = "string"
# default = "1 m, 1 s"
# description = "Over what the relative error is measured: metres of the path, seconds, or frames."
# ///
"""Absolute trajectory error (ATE) and relative pose error (RPE) of estimates against a reference.

All numbers are those of evo 1.38.1, except two things that it does not have: alignment by yaw, and pairs of poses that
are seconds apart. evo is under the GPL-3.0; it is installed for a run and not part of Kleinkram.

Source: J. Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", 2012; Z. Zhang and D. Scaramuzza, "A
Tutorial on Quantitative Trajectory Evaluation", 2018 (alignment by yaw, equation 12).
"""

import csv
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kleinkram.action import context, out, parameters, progress, report, scratch
from kleinkram.library.inputs import (
    InputRecording,
    InputTrajectory,
    input_recordings,
    read_trajectories,
    read_trajectory,
)
from kleinkram.recordings import RecordingError
from kleinkram.recordings.trajectories import Trajectory, TrajectoryRefused

STATISTICS = ("rmse", "mean", "median", "std", "min", "max")
NS = 10**9
LEAST_MATCHED = 0.5
DELTA_TOLERANCE = 0.1  # as evo's `rel_delta_tol`
END_TOLERANCE = 0.01  # the last pose ends a pair only if it is late enough
LONGEST_LABEL = 200
UNITS = {"m": "m", "s": "s", "frame": "frames", "frames": "frames"}
DELTA = re.compile(r"(\d+(?:\.\d+)?)\s*(m|s|frames?)")

Pairs = Sequence[tuple[int, int]]


class Delta(NamedTuple):
    """What lies between the two poses of a pair. `unit`: m, s or frames; `text`: as it was written."""

    value: float
    unit: str
    text: str


@dataclass(frozen=True)
class EvaluationOptions:
    """The parameters of the run."""

    alignment: str
    tolerance_s: float
    deltas: tuple[Delta, ...]


@dataclass(frozen=True)
class Result:
    """The errors of one estimate. `times_s`: of the matched poses since the first; their numbers, without stamps."""

    name: str
    times_s: Any
    errors_m: Any
    estimate_xyz: Any
    reference_xyz: Any


def main() -> None:
    """Evaluate all estimates; exit with 1 and a sentence if none can be, or there is no reference."""
    try:
        evaluate_all()
    except RecordingError as error:
        report.finding("error", "trajectory.unusable", str(error)[:2000])
        sys.exit(str(error))


def evaluate_all() -> None:
    """Compare all estimates, report the numbers, and draw them; of several, an unusable one becomes a finding."""
    options = read_options()
    recordings = input_recordings()
    reference = read_reference(recordings)
    candidates = read_trajectories(str(parameters()["estimate"]).strip(), recordings)
    candidates = [candidate for candidate in candidates if not is_same(candidate, reference)]
    if not candidates:
        raise TrajectoryRefused(name_of(reference), "is the reference itself; name another estimate")
    results: list[Result] = []
    for number, candidate in enumerate(candidates):
        progress(0.1 + 0.8 * number / len(candidates), name_of(candidate)[:200])
        try:
            if isinstance(candidate, TrajectoryRefused):
                raise candidate
            results.append(evaluate(candidate.trajectory, reference.trajectory, options))
        except TrajectoryRefused as refusal:
            if len(candidates) == 1:
                raise
            report.finding("error", "trajectory.unusable", str(refusal)[:2000])
    if not results:
        raise TrajectoryRefused(str(parameters()["estimate"]), "none of these files can be evaluated; see the findings")
    progress(0.9, "Drawing")
    write_errors(out / "errors.csv", results)
    for path, title in ((out / "trajectories.png", "Trajectories"), (out / "errors.png", "Absolute error over time")):
        (draw_paths if path.stem == "trajectories" else draw_errors)(path, results)
        report.preview(path, title)


def read_options() -> EvaluationOptions:
    """Return the parameters. Raises TrajectoryRefused for a delta that cannot be read."""
    values = parameters()
    deltas = []
    for text in str(values["deltas"]).split(","):
        match = DELTA.fullmatch(text.strip())
        if match is None or float(match[1]) <= 0 or (match[2].startswith("f") and "." in match[1]):
            raise TrajectoryRefused(
                "deltas", f"{text.strip()!r} is none: write metres, seconds or frames, as in 1 m, 1 s"
            )
        unit = UNITS[match[2]]
        deltas.append(Delta(float(match[1]), unit, f"{float(match[1]):g} {match[2]}"))
    return EvaluationOptions(str(values["alignment"]), float(values["tolerance"]), tuple(deltas))


def read_reference(recordings: Sequence[InputRecording]) -> InputTrajectory:
    """Return the reference that the parameter, or else the mission or its project names. Raises TrajectoryRefused."""
    source = str(parameters()["reference"]).strip() or context().reference
    if source is None:
        raise TrajectoryRefused(
            "reference",
            f"the mission {context().mission.name} names none: set its metadata field reference, the key reference of "
            "a profile in the project's checks.yaml, or the parameter, to a file, a topic such as /odom, or transforms "
            "such as tf:map->base_link",
        )
    try:
        return read_trajectory(source, recordings)
    except TrajectoryRefused as refusal:
        raise TrajectoryRefused(f"reference {refusal.name}", refusal.reason) from None


def name_of(candidate: InputTrajectory | TrajectoryRefused) -> str:
    """Return the name of an estimate, whether it can be used or not."""
    return candidate.name if isinstance(candidate, TrajectoryRefused) else candidate.trajectory.name


def is_same(candidate: InputTrajectory | TrajectoryRefused, reference: InputTrajectory) -> bool:
    """Return whether an estimate is the reference: its error would be 0."""
    return name_of(candidate) == name_of(reference) and getattr(candidate, "paths", ()) == reference.paths


def check_comparable(estimate: Trajectory, reference: Trajectory) -> None:
    """Raise TrajectoryRefused unless the two overlap in time, or both have no stamps and the same number of poses."""
    own, other = estimate.stamps_ns, reference.stamps_ns
    if own is None and other is None:
        if len(estimate) != len(reference):
            reason = (
                f"has {len(estimate)} poses without stamps, but the reference {reference.name} has {len(reference)}"
            )
            raise TrajectoryRefused(estimate.name, reason)
        return
    if own is None or other is None:
        without, with_stamps = (estimate, reference) if own is None else (reference, estimate)
        reason = f"has no stamps, so it cannot be compared with {with_stamps.name}, which has"
        raise TrajectoryRefused(without.name, reason)
    tolerance_ns = round(float(parameters()["tolerance"]) * NS)
    if own[0] > other[-1] + tolerance_ns or own[-1] < other[0] - tolerance_ns:
        gap_ns = max(int(own[0]) - int(other[-1]), int(other[0]) - int(own[-1]))
        side = "after" if own[0] > other[-1] else "before"
        raise TrajectoryRefused(
            estimate.name,
            f"does not overlap in time with the reference {reference.name}: it is {gap_ns / NS:.3f} s {side} it "
            f"({span_text(estimate)} and {span_text(reference)}, in seconds)",
        )


def span_text(trajectory: Trajectory) -> str:
    """Return the first and the last stamp in seconds."""
    if trajectory.stamps_ns is None:
        return "no stamps"
    return " to ".join(f"{int(trajectory.stamps_ns[at]) / NS:.3f}" for at in (0, -1))


def evaluate(estimate: Trajectory, reference: Trajectory, options: EvaluationOptions) -> Result:
    """Compare two trajectories and report the numbers.

    Raises:
        TrajectoryRefused: they cannot be compared, no poses match, or these do not determine the alignment.
    """
    check_comparable(estimate, reference)
    from evo.core import metrics

    matched_reference, matched = associated(estimate, reference, options.tolerance_s)
    scale = aligned(estimate.name, matched, matched_reference, options.alignment)
    labels = {
        "estimate": estimate.name[-LONGEST_LABEL:],
        "reference": reference.name[-LONGEST_LABEL:],
        "alignment": options.alignment,
        "tolerance": f"{options.tolerance_s:g} s",
    }
    report_sizes(estimate, reference, matched, labels)
    if options.alignment == "sim3":
        report.metric("scale", scale, labels=labels)
    data = (matched_reference, matched)
    for prefix, unit, relation in (
        ("ate", "m", metrics.PoseRelation.translation_part),
        ("ate_rotation", "deg", metrics.PoseRelation.rotation_angle_deg),
    ):
        absolute = metrics.APE(relation)
        absolute.process_data(data)
        report_statistics(prefix, unit, absolute, labels)
        if prefix == "ate":
            errors_m = absolute.error
    for delta in options.deltas:
        report_relative(estimate.name, data, delta, labels)
    times = np.asarray(getattr(matched, "timestamps", np.arange(matched.num_poses)), dtype=float)
    print(f"{estimate.name}: ATE {np.sqrt(np.mean(errors_m**2)):.6f} m (rmse) of {matched.num_poses} poses", flush=True)
    return Result(
        estimate.name, times - times[0], errors_m, matched.positions_xyz.copy(), matched_reference.positions_xyz.copy()
    )


def associated(estimate: Trajectory, reference: Trajectory, tolerance_s: float) -> tuple[Any, Any]:
    """Return the poses of reference and estimate that belong together, as trajectories of evo."""
    from evo.core import sync

    if estimate.stamps_ns is None:
        return as_evo(reference), as_evo(estimate)
    try:
        pair: tuple[Any, Any] = sync.associate_trajectories(as_evo(reference), as_evo(estimate), max_diff=tolerance_s)
    except sync.SyncException:
        reason = f"no pose has a pose of the reference {reference.name} within {tolerance_s:g} s (tolerance)"
        raise TrajectoryRefused(estimate.name, reason) from None
    possible = min(len(estimate), len(reference))
    if pair[0].num_poses < LEAST_MATCHED * possible:
        report.finding(
            "warning",
            "trajectory.matches",
            f"only {pair[0].num_poses} of {possible} poses of {estimate.name} have a pose of {reference.name} within "
            f"{tolerance_s:g} s: the numbers are of these",
        )
    return pair


def as_evo(trajectory: Trajectory) -> Any:
    """Return a trajectory of evo: stamps are float seconds there."""
    from evo.core.trajectory import PosePath3D, PoseTrajectory3D

    quaternions = trajectory.orientations[:, [3, 0, 1, 2]]
    if trajectory.stamps_ns is None:
        return PosePath3D(trajectory.positions.copy(), quaternions)
    # Python's division of integers is exact to the last digit; numpy's would round the nanoseconds first.
    stamps_s = np.array([stamp_ns / NS for stamp_ns in trajectory.stamps_ns.tolist()])
    return PoseTrajectory3D(trajectory.positions.copy(), quaternions, stamps_s)


def aligned(name: str, estimate: Any, reference: Any, alignment: str) -> float:
    """Move an estimate onto the reference, in place; return the factor that it was scaled by.

    Raises:
        TrajectoryRefused: the matched poses do not determine the alignment.
    """
    from evo.core import lie_algebra
    from evo.core.geometry import GeometryException

    if alignment == "origin":
        estimate.align_origin(reference)
    elif alignment == "yaw":
        rotation, translation = yaw_alignment(estimate.positions_xyz, reference.positions_xyz)
        estimate.transform(lie_algebra.se3(rotation, translation))
    elif alignment in ("se3", "sim3"):
        try:
            _, _, scale = estimate.align(reference, correct_scale=alignment == "sim3")
        except GeometryException:
            reason = (
                f"its {estimate.num_poses} matched poses lie on a line or in a point, which determines no alignment"
            )
            raise TrajectoryRefused(name, f"{reason} by {alignment}; yaw, origin and none need less") from None
        return float(scale)
    return 1.0


def yaw_alignment(points: Any, targets: Any) -> tuple[Any, Any]:
    """Return the rotation about z and the translation that move points onto targets, by least squares."""
    centred, onto = points - points.mean(axis=0), targets - targets.mean(axis=0)
    sine = (centred[:, 0] * onto[:, 1] - centred[:, 1] * onto[:, 0]).sum()
    cosine = (centred[:, 0] * onto[:, 0] + centred[:, 1] * onto[:, 1]).sum()
    angle = np.arctan2(sine, cosine)
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    return rotation, targets.mean(axis=0) - rotation @ points.mean(axis=0)


def report_sizes(estimate: Trajectory, reference: Trajectory, matched: Any, labels: Mapping[str, str]) -> None:
    """Report how much was compared."""
    report.metric("matched_poses", matched.num_poses, labels=labels)
    report.metric("estimate_poses", len(estimate), labels=labels)
    report.metric("estimate_path_length", estimate.length_m, unit="m", labels=labels)
    report.metric("reference_path_length", reference.length_m, unit="m", labels=labels)
    stamps_ns = reference.stamps_ns
    if stamps_ns is not None and len(stamps_ns) > 1:
        covered_s = matched.timestamps[-1] - matched.timestamps[0]
        report.metric("coverage", covered_s / (int(stamps_ns[-1] - stamps_ns[0]) / NS), labels=labels)


def report_statistics(prefix: str, unit: str, error: Any, labels: Mapping[str, str]) -> None:
    """Report the statistics of an error of evo."""
    values = error.get_all_statistics()
    for statistic in STATISTICS:
        report.metric(f"{prefix}_{statistic}", float(values[statistic]), unit=unit, labels=labels)


def report_relative(name: str, data: tuple[Any, Any], delta: Delta, labels: Mapping[str, str]) -> None:
    """Report the relative error of the pairs of poses that are `delta` apart, in translation and rotation."""
    from evo.core import lie_algebra, metrics

    reference, estimate = data
    pairs = pairs_of(estimate, delta)
    if not pairs:
        report.finding(
            "warning", "trajectory.pairs", f"no two poses of {name} are {delta.text} apart: no relative error"
        )
        return
    with_delta = {**labels, "delta": delta.text}
    relative = [
        metrics.RPE.rpe_base(
            reference.poses_se3[one], reference.poses_se3[other], estimate.poses_se3[one], estimate.poses_se3[other]
        )
        for one, other in pairs
    ]
    translation, rotation = metrics.RPE(), metrics.RPE(metrics.PoseRelation.rotation_angle_deg)
    translation.error = np.array([np.linalg.norm(pose[:3, 3]) for pose in relative])
    rotation.error = np.array([abs(lie_algebra.so3_log_angle(pose[:3, :3], True)) for pose in relative])
    report.metric("rpe_pairs", len(pairs), labels=with_delta)
    report_statistics("rpe", "m", translation, with_delta)
    report_statistics("rpe_rotation", "deg", rotation, with_delta)


def pairs_of(estimate: Any, delta: Delta) -> Pairs:
    """Return the indices of consecutive pairs that are `delta` apart; none if there are none."""
    from evo.core import filters, metrics
    from evo.core.units import Unit

    if delta.unit == "s":
        return pairs_by_time(estimate.timestamps, delta.value) if hasattr(estimate, "timestamps") else []
    unit = Unit.meters if delta.unit == "m" else Unit.frames
    try:
        pairs: Pairs = metrics.id_pairs_from_delta(estimate.poses_se3, delta.value, unit, DELTA_TOLERANCE)
    except filters.FilterException:
        return []
    return pairs


def pairs_by_time(times_s: Any, delta_s: float) -> Pairs:
    """Return consecutive pairs of poses whose times differ by `delta_s`, to within a tenth of it.

    The second pose of a pair is the one nearest in time, and the first of the next pair.
    """
    pairs: list[tuple[int, int]] = []
    first = 0
    while first < len(times_s) - 1:
        target = times_s[first] + delta_s
        if times_s[-1] < target - END_TOLERANCE * delta_s:
            break
        after = int(np.clip(np.searchsorted(times_s, target), first + 1, len(times_s) - 1))
        nearest = after - 1 if after - 1 > first and target - times_s[after - 1] < times_s[after] - target else after
        if abs(times_s[nearest] - target) <= DELTA_TOLERANCE * delta_s:
            pairs.append((first, nearest))
            first = nearest
        else:
            first += 1
    return pairs


def write_errors(path: Path, results: Sequence[Result]) -> None:
    """Write the absolute error of each matched pose."""
    with path.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(["estimate", "time_s", "ate_m"])
        for result in results:
            rows = zip(result.times_s.tolist(), result.errors_m.tolist(), strict=True)
            table.writerows([result.name, f"{time_s:.9f}", repr(error_m)] for time_s, error_m in rows)


def pyplot() -> Any:
    """Return matplotlib's functions, which draw into files; its cache is the run's own."""
    os.environ.setdefault("MPLCONFIGDIR", str(scratch / "matplotlib"))
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as functions

    return functions


def draw_paths(path: Path, results: Sequence[Result]) -> None:
    """Draw the reference and the aligned estimates along the two axes in which the reference is longest."""
    figure, axes = pyplot().subplots(figsize=(7, 7), layout="constrained")
    extents = np.ptp(results[0].reference_xyz, axis=0)
    across, up = sorted(np.argsort(extents)[-2:].tolist())
    reference = max((result.reference_xyz for result in results), key=len)
    axes.plot(reference[:, across], reference[:, up], color="0.3", linestyle="--", linewidth=1.2, label="reference")
    for result in results:
        axes.plot(result.estimate_xyz[:, across], result.estimate_xyz[:, up], linewidth=1.2, label=result.name[-60:])
    axes.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]", aspect="equal")
    _finish(figure, axes, path)


def draw_errors(path: Path, results: Sequence[Result]) -> None:
    """Draw the absolute errors over time."""
    figure, axes = pyplot().subplots(figsize=(7, 4), layout="constrained")
    for result in results:
        axes.plot(result.times_s, result.errors_m, linewidth=1.2, label=result.name[-60:])
    axes.set(xlabel="time [s]", ylabel="absolute error [m]")
    axes.set_ylim(bottom=0)
    _finish(figure, axes, path)


def _finish(figure: Any, axes: Any, path: Path) -> None:
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
