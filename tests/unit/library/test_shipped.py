"""The shipped actions are read from their scripts, and are in the wheel."""

from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

import kleinkram
from kleinkram.contract.actions import ActionDefinition
from kleinkram.library import shipped_actions

ROOT = Path(__file__).parents[3]
FILES = (ROOT / "src/kleinkram/library").glob("*.py")
SCRIPTS = {path.stem for path in FILES if path.read_text(encoding="utf-8").startswith("# /// script\n")}


@pytest.fixture(params=shipped_actions())
def shipped(request: pytest.FixtureRequest) -> ActionDefinition:
    return shipped_actions()[request.param]


def test_every_script_is_an_action_in_the_order_of_names() -> None:
    names = [*shipped_actions()]
    assert {"lidar-odometry", "slam-evaluate"} <= {*names} == {stem.replace("_", "-") for stem in SCRIPTS}
    assert names == sorted(names)


def test_an_action_is_what_its_script_says(shipped: ActionDefinition) -> None:
    path = Path(kleinkram.__file__).parent / "library" / f"{shipped.name.replace('-', '_')}.py"
    assert shipped.script == path.read_text(encoding="utf-8")
    assert shipped.description
    assert (shipped.image, shipped.lock, shipped.library) == (None, None, None)
    # The library and the packages that it needs are those of the runner.
    assert any(dependency.startswith("open-kleinkram") for dependency in shipped.dependencies)


def test_each_action_has_a_page(shipped: ActionDefinition) -> None:
    pages = ROOT / "docs" / "library"
    assert f"# {shipped.name}" in (pages / f"{shipped.name}.md").read_text().splitlines()
    assert f"({shipped.name}.md)" in (pages / "README.md").read_text()


def test_the_wheel_contains_the_scripts() -> None:
    files = {file.distribution_path for file in WheelBuilder(str(ROOT)).recurse_included_files()}
    assert {f"kleinkram/library/{stem}.py" for stem in SCRIPTS} <= files
