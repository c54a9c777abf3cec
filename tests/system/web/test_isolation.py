"""The isolation of runs in a real browser: the settings of a project, the page of a run, the list of runners."""

from pathlib import Path

import pytest

from tests.system.backend import sql
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_SCRIPT = """\
# /// script
# [tool.kleinkram]
# name = "count"
# ///
print("one")
"""
_PLACEMENT = (
    '{"job_id": "4711_3", "node": "gpu07", "queued_s": 12.0, "gpus": ["GPU-5f2e"], "cpu_s": 41.2,'
    ' "peak_memory_bytes": 1500000000, "requeues": 1}'
)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_an_owner_allows_a_class_and_a_run_shows_its_own(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    terminal = cluster.terminal
    (tmp_path / "day").mkdir()
    (tmp_path / "day" / "notes.txt").write_text("above the snow line")
    (tmp_path / "count.py").write_text(_SCRIPT)
    project = terminal.run("project", "create", "Alps", "--json").json()
    terminal.run("upload", "-p", "Alps", "-m", "ridge", "--create", f"{tmp_path / 'day'}/", "--wait")
    terminal.run("action", "run", str(tmp_path / "count.py"), "-p", "Alps", "-m", "ridge", "--follow")
    (run,) = terminal.run("run", "list", "--json").json()["items"]
    # As the runner of a cluster reports it.
    sql(cluster, "UPDATE run SET placement = %s::jsonb RETURNING id", _PLACEMENT)

    results = run_browser("isolation.mjs", cluster, project["id"], run["id"], pictures)

    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["before"] == "container"
    assert results["disabled"] == ["No isolation (not allowed on this server)"]
    assert results["explained"] == 3, "a sentence for each class"
    facts = results["facts"].split("\n")
    assert facts[facts.index("Isolation") + 1] in {"Containers", "Namespaces, without containers", "No isolation"}
    assert [facts[facts.index(name) + 1] for name in ("Node", "Job", "GPUs")] == ["gpu07", "4711_3", "GPU-5f2e"]
    assert any(name in results["runner"] for name in ("Containers", "Namespaces", "None"))
    assert terminal.run("project", "info", "Alps", "--json").json()["isolation"] == "namespaces"
