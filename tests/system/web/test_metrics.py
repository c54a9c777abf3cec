"""Tables of metrics in a real browser: values with marks, missing cells, a comparison, links, and copies for papers."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.conftest import Terminal
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_FIRST = "a <b>one<b>"
_SCRIPT = """\
# /// script
# [tool.kleinkram]
# name = "slam"
# description = "{description}"
# parameters = [{{name = "method", type = "string", default = "fast"}}]
# metrics = [{{name = "ate_rmse", unit = "m", better = "lower", description = "Error <i>of the track<i>."}}]
# ///
from kleinkram.action import context, parameters, report

report.metric("ate_rmse", {values}[context().mission.name, parameters()["method"]])
"""
_VALUES = (
    {(_FIRST, "fast"): 0.5, ("b", "fast"): 1.25},
    {(_FIRST, "fast"): 0.25, (_FIRST, "slow"): 0.7, ("b", "fast"): 2},
)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_metrics_are_compared_in_a_table_that_a_link_shows_again(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    project, run = _create_runs(cluster.terminal, tmp_path)

    results = run_browser("metrics.mjs", cluster, pictures, json.dumps({"project": project, "run": run}))

    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["executed"] == [], "markup was run"
    _check_table(results)
    assert results["byMethod"]["headings"] == [
        "Mission",
        *("slam@1, method=fast", "slam@2, method=fast", "slam@2, method=slow"),
    ]
    assert results["byMethod"]["cells"][0] == [_FIRST, "0.5000", "0.2500 | best", "0.7000 | worst"]
    _check_comparison(results)
    assert results["allRows"] == 4
    assert results["filtered"] == ["Mission", "slam@2"]
    assert results["gone"].startswith("The table does not have both columns")
    assert f"metric=ate_rmse&project={project}" in results["fromRun"]


def _create_runs(terminal: Terminal, tmp_path: Path) -> tuple[str, str]:
    (tmp_path / "notes.txt").write_text("a day")
    terminal.run("project", "create", "Alps")
    for mission in (_FIRST, "b", "c", "never run"):
        terminal.run("upload", "-p", "Alps", "-m", mission, "--create", "--wait", tmp_path / "notes.txt")
    script = tmp_path / "slam.py"
    for number, values in enumerate(_VALUES, start=1):
        script.write_text(_SCRIPT.format(description=f"version {number}", values=values))
        terminal.run("action", "create", script, "-p", "Alps", *(["--new-version"] if number > 1 else []))
        for mission, method in values:
            terminal.run("action", "run", "slam", "-p", "Alps", "-m", mission, "--set", f"method={method}", "--follow")
        if number == 1:
            # It has no value for this mission, and fails.
            terminal.run("action", "run", "slam", "-p", "Alps", "-m", "c", "--follow", code=14)
    (project,) = terminal.run("project", "list", "--json").json()["items"]
    runs = terminal.run("run", "list", "-p", "Alps", "--json").json()["items"]
    return project["id"], next(run["id"] for run in runs if run["mission"]["name"] == "b")


def _check_table(results: dict[str, Any]) -> None:
    table = results["table"]
    assert "metric=ate_rmse" in table["address"]
    assert table["caption"] == "ate_rmse [m], median, lower is better"
    assert table["headings"] == ["Mission", "slam@1", "slam@2"]
    assert table["cells"] == [
        [_FIRST, "0.5000 | worst", "0.4750 | best"],
        ["b", "1.250 | best", "2.000 | worst"],
        ["c", "failed | failed", "no run | no_run"],
    ]
    assert table["varying"].startswith("Results of one column differ in Parameter method.")
    assert "1.25 m, best" in results["explained"]
    assert "1 value of 1 run" in results["explained"]
    assert results["afterReturn"] == table["cells"]


def _check_comparison(results: dict[str, Any]) -> None:
    compared = results["compared"]
    assert "+0.3625 m" in compared["text"], "the median of two differences"
    assert "1 win, 1 loss, 0 ties" in compared["text"]
    assert [row[-1] for row in compared["cells"]] == ["−0.02500 win", "+0.7500 loss", "–"]
    assert results["afterReload"] == compared
    copies = results["copies"]
    assert copies["CSV"].splitlines()[0] == "mission,slam@1,slam@2,difference"
    assert "| b | **1.250** | 2.000 | 0.7500 |" in copies["Markdown"]
    assert "  b & \\textbf{1.250} & 2.000 & 0.7500 \\\\" in copies["LaTeX"]
    assert "a \\textless{}b\\textgreater{}one\\textless{}b\\textgreater{}" in copies["LaTeX"]
