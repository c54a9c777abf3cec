"""Takes the screenshots of the README and the tour; `make pictures` copies them to docs/pictures."""

from pathlib import Path

import pytest

from kleinkram.recordings.sample import Defect, Faults, TopicGap, generate_bag, generate_mission
from tests.acceptance.conftest import Terminal, wait_until
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_FIELDS = """
undeclared: accept
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true, description: Which robot was out}
  - {name: operator, type: string, required: true, description: Who held the remote}
  - {name: temperature, type: number, unit: degC}
"""
_MISSIONS = {
    "ridge-traverse": ("anymal", "ada", 4, "Fog until ten. The IMU fell silent once, on the way down."),
    "forest-loop": ("spot", "grace", 11, "Wet leaves; two slips near the bridge."),
    "night-run": ("anymal", "ada", -2, ""),
}
_RULES = """
version: 1
profiles:
- name: alpine
  files: {drive.mcap: {min_size: 1MB}}
  recordings: {drive.mcap: {covers: 95%}}
  topics:
    /imu/data: {rate: 200, max_gap: 500ms}
    /gps/*: {severity: warning}
    /odom: {rate: 50}
    /lidar/*: {}
  clocks: {/odom: {no_jump: true}}
  images: {/camera/*: {}}
  imu: {/imu/*: {gravity: 9.81}}
  odometry: {/odom: {}}
"""
_FAULTS = {
    "ridge-traverse": Faults(gap=TopicGap("/imu/data", 5, 3)),
    "forest-loop": Faults(defects=frozenset({Defect.black_camera})),
    "night-run": Faults(),
}
_QUERY = "alpine topic:/imu/* format:mcap"
_MAX_BYTES = 200_000


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_screenshots_of_the_readme_are_taken(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    terminal = cluster.terminal
    (tmp_path / "fields.yaml").write_text(_FIELDS)
    (tmp_path / "checks.yaml").write_text(_RULES)
    terminal.run("project", "create", "alpine", "-d", "Walks above the snow line", "--fields", tmp_path / "fields.yaml")
    terminal.run("checks", "set", "-p", "alpine", tmp_path / "checks.yaml")
    for seed, mission in enumerate(_MISSIONS):
        _make(terminal, tmp_path / mission, seed + 1)
    missions = {row["name"]: row["id"] for row in terminal.run("mission", "list", "--json").json()["items"]}
    place = ("-p", "alpine", "-m", "ridge-traverse")

    def files() -> dict[str, str]:
        items = terminal.run("file", "list", *place, "--json").json()["items"]
        return (
            {} if any(item["content"] == "pending" for item in items) else {item["path"]: item["id"] for item in items}
        )

    wait_until(lambda: files() != {}, "the recordings to be read")
    terminal.run("file", "update", "drive.mcap", *place, "--label", "icra-27")
    wait_until(lambda: _verdicts(terminal) <= {"bad", "warnings", "good"}, "all missions to be checked")
    (project,) = terminal.run("project", "list", "--json").json()["items"]
    ids = (missions["ridge-traverse"], files()["drive.mcap"], project["id"])
    run_browser("every_page_pictures.mjs", cluster, pictures, *ids, _QUERY)
    for name in ("mission", "search", "preview", "checks", "matrix", "viewer"):
        picture = pictures / f"readme-{name}.png"
        assert 10_000 < picture.stat().st_size < _MAX_BYTES, name


def _verdicts(terminal: Terminal) -> set[str]:
    return {row["verdict"] for row in terminal.run("mission", "list", "--json").json()["items"]}


def _make(terminal: Terminal, folder: Path, seed: int) -> None:
    robot, operator, temperature, notes = _MISSIONS[folder.name]
    generate_mission(folder, size_bytes=18_000_000, duration_s=20, seed=seed, faults=_FAULTS[folder.name])
    generate_bag(folder / "payload.bag", size_bytes=3_000_000, duration_s=14, seed=seed + 10)
    metadata = folder.with_suffix(".yaml")
    metadata.write_text(f"robot: {robot}\noperator: {operator}\ntemperature: {temperature}\n")
    place = ("-p", "alpine", "-m", folder.name)
    terminal.run("mission", "create", *place, "--metadata", metadata, "--notes", notes)
    terminal.run("upload", *place, "--check", f"{folder}/")
