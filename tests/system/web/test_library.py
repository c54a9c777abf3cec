"""Adding shipped actions in a real browser: from the list of actions and from a project, and what is refused."""

import json
from pathlib import Path
from typing import Any

import pytest

import kleinkram
from kleinkram.library import shipped_actions
from tests.package_index import serve_index
from tests.system import backend
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_shipped_actions_are_added_in_a_dialog(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    with serve_index(tmp_path / "wheels") as index:
        index.add("evo", "1.38.1")
        cluster.settings = {"KLEINKRAM_PACKAGE_INDEX": index.url, "NO_PROXY": "127.0.0.1"}
        cluster.start()
        project = _create_projects(cluster, tmp_path)

        results = run_browser("library.mjs", cluster, pictures, project)

    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["executed"] == []
    assert results["names"] == [f"kleinkram/{name}" for name in shipped_actions()]
    assert shipped_actions()["slam-evaluate"].description in results["text"]
    assert "1 core, 2.0 GB memory, 1.0 GB disk" in results["text"]
    assert results["disabledBefore"] == len(shipped_actions()), "nothing is added before a place is chosen"
    assert results["action"]["title"] == "slam-evaluate"
    assert f"kleinkram/slam-evaluate@{kleinkram.__version__}" in results["action"]["facts"]
    assert "From kleinkram/slam-evaluate" in results["row"]
    _check_states(results)


def _create_projects(cluster: Cluster, tmp_path: Path) -> str:
    """Create projects: one with an action of its own of a shipped name, one with an older version; return the last."""
    terminal = cluster.terminal
    for name in ("Alps", "Lakes", "Moors", "Rivers"):
        terminal.run("project", "create", name)
    (tmp_path / "own.py").write_text('# /// script\n# [tool.kleinkram]\n# name = "slam-evaluate"\n# ///\nprint(1)\n')
    terminal.run("action", "create", tmp_path / "own.py", "-p", "Lakes")
    added = terminal.run("action", "add", "kleinkram/slam-evaluate", "-p", "Moors", "--json").json()
    older = {"script": "print(1)", "library": "kleinkram/slam-evaluate@0.0.1"}
    statement = "UPDATE action_version SET definition = definition || %s::jsonb WHERE id = %s RETURNING number"
    assert backend.sql(cluster, statement, json.dumps(older), added["latest"]["id"]) == [(1,)]
    projects = terminal.run("project", "list", "--json").json()["items"]
    return next(str(entry["id"]) for entry in projects if entry["name"] == "Rivers")


def _check_states(results: dict[str, Any]) -> None:
    assert "Added" in results["added"]["text"]
    assert "Show the action, version 1" in results["added"]["text"]
    assert results["added"]["buttons"] == 0
    assert "There is no package kiss-icp in the package index." in results["refused"]
    assert "Another action has this name. Archive it to add this one." in results["taken"]["text"]
    assert results["taken"]["buttons"] == 0
    assert results["upgraded"] == "Version 2"
    assert results["place"] == "Rivers"
    assert results["chosen"].startswith("slam-evaluate")
