"""A runner without a container engine runs images: from the claim to the end, with a kill in between."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.actions import Network
from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner import choose_executor as choose_module
from kleinkram.runner.arguments import ExecutorChoice, ImageChoice
from kleinkram.runner.choose_executor import ImagePolicy, choose_executor
from kleinkram.runner.executors import process_sandbox
from kleinkram.runner.executors.local import Machine, MachineShare
from tests.integration.runner.conftest import ImageFolder, image_folder, registry_images  # noqa: F401  fixtures
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_http import RUN_TOKEN
from tests.integration.runner_loop.fake_server import FakeServer
from tests.integration.runner_loop.test_containers import CONNECT_SCRIPT, LASTING

pytestmark = pytest.mark.slow


def test_an_image_reads_inputs_calls_the_api_and_outlives_its_runner(
    server: FakeServer,
    runners: Runners,
    image_folder: ImageFolder,  # noqa: F811  the fixture
) -> None:
    image = image_folder.image
    first = runners.spawn(default_image=image)
    run = server.launch(
        "",
        {"drive.txt": b"bytes of a drive"},
        script=None,
        image=image,
        command=["python3", "-c", f"{CONNECT_SCRIPT}\n{LASTING}"],
        network=Network.api,
        token=RUN_TOKEN,
    )
    wait_until(lambda: RunState.running in run.states and run.shown_log)
    runners.kill(first)
    runners.spawn(default_image=image)
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.done, finish
    assert run.attempt == 1
    numbers = "".join(f"{number}\n" for number in range(60)).encode()
    assert run.artifacts == {"x": b"x", LOG_PATH: b"200 bytes of a drive\n" + numbers}
    assert run.digest is not None
    assert run.digest.startswith("sha256:")


def test_how_images_run_is_chosen(
    image_folder: ImageFolder,  # noqa: F811  the fixture
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    machine = Machine(tmp_path, MachineShare(images_bytes=10**9))

    def has_images(images: ImageChoice, default_image: str = image_folder.image) -> bool:
        choice = choose_executor(ExecutorChoice.process, ImagePolicy(), default_image, images=images, machine=machine)
        return choice.abilities.images

    assert not has_images(ImageChoice.off)
    assert has_images(ImageChoice.auto)
    assert has_images(ImageChoice.namespaces)
    with caplog.at_level(logging.WARNING):
        assert not has_images(ImageChoice.auto, "127.0.0.1:1/nowhere")
    assert "does not answer" in caplog.text
    with pytest.raises(InvalidInput, match="apptainer"):
        has_images(ImageChoice.apptainer)
    monkeypatch.setattr(process_sandbox, "is_available", lambda: False)
    with pytest.raises(InvalidInput, match="namespaces"):
        has_images(ImageChoice.namespaces)
    assert not has_images(ImageChoice.auto)
    assert "Apptainer is not installed" in caplog.text
    monkeypatch.setattr(choose_module, "find_apptainer", lambda: "/usr/bin/apptainer")
    assert has_images(ImageChoice.apptainer)
