"""A run from its claim to its end, as the server sees it."""

from __future__ import annotations

import pytest

from kleinkram.contract.actions import Network
from kleinkram.contract.checks import Verdict
from kleinkram.contract.reports import verdict_of_report
from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner.executors import process_sandbox
from tests.integration.runner_loop.conftest import Runners, ended
from tests.integration.runner_loop.fake_server import FakeServer


def test_artifacts_report_and_log_of_a_run_are_stored(server: FakeServer, runners: Runners) -> None:
    runners.start()
    run = server.launch(
        "from kleinkram.action import inputs, out, report, context\n"
        "report.metric('size', 3, unit='B')\n"
        "(out / 'deep').mkdir()\n"
        "(out / 'deep' / 'copy').write_bytes((out.parent / 'in' / 'a' / 'drive.bag').read_bytes())\n"
        "print(context().mission.name)\n",
        {"a/drive.bag": b"bytes of a drive"},
    )
    finish = ended(run).finishes[0]
    assert (finish.reason, finish.exit_code, finish.problems) == (EndReason.done, 0, [])
    assert run.artifacts == {"deep/copy": b"bytes of a drive", LOG_PATH: b"a-mission\n"}
    assert [metric.name for metric in finish.report.metrics] == ["size"]
    assert finish.usage is not None
    assert RunState.running in run.states


def test_a_report_of_many_megabytes_arrives_whole(server: FakeServer, runners: Runners) -> None:
    runners.start()
    run = server.launch(
        "from kleinkram.action import report\n"
        "for number in range(9_999):\n"
        "    report.finding('warning', 'imu.gap', f'{number}'.ljust(600, '.'))\n"
        "report.finding('error', 'imu.gap', 'the last')\n"
    )
    (finish,) = ended(run).finishes
    assert (finish.reason, finish.problems) == (EndReason.done, [])
    assert len(finish.model_dump_json()) > 6 * 10**6
    assert (len(finish.report.findings), verdict_of_report(finish.report)) == (10_000, Verdict.bad)


def test_a_run_whose_report_is_incomplete_is_not_good(server: FakeServer, runners: Runners) -> None:
    runners.start()
    run = server.launch(
        "from kleinkram.action import out, report\n"
        "report.check('imu.gravity', 'ok', '9.81')\n"
        "with open(out / '.kleinkram' / 'events.jsonl', 'a') as events:\n"
        '    events.write(\'{"check": {"name": "Gravity", "status": "error", "message": "0"}}\\n\')\n'
    )
    (finish,) = ended(run).finishes
    assert (finish.reason, verdict_of_report(finish.report)) == (EndReason.done, Verdict.warnings)
    assert [check.name for check in finish.report.checks] == ["imu.gravity", "report.incomplete"]


def test_a_run_without_a_sandbox_has_copies_of_its_inputs(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_sandbox, "is_available", lambda: False)
    runners.start()
    run = server.launch(
        "from kleinkram.action import run_files\n"
        "path = run_files.in_dir / 'drive.bag'\n"
        "path.chmod(0o600)\npath.write_text('spoilt')\n",
        {"drive.bag": b"bytes of a drive"},
        network=Network.open,
    )
    assert ended(run).finishes[0].reason is EndReason.done
    assert [path.read_bytes() for path in runners.folder.glob("cache/*.file")] == [b"bytes of a drive"]
