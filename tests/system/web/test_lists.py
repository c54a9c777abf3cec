"""Lists in a real browser: sorting, metadata filters, bulk changes and downloads, on desktop and phone."""

from pathlib import Path

import pytest

from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_FIELDS = """
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true}
  - {name: temperature, type: number, unit: degC}
  - {name: operator, type: string}
"""
_MISSIONS = {"cold": ("anymal", -3), "mild": ("spot", 9.5), "hot": ("spot", 21)}


@pytest.mark.slow
@pytest.mark.timeout(280)
def test_missions_are_sorted_filtered_changed_and_downloaded_in_bulk(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    terminal = cluster.terminal
    (tmp_path / "fields.yaml").write_text(_FIELDS)
    terminal.run("project", "create", "Alps", "--fields", tmp_path / "fields.yaml")
    for name, (robot, temperature) in _MISSIONS.items():
        folder = tmp_path / name / "notes"
        folder.mkdir(parents=True)
        (folder / "day.txt").write_text(f"It was {name}.")
        metadata = tmp_path / f"{name}.yaml"
        metadata.write_text(f"robot: {robot}\ntemperature: {temperature}\n")
        place = ("-p", "Alps", "-m", name, "--create", "--metadata", metadata)
        terminal.run("upload", *place, f"{tmp_path / name}/")
    # Two names that are equal on systems whose file names may not contain `:`.
    for name in ("a:b.txt", "a_b.txt"):
        (tmp_path / "hot" / name).write_text("Of the same size.")
    terminal.run("upload", "-p", "Alps", "-m", "hot", f"{tmp_path / 'hot'}/")
    share = terminal.run("share", "create", "-p", "Alps", "-m", "hot").out.strip()
    (project,) = terminal.run("project", "list", "--json").json()["items"]
    invited = terminal.run("person", "invite", "grace@example.org", "--name", "Grace", "--json").json()
    results = run_browser("lists.mjs", cluster, invited["url"], share, project["id"], pictures)

    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["ascending"] == ["cold", "mild", "hot"]
    assert results["descending"] == ["hot", "mild", "cold"]
    assert sorted(results["filtered"]) == ["hot", "mild"]
    assert results["downloads"] == ["2 files downloaded.", "0 files downloaded, 2 files already present."]
    assert results["downloadedFiles"] == {f"Alps/{name}/notes/day.txt": f"It was {name}." for name in ("cold", "mild")}
    assert sorted(results["command"].split("\n")) == [
        f"klein download --nested --dest data -p Alps -m {name}" for name in ("cold", "mild")
    ]
    assert results["remaining"] == ["hot"]
    assert "21 degC" in results["details"]
    assert results["shared"].startswith("2 of 3 files downloaded. Failed: ")
    assert "another file has the same name on this computer" in results["shared"]
    assert "You have no access yet" in results["noAccess"][0]
    assert "grace@example.org" in results["noAccess"][0]
    missions = terminal.run("mission", "list", "--json").json()["items"]
    assert [mission["name"] for mission in missions] == ["hot"]
