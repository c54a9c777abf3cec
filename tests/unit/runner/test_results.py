"""Untrusted results of a run: links are not followed, and invalid files are reported."""

import errno
import os
from pathlib import Path

import pytest

from kleinkram.contract import reports
from kleinkram.contract.checks import CheckStatus, Verdict
from kleinkram.contract.reports import EVENTS_FILE, verdict_of_report
from kleinkram.contract.runs import EndReason
from kleinkram.runner import results
from kleinkram.runner.results import collect_results
from tests.memory import call_within


def test_artifacts_are_regular_files_below_out(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "deep").mkdir(parents=True)
    (out / "deep" / "track.csv").write_text("x")
    (tmp_path / "secret").write_text("not the run's")
    (out / "link").symlink_to(tmp_path / "secret")
    (out / "folder").symlink_to(tmp_path)
    (out / "new\nline").write_text("x")
    os.mkfifo(out / "pipe")
    result = collect_results(out)
    assert [artifact.path for artifact in result.artifacts] == ["deep/track.csv"]
    assert len(result.problems) == 4


def test_events_and_report_are_merged(tmp_path: Path) -> None:
    (tmp_path / ".kleinkram").mkdir()
    (tmp_path / EVENTS_FILE).write_text(
        '{"metric": {"name": "ate_rmse", "value": 1}}\nnonsense\n{"metadata": {"a": 1, "b": 1}}\n'
        '{"preview": {"path": "../../etc/passwd"}}\n{"preview": {"path": "gone.png"}}\n'
    )
    (tmp_path / "report.json").write_text('{"metrics": [{"name": "ate_rmse", "value": 2}], "metadata": {"b": 2}}')
    result = collect_results(tmp_path)
    assert result.report_error is None
    assert (result.losses, result.first_loss) == (2, result.problems[0])
    assert [metric.value for metric in result.report.metrics] == [2]
    assert result.report.metadata == {"a": 1, "b": 2}
    assert result.report.previews == []
    assert [problem.partition(":")[0] for problem in result.problems] == [
        "Line 2 of events.jsonl is no event",
        "Line 4 of events.jsonl is no event",
        "It reports the artifact gone.png, which does not exist.",
    ]


def test_checks_and_verdicts_are_merged_and_metrics_differ_by_topic_and_labels(tmp_path: Path) -> None:
    (tmp_path / ".kleinkram").mkdir()
    (tmp_path / EVENTS_FILE).write_text(
        '{"check": {"name": "imu.gravity", "status": "ok", "message": "9.81"}}\n{"verdict": "good"}\n'
        '{"metric": {"name": "rate", "value": 1, "topic": "/a"}}\n'
        '{"metric": {"name": "rate", "value": 2, "topic": "/b"}}\n'
        '{"metric": {"name": "rate", "value": 3, "topic": "/b"}}\n'
        '{"metric": {"name": "rate", "value": 4, "labels": {"method": "x"}}}\n'
    )
    (tmp_path / "report.json").write_text(
        '{"verdict": "warnings", "checks": [{"name": "topic.gap", "status": "error", "message": "2 s"}]}'
    )
    result = collect_results(tmp_path)
    assert result.problems == []
    assert [check.name for check in result.report.checks] == ["imu.gravity", "topic.gap"]
    assert [metric.value for metric in result.report.metrics] == [1, 3, 4]
    assert result.report.verdict is Verdict.warnings
    assert verdict_of_report(result.report) is Verdict.bad


def test_nan_in_a_report_is_answered_with_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text('{"metrics": [{"name": "ate", "value": NaN}]}')
    assert collect_results(tmp_path).report_error == (
        'report.json is not a report: "metrics.0.value": it must be a finite number.'
    )


def test_the_worst_of_too_many_checks_and_findings_are_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "MAX_CHECKS", 100)
    monkeypatch.setattr(reports, "MAX_FINDINGS", 100)
    (tmp_path / ".kleinkram").mkdir()
    fine = '{"check": {"name": "topic.gap", "status": "ok", "message": "m"}}\n'
    info = '{"finding": {"severity": "info", "code": "a", "message": "m"}}\n'
    bad = '{"check": {"name": "topic.rate", "status": "error", "message": "m"}}\n'
    error = '{"finding": {"severity": "error", "code": "b", "message": "m"}}\n'
    (tmp_path / EVENTS_FILE).write_text(fine * 100 + bad + info * 100 + error)
    result = collect_results(tmp_path)
    sent = result.final_report(EndReason.done).checks
    assert (len(sent), sent[0].name, sent[-1].name) == (100, "topic.rate", "report.incomplete")
    assert (len(result.report.checks), result.report.checks[0].name) == (100, "topic.rate")
    assert (len(result.report.findings), result.report.findings[0].code) == (100, "b")
    assert result.problems == [
        "It reported 101 checks; only the 100 worst are stored.",
        "It reported 101 findings; only the 100 worst are stored.",
    ]


