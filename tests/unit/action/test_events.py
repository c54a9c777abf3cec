"""Events reported by code in an action match the contract."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from kleinkram.action import progress, report, run_files
from kleinkram.contract.reports import EVENTS_FILE, ReportEvent, Severity


@pytest.fixture(autouse=True)
def _folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, place in (("in_dir", "in"), ("out", "out")):
        (tmp_path / place).mkdir()
        monkeypatch.setattr(run_files, name, tmp_path / place)


def values() -> list[ReportEvent]:
    return [ReportEvent.model_validate_json(line) for line in (run_files.out / EVENTS_FILE).read_bytes().splitlines()]


def test_each_report_is_one_event() -> None:
    report.finding("warning", "imu.gap", "2 s without a message", file="a/drive.bag", topic="/imu", time_ns=17)
    report.metric("ate_rmse", 0.12, unit="m", file=run_files.in_dir / "a" / "drive.bag")
    report.preview(run_files.out / "track.png", "The way")
    report.propose(distance_m=12.5, sensors=["imu"])
    report.mission_file("a/slam.bag", derived_from=["a/drive.bag"])
    progress(0.5, "half")
    finding, metric, preview, metadata, created, half = values()
    assert finding.finding is not None
    assert (finding.finding.severity, finding.finding.file) == (Severity.warning, "a/drive.bag")
    assert metric.metric is not None
    assert (metric.metric.value, metric.metric.file) == (0.12, "a/drive.bag")
    assert preview.preview is not None
    assert preview.preview.path == "track.png"
    assert metadata.metadata == {"distance_m": 12.5, "sensors": ["imu"]}
    assert created.mission_file is not None
    assert (created.mission_file.path, created.mission_file.to) == ("a/slam.bag", "a/slam.bag")
    assert half.progress is not None
    assert half.progress.fraction == 0.5


def test_invalid_reports_are_refused_in_the_script() -> None:
    nonsense: list[Callable[[], None]] = [
        lambda: report.finding("fatal", "a", "b"),
        lambda: report.metric("a", float("inf")),
        lambda: report.metric("A name", 1),
        lambda: report.preview("/etc/passwd"),
        lambda: report.mission_file("../x"),
        lambda: progress(1.5),
        lambda: report.finding("info", "a", "b" * 3000),
        lambda: report.propose(notes="x" * 70_000),
    ]
    for say in nonsense:
        with pytest.raises(ValueError, match=r"."):
            say()
    assert not (run_files.out / EVENTS_FILE).exists()


def test_concurrent_reports_are_not_interleaved() -> None:
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda n: report.metric(f"m{n}", n, unit="x" * 30), range(500)))
    assert {event.metric.value for event in values() if event.metric} == set(range(500))
