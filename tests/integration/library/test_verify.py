"""`verify`: the checks of a mission by content, as a run makes them; what cannot be checked is said in one sentence."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import pytest

from kleinkram.action.testing import TryOutResult, try_out
from kleinkram.client.actions import read_manifest
from kleinkram.contract.access import Right
from kleinkram.contract.actions import Network
from kleinkram.contract.checks import CheckStatus, Verdict
from kleinkram.contract.reports import Severity
from kleinkram.recordings.sample import Defect, Faults, SampleFormat, generate_mission
from tests.integration.library.packages import LIBRARY

VERIFY = LIBRARY / "verify.py"
RULES = """
version: 1
profiles:
- name: vehicle
  when: {robot: vehicle}
  files: {"*.txt": {count: 1}}
  topics: {/imu/data: {rate: 200 Hz}}
  images: {/camera/*: {}}
"""


def mission_files(folder: Path, *defects: Defect) -> dict[str, Path | bytes]:
    faults = Faults(defects=frozenset(defects))
    generate_mission(folder, duration_s=3, size_bytes=3_000_000, formats=[SampleFormat.mcap], faults=faults)
    return {"drive.mcap": folder / "drive.mcap", "notes.txt": b"Sunny.\n"}


def verify(
    folder: Path, files: Mapping[str, Path | bytes], checks: str | None = RULES, robot: str = "vehicle"
) -> TryOutResult:
    (folder / "run").mkdir()
    return try_out(VERIFY, folder / "run", files=files, metadata={"robot": robot}, checks=checks)


def test_a_good_mission_passes_all_checks(tmp_path: Path) -> None:
    ran = verify(tmp_path, mission_files(tmp_path))
    assert ran.exit_code == 0, ran.log
    assert (ran.verdict, ran.report.verdict) == (Verdict.good, Verdict.good)
    assert {check.name for check in ran.report.checks} >= {"file.count", "topic.rate", "image.black"}
    assert {check.status for check in ran.report.checks} == {CheckStatus.ok}
    assert "Nothing was sent: this run has no access to the server." in ran.log
    with (ran.out / "checks.csv").open(newline="") as stream:
        rows = [*csv.DictReader(stream)]
    assert [(row["name"], row["topic"], row["status"]) for row in rows] == [
        (check.name, check.topic or "", check.status.value) for check in ran.report.checks
    ]
    assert [preview.path for preview in ran.report.previews] == ["checks.csv"]


def test_a_black_camera_is_found_by_content(tmp_path: Path) -> None:
    ran = verify(tmp_path, mission_files(tmp_path, Defect.black_camera))
    assert ran.exit_code == 0, ran.log
    assert ran.verdict is Verdict.bad
    assert ran.statuses("image.black") == {CheckStatus.error}
    assert ran.statuses("topic.rate") == {CheckStatus.ok}
    assert "The verdict is bad" in ran.log


def test_a_file_that_is_no_recording_counts_as_a_file(tmp_path: Path) -> None:
    files = mission_files(tmp_path)
    del files["notes.txt"]
    ran = verify(tmp_path, files)
    assert ran.verdict is Verdict.bad
    assert ran.statuses("file.missing") == {CheckStatus.error}


def test_a_damaged_recording_hides_no_other(tmp_path: Path) -> None:
    files = mission_files(tmp_path)
    ran = verify(tmp_path, {**files, "broken.mcap": b"These are notes.\n"})
    assert ran.exit_code == 0, ran.log
    assert ran.verdict is Verdict.warnings
    assert ran.statuses("recording.incomplete") == {CheckStatus.not_made}
    assert CheckStatus.ok in ran.statuses("image.black")


@pytest.mark.parametrize(
    ("checks", "robot", "reason"),
    [
        (None, "vehicle", "the project has no checks.yaml; `klein checks set` sets it"),
        (RULES, "legged", "no profile of the checks.yaml applies to the mission (vehicle: robot is legged; it must be"),
    ],
)
def test_without_rules_for_the_mission_nothing_is_judged(
    tmp_path: Path, checks: str | None, robot: str, reason: str
) -> None:
    ran = verify(tmp_path, {"notes.txt": b"Sunny.\n"}, checks, robot)
    assert ran.exit_code == 0, ran.log
    assert ran.verdict is None
    (finding,) = ran.report.findings
    assert (finding.severity, finding.code) == (Severity.info, "checks.none")
    assert finding.message.startswith(f"Nothing was checked: {reason}")
    assert not ran.report.checks


def test_rules_that_this_version_cannot_read_fail_with_line_and_column(tmp_path: Path) -> None:
    ran = verify(tmp_path, {"notes.txt": b"Sunny.\n"}, "version: 1\nprofiles:\n- smells: {}\n")
    assert ran.exit_code == 1
    assert ran.log.startswith("The checks.yaml of the project (version 1) cannot be read here.")
    assert "line 3" in ran.log
    assert "Traceback" not in ran.log


def test_the_script_describes_itself() -> None:
    manifest = read_manifest(VERIFY)
    assert (manifest.name, manifest.dependencies) == ("verify", ["open-kleinkram[reading]"])
    assert (manifest.network, manifest.right) == (Network.api, Right.create)  # it sends the report of the checks
    assert manifest.inputs.checks
    assert not manifest.inputs.derived
