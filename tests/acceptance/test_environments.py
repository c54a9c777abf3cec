"""A script names packages, and runs with them: on its author's machine, and on the server once it is published."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acceptance.conftest import Terminal, _terminal, running_instance
from tests.package_index import PackageIndex, serve_index

pytestmark = pytest.mark.slow

SCRIPT = """\
# /// script
# requires-python = ">=3.10"
# dependencies = ["robot-of-tests", "open-kleinkram"]
# ///
import robot_of_tests
from kleinkram.action import inputs, report
print("with", robot_of_tests.VERSION)
report.metric("files", len(inputs()))
"""


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PackageIndex]:
    """An index with a package and what it depends on."""
    with serve_index(tmp_path_factory.mktemp("wheels")) as made:
        made.add("arm-of-tests", "1.0")
        made.add("robot-of-tests", "1.0", requires=["arm-of-tests"])
        yield made


@pytest.fixture(scope="module")
def lab(index: PackageIndex, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Terminal]:
    """A terminal of an instance that uses the index, with a mission."""
    home = tmp_path_factory.mktemp("up")
    settings = {"KLEINKRAM_PACKAGE_INDEX": index.url, "NO_PROXY": "127.0.0.1"}
    with running_instance(home, **settings) as instance:
        terminal = _terminal(instance, home / "terminal")
        terminal.environment.update(settings, XDG_CACHE_HOME=str(home / "cache"))
        terminal.run("project", "create", "alpine")
        terminal.run("sample", home / "drive", "--size", "1MB", "--format", "mcap")
        terminal.run("upload", "-p", "alpine", "-m", "drive", "--create", "--wait", home / "drive")
        yield terminal


def test_a_script_runs_with_what_it_names(lab: Terminal, index: PackageIndex, tmp_path: Path) -> None:
    script, lock = tmp_path / "look.py", tmp_path / "look.lock"
    script.write_text(SCRIPT)
    mission = ("-p", "alpine", "-m", "drive")
    assert lab.run("action", "lock", script, "--out", lock, "--json").json()["packages"] == [
        "arm-of-tests",
        "robot-of-tests",
    ]
    local = lab.run("action", "run-local", script, *mission, "--lock", lock, "--out", tmp_path / "out")
    assert "Installing 2 packages." in local.err
    assert "with 1.0" in local.err

    # Published with its own lock, which stays when there are later releases.
    lab.run("action", "create", script, "-p", "alpine", "--lock", lock)
    index.add("robot-of-tests", "2.0")
    ran = lab.run("action", "run", "look", *mission, "--follow")
    assert "with 1.0" in ran.out + ran.err
    info = lab.run("action", "info", "look", "-p", "alpine").out
    assert "2 packages" in info

    # The server locks what has no lock.
    ran = lab.run("action", "run", script, *mission, "--follow")
    assert "with 2.0" in ran.out + ran.err
    same = lab.run("action", "create", script, "-p", "alpine", "--new-version")
    assert "nothing was published" in same.err


def test_errors_are_reported_at_once(lab: Terminal, tmp_path: Path) -> None:
    script = tmp_path / "wrong.py"
    script.write_text(SCRIPT.replace("robot-of-tests", "no-such-package-of-tests"))
    mission = ("-p", "alpine", "-m", "drive")
    message = "There is no package no-such-package-of-tests in the package index."
    for command in (
        ("create", script, "-p", "alpine"),
        ("run", script, *mission),
        ("run-local", script, *mission),
        ("lock", script),
    ):
        assert message in lab.run("action", *command, code=2).err, command
    lock = tmp_path / "lock"
    lock.write_text(f"arm-of-tests==1.0 --hash=sha256:{'0' * 64}\n")
    refused = lab.run("action", "create", script, "-p", "alpine", "--lock", lock, code=2)
    assert "the lock does not match the dependencies: no-such-package-of-tests is not locked" in refused.err
    script.write_text(SCRIPT.replace("robot-of-tests", "arm-of-tests"))
    ran = lab.run("action", "run-local", script, *mission, "--lock", lock, "--out", tmp_path / "out", code=14)
    assert "do not have the hash of the lock" in ran.err
