"""Events reported by code in an action match the contract."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from kleinkram.action import progress, report, run_files
from kleinkram.action.events import ReportRefused
from kleinkram.contract.checks import Check, CheckStatus, Verdict
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


def test_checks_verdicts_and_metrics_of_topics_are_events() -> None:
    report.check("imu.gravity", "error", "9.1 instead of 9.81 m/s²", value=9.1, limit=9.81, unit="m/s²", topic="/imu")
    report.verdict("bad")
    report.metric("rate", 200, unit="Hz", topic="/imu/data", labels={"clock": "log"})
    check, verdict, metric = values()
    assert check.check == Check(
        name="imu.gravity",
        status=CheckStatus.error,
        message="9.1 instead of 9.81 m/s²",
        value=9.1,
        limit=9.81,
        unit="m/s²",
        topic="/imu",
    )
    assert verdict.verdict is Verdict.bad
    assert metric.metric is not None
    assert (metric.metric.topic, metric.metric.labels) == ("/imu/data", {"clock": "log"})


@pytest.mark.parametrize(
    ("say", "sentence"),
    [
        (
            lambda: report.metric("ate_rmse", float("nan")),
            "the value of the metric 'ate_rmse' is nan, which is not a finite number: "
            "report it as a finding or a failed check, or leave it out",
        ),
        (
            lambda: report.check("imu.gravity", "ok", "m", value=1, limit=float("-inf")),
            "the limit of the check 'imu.gravity' is -inf, which is not a finite number: "
            "report it as a finding or a failed check, or leave it out",
        ),
        (
            lambda: report.metric("rate/imu/data", 1),
            "the name 'rate/imu/data' of a metric: use at most 64 lower-case letters, digits and _ . -, beginning with "
            "a letter: 'rate.imu.data'",
        ),
        (
            lambda: report.check("gravity", "ok", "m"),
            "the name 'gravity' of a check: use two to four parts of lower-case letters, digits and _ -, joined by "
            "dots: 'imu.gravity'",
        ),
        (lambda: report.verdict("outdated"), "the verdict 'outdated': it is one of 'good', 'warnings' or 'bad'"),
        (
            lambda: report.metric("rate", 1, labels={"a": "x" * 300}),
            "the labels {'a': '" + "x" * 300 + "'} of a metric: it has more than 200 characters",
        ),
    ],
)
def test_a_refused_report_says_which_and_why(say: Callable[[], None], sentence: str) -> None:
    with pytest.raises(ReportRefused) as caught:
        say()
    assert str(caught.value) == sentence
    assert not (run_files.out / EVENTS_FILE).exists()


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
