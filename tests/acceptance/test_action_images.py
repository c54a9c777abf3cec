"""Actions with an image of their own are built and run in a container."""

import re
import shutil
import subprocess
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import kleinkram
from tests.acceptance.conftest import Terminal
from tests.integration.runner import engines
from tests.integration.runner.conftest import docker  # noqa: F401  a fixture
from tests.integration.runner.engines import Dockerd

EXAMPLE = Path(__file__).parents[2] / "examples" / "actions" / "extract-metadata"
STOCK = "kleinkram/action-python:latest"


@pytest.fixture
def containers(docker: Dockerd, terminal: Terminal, tmp_path: Path) -> Terminal:  # noqa: F811  the fixture
    """A terminal with an engine that has an image with open-kleinkram under the name of the default image."""
    add_stock(docker, tmp_path / "base")
    return replace(terminal, environment={**terminal.environment, "DOCKER_HOST": f"unix://{docker.socket}"})


def add_stock(engine: Dockerd, context: Path) -> None:
    """Build an image with open-kleinkram in a folder, with the name of the default image."""
    copy_package(context / "site")
    for library in sorted({library for file in context.rglob("*.so*") for library in libraries_of(file)}):
        target = context / "libs" / library[1:]
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(Path(library).resolve(), target)
    (context / "Dockerfile").write_text(f"FROM {engines.IMAGE}\nCOPY libs /\nCOPY site /site\nENV PYTHONPATH=/site\n")
    engine.docker("build", "--quiet", "--tag", STOCK, str(context))


def copy_package(site: Path) -> None:
    """Copy the installed open-kleinkram and the dependencies of a base installation."""
    ours = metadata.distribution("open-kleinkram")
    waiting, seen = [*(ours.requires or []), "numpy", "packaging"], set[str]()
    while waiting:
        requirement = Requirement(waiting.pop())
        name = re.sub(r"[-_.]+", "-", requirement.name).lower()
        if name in seen or (requirement.marker is not None and not requirement.marker.evaluate({"extra": ""})):
            continue
        seen.add(name)
        distribution = metadata.distribution(name)
        waiting += distribution.requires or []
        for file in distribution.files or []:
            if ".." not in file.parts and file.suffix != ".pyc":
                (site / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(str(distribution.locate_file(file)), site / file)
    metadata_dir = site / f"open_kleinkram-{ours.version}.dist-info"
    metadata_dir.mkdir()
    (metadata_dir / "METADATA").write_text(ours.read_text("METADATA") or "")
    package = Path(kleinkram.__file__).parent
    shutil.copytree(package, site / "kleinkram", ignore=shutil.ignore_patterns("server", "__pycache__"))


def libraries_of(file: Path) -> list[str]:
    """Return the libraries of the system that a compiled file needs."""
    linked = subprocess.run(["ldd", str(file)], capture_output=True, text=True, check=False).stdout
    return [word for word in linked.split() if word.startswith(("/lib", "/usr/lib")) and ":" not in word]


@pytest.mark.slow
def test_the_shipped_action_has_equal_results_as_image_and_script(
    containers: Terminal, project: str, recordings_dir: Path, tmp_path: Path
) -> None:
    bag = recordings_dir / "ros1" / "robot_localization_test2_imu_odom_bz2.bag"
    mission = ("-p", project, "-m", "drive")
    containers.run("upload", *mission, "--create", "--wait", bag)
    run = ("action", "run-local", *mission, "--json", "--out")

    image = containers.run(*run, tmp_path / "image", EXAMPLE)
    assert "Running extract-metadata in a container." in image.err
    script = containers.run(*run, tmp_path / "script", EXAMPLE / "extract_metadata.py")
    assert "Running extract-metadata as a p" in script.err
    assert image.json()["report"]["metadata"]["distance_m"] > 80
    for linked in ("metrics", "metadata", "findings"):
        assert image.json()["report"][linked] == script.json()["report"][linked]
    assert (tmp_path / "image" / "track.csv").read_bytes() == (tmp_path / "script" / "track.csv").read_bytes()


@pytest.mark.slow
def test_the_action_made_by_init_runs_unchanged(containers: Terminal, project: str, tmp_path: Path) -> None:
    containers.run("sample", tmp_path / "drive", "--size", "2MB", "--format", "mcap")
    containers.run("upload", "-p", project, "-m", "drive", "--create", "--wait", tmp_path / "drive")
    containers.run("action", "init", tmp_path / "counting", "--image")
    run = ("action", "run-local", tmp_path / "counting", "-p", project, "-m", "drive", "--out")

    ran = containers.run(*run, tmp_path / "found")
    assert "messages" in ran.out
    assert "drive.mcap,/imu/data," in (tmp_path / "found" / "topics.csv").read_text()

    manifest = tmp_path / "counting" / "action.yaml"
    manifest.write_text(manifest.read_text().replace("counting:1", "127.0.0.1:1/unknown/image:1"))
    refused = containers.run(*run, tmp_path / "none", "--no-build", code=14)
    assert "127.0.0.1:1/unknown/image:1" in refused.err
