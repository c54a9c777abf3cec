"""Runs on a fake cluster, from their claim to their end."""

from __future__ import annotations

from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason
from tests.integration.kubernetes.conftest import Site
from tests.integration.runner_loop.conftest import ended


def test_a_run_reads_its_inputs_and_its_results_are_stored(site: Site) -> None:
    site.start()
    run = site.server.launch(
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
    assert finish.placement is not None
    assert finish.placement.node == "node-1"