_GRAVITY = '{"check": {"name": "imu.gravity", "status": "ok", "message": "9.81"}}\n'


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            '{"check": {"name": "Gravity", "status": "error", "message": "0"}}\n',
            'Part of the report is missing. Line 2 of events.jsonl is no event: "check.name": ',
        ),
        (
            '{"check": {"name": "imu.still", "status": "error", "message": "m", "value": NaN}}\nx\n{"progress": 1}\n',
            'Part of the report is missing. Line 2 of events.jsonl is no event: "check.value": '
            "it must be a finite number. And 1 more.",
        ),
        ('{"progress": 1, "check": 2}\n', "Part of the report is missing. Line 2 of events.jsonl is no event: "),
        ('{"finding": ' + '"\\u0000"' * 9_000, "Part of the report is missing. Line 2 of events.jsonl is no event: "),
        ('{"' + "x" * 9_000 + '": 1}', "Part of the report is missing. Line 2 of events.jsonl is no event: "),
    ],
)
def test_a_report_with_lost_events_is_never_good(tmp_path: Path, lines: str, message: str) -> None:
    (tmp_path / ".kleinkram").mkdir()
    (tmp_path / EVENTS_FILE).write_text(_GRAVITY + lines)
    (tmp_path / "report.json").write_text('{"verdict": "good"}')
    result = collect_results(tmp_path)
    report = result.final_report(EndReason.done)
    assert [check.name for check in report.checks] == ["imu.gravity", "report.incomplete"]
    assert report.checks[1].status is CheckStatus.not_made
    assert report.checks[1].message.startswith(message)
    assert verdict_of_report(report) is Verdict.warnings
    assert result.final_report(EndReason.exit_code) == result.report


@pytest.mark.parametrize("lines", ["", "\n\n", '{"progress": {"fraction": 1.01}}\n{"progress": {"fraction": NaN}}\n'])
def test_invalid_progress_and_empty_lines_lose_nothing_of_the_report(tmp_path: Path, lines: str) -> None:
    (tmp_path / ".kleinkram").mkdir()
    (tmp_path / EVENTS_FILE).write_text(lines + _GRAVITY)
    (tmp_path / "link").symlink_to("nowhere")
    result = collect_results(tmp_path)
    assert len(result.problems) == 1 + lines.count("progress")
    assert verdict_of_report(result.final_report(EndReason.done)) is Verdict.good


def test_events_that_cannot_be_read_make_the_report_incomplete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    (out / ".kleinkram").mkdir(parents=True)
    (out / "report.json").write_text('{"verdict": "good"}')
    (tmp_path / "elsewhere").write_text(_GRAVITY)

    def message() -> str:
        (check,) = collect_results(out).final_report(EndReason.done).checks
        assert (check.name, check.status) == ("report.incomplete", CheckStatus.not_made)
        return check.message

    (out / EVENTS_FILE).symlink_to(tmp_path / "elsewhere")
    assert "events.jsonl cannot be read" in message()
    (out / EVENTS_FILE).unlink()
    (out / EVENTS_FILE).write_text(_GRAVITY)
    monkeypatch.setattr(results, "_MAX_EVENTS_BYTES", 10)
    assert "events.jsonl has more than 10 bytes." in message()
    (out / EVENTS_FILE).unlink()
    (out / ".kleinkram").rmdir()
    (out / ".kleinkram").symlink_to(tmp_path)
    assert "events.jsonl cannot be read" in message()


def test_a_report_that_is_a_link_is_broken(tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text("{}")
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.json").symlink_to(tmp_path / "other.json")
    assert "cannot be read" in (collect_results(out).report_error or "")
    (out / "report.json").unlink()
    os.mkfifo(out / "report.json")
    assert "not a regular file" in (collect_results(out).report_error or "")


def test_links_are_counted_and_ignored(tmp_path: Path) -> None:
    (tmp_path / "track.csv").write_text("x")
    for number in range(4000):
        (tmp_path / f"{number}").symlink_to("track.csv")
    # Sentences, or entries of the folder, for all of them would be more.
    result = call_within(200_000, lambda: collect_results(tmp_path))
    assert [artifact.path for artifact in result.artifacts] == ["track.csv"]
    assert (len(result.problems), result.problems[-1]) == (101, "And 3900 more.")


def test_the_number_of_entries_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "_MAX_ENTRIES", 150)
    for number in range(200):
        (tmp_path / f"{number}").symlink_to("nowhere")
    result = collect_results(tmp_path)
    assert result.problems[0] == "It left more than 150 files, folders and links: the others were not read."
    assert result.problems[-1] == "And 50 more."


def test_results_that_cannot_be_read_at_the_moment_are_not_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "track.csv").write_text("x")
    scandir = os.scandir

    def fail(path: str) -> object:
        if path.endswith("deep"):
            raise OSError(errno.ESTALE, "Stale file handle")
        return scandir(path)

    monkeypatch.setattr(os, "scandir", fail)
    with pytest.raises(OSError, match="Stale file handle"):
        collect_results(tmp_path)
