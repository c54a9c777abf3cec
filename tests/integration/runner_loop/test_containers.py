"""A runner with a container engine: from the claim to the end, with kills in between."""

from __future__ import annotations

import pytest

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.actions import Network
from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner.arguments import ExecutorChoice
from kleinkram.runner.choose_executor import ImagePolicy, choose_executor
from kleinkram.runner.executors.docker.executor import DockerExecutor
from kleinkram.runner.images.names import Pull
from tests.integration.runner import engines
from tests.integration.runner.conftest import docker, engine, podman  # noqa: F401  fixtures
from tests.integration.runner.engines import Dockerd
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_http import RUN_TOKEN
from tests.integration.runner_loop.fake_server import FakeServer

pytestmark = pytest.mark.slow

CONNECT_SCRIPT = """
import http.client, os, urllib.parse
url = urllib.parse.urlsplit(os.environ["KLEINKRAM_URL"])
connection = http.client.HTTPConnection(url.netloc, timeout=5)
connection.request("GET", "/api/v1/service", headers={"Authorization": "Bearer " + os.environ["KLEINKRAM_TOKEN"]})
print(connection.getresponse().status, open("/in/drive.txt").read())
open("/out/x", "w").write("x")
"""
LASTING = "import time\nfor n in range(60): print(n, flush=True); time.sleep(0.1)"


def test_a_container_reads_inputs_calls_the_api_and_writes_artifacts(
    server: FakeServer,
    runners: Runners,
    engine: Dockerd,  # noqa: F811  the fixture
) -> None:
    runners.start(DockerExecutor(engine.engine))
    run = server.launch(
        "",
        {"drive.txt": b"bytes of a drive"},
        script=None,
        image=engines.IMAGE,
        command=["python3", "-c", CONNECT_SCRIPT],
        network=Network.api,
        token=RUN_TOKEN,
    )
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.done, finish
    assert run.artifacts == {"x": b"x", LOG_PATH: b"200 bytes of a drive\n"}
    image = engine.engine.find_image(engines.IMAGE)
    assert image is not None
    # By its id, as it is in no registry; Podman knows digests of such images, too.
    assert run.digest in {image.id, *(entry.partition("@")[2] for entry in image.digests)}


def test_a_container_outlives_its_runner(
    server: FakeServer,
    runners: Runners,
    engine: Dockerd,  # noqa: F811  the fixture
) -> None:
    first = runners.spawn(engine)
    run = server.launch("", script=None, image=engines.IMAGE, command=["python3", "-c", LASTING])
    wait_until(lambda: RunState.running in run.states and run.shown_log)
    runners.kill(first)
    runners.spawn(engine)
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.attempt == 1
    assert run.artifacts[LOG_PATH].split() == [str(n).encode() for n in range(60)]
    wait_until(lambda: not engine.docker("ps", "--all", "--quiet").strip())


def test_containers_are_chosen_where_the_default_image_is_available(
    engine: Dockerd,  # noqa: F811  the fixture
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def chosen(default_image: str) -> str:
        policy = ImagePolicy(Pull.missing)
        return choose_executor(ExecutorChoice.auto, policy, default_image).abilities.executor

    monkeypatch.setenv("DOCKER_HOST", f"unix://{engine.socket}")
    assert chosen(engines.IMAGE) == "docker"
    assert chosen("127.0.0.1:1/nowhere") == "process"
    monkeypatch.setenv("DOCKER_HOST", "unix:///nowhere.sock")
    assert chosen(engines.IMAGE) == "process"
    with pytest.raises(InvalidInput):
        choose_executor(ExecutorChoice.docker, ImagePolicy(), engines.IMAGE)
