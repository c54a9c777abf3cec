"""`klein action init` creates an action that runs unchanged."""

import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from kleinkram.cli.main import app
from kleinkram.client.actions import read_manifest
from kleinkram.client.errors import InvalidInput


def init(*arguments: object) -> None:
    ran = CliRunner().invoke(app, ["action", "init", *map(str, arguments)], catch_exceptions=False)
    assert ran.exit_code == 0, ran.output


def test_init_creates_valid_actions(tmp_path: Path) -> None:
    init(tmp_path / "My Script")
    init(tmp_path / "my-image", "--image")

    script, image = read_manifest(tmp_path / "My Script"), read_manifest(tmp_path / "my-image")
    assert (script.name, script.image, script.dependencies) == ("my-script", None, ["open-kleinkram"])
    assert (image.name, image.image, image.script) == ("my-image", "my-image:1", None)
    assert image.command == ["python3", "/action/main.py"]
    assert script.parameters == image.parameters
    assert script.inputs == image.inputs
    assert "ARG BASE=" in (tmp_path / "my-image" / "Dockerfile").read_text()


@pytest.mark.slow
def test_tests_of_created_actions_pass(tmp_path: Path) -> None:
    init(tmp_path / "script")
    init(tmp_path / "image", "--image")
    command = [sys.executable, "-m", "pytest", "-q", "-c", "/dev/null", "-p", "no:cacheprovider", str(tmp_path)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "2 passed" in ran.stdout, ran.stdout


def test_init_overwrites_nothing(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "main.py").write_text("print('mine')")
    with pytest.raises(InvalidInput, match="new or empty"):
        init(tmp_path / "mine")
    assert (tmp_path / "mine" / "main.py").read_text() == "print('mine')"
    with pytest.raises(InvalidInput, match="letters or digits"):
        init(tmp_path / "---")
