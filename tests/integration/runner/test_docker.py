"""Docker only: images, an unavailable daemon, leftover containers."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart, RunJob, wait_for_end
from kleinkram.runner.executors.docker.executor import DockerExecutor
from kleinkram.runner.executors.port_forward import PortForward
from kleinkram.runner.images.names import Pull
from tests.integration.runner import engines
from tests.integration.runner.conftest import Bench, lent, log_of
from tests.integration.runner.engines import Dockerd, Registry
from tests.integration.runner.test_executors import CONNECT, answers, ending_of_start, until_logged_by

pytestmark = pytest.mark.slow
BOTH = pytest.mark.parametrize("bench", ["docker", "podman"], indirect=True)

# Prints its progress until it is ended.
COUNTS = "import time\nfor n in range(10_000): print(f'line {n}', flush=True); time.sleep(0.01)"


@pytest.fixture(params=["docker", pytest.param("podman", marks=pytest.mark.soak)])
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    """A bench for each engine."""
    yield from lent(request.param, request, tmp_path)


@pytest.fixture
def engine(bench: Bench) -> Dockerd:
    """The engine of the bench."""
    assert bench.engine is not None
    return bench.engine


@pytest.fixture
def registry(tmp_path: Path) -> Iterator[Registry]:
    """A running registry."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        made = Registry(tmp_path / "registry", free.getsockname()[1])
    made.start()
    yield made
    made.end()


def small(engine: Dockerd, name: str, word: str) -> str:
    """Create an image with a single file, and return its id."""
    return engine.load(name, f"LABEL word={word}", root=engines.root_of({"word": word.encode()}))


def refusal(executor: DockerExecutor, image: str) -> tuple[EndReason, str]:
    with pytest.raises(CannotStart) as caught:
        executor.prepare_image(image)
    return caught.value.ending.reason, caught.value.ending.message


def is_numbered(text: str) -> bool:
    """Whether lines are those of `COUNTS`: none is missing or duplicated."""
    lines = text.splitlines()
    return lines == [f"line {n}" for n in range(len(lines))]


def test_a_missing_image(bench: Bench, engine: Dockerd) -> None:
    reason, message = refusal(DockerExecutor(engine.engine, pull=Pull.never), "lab/nonsense:1")
    assert (reason, "lab/nonsense:1" in message) == (EndReason.image_unavailable, True)
    with pytest.raises(CannotStart, match="not on this runner"):
        bench.executor.submit(bench.with_image("lab/nonsense:1").job("pass"))


def test_an_image_for_another_architecture(bench: Bench, engine: Dockerd) -> None:
    engine.load_foreign("lab/foreign:1", engines.root_of({"word": b"foreign"}), "arm64")
    reason, message = refusal(DockerExecutor(engine.engine), "lab/foreign:1")
    assert (reason, "arm64" in message) == (EndReason.not_possible, True)


def test_a_program_for_another_architecture(bench: Bench, engine: Dockerd) -> None:
    image = engine.load("lab/odd:1", root=engines.root_of({"odd": b"\x7fELF but not really"}))
    ending = ending_of_start(bench, bench.with_image(image).job(["/odd"]))
    assert (ending.reason, "/odd" in ending.message) == (EndReason.command_not_found, True)


def test_images_are_pulled_and_pinned_by_digest(bench: Bench, engine: Dockerd, registry: Registry) -> None:
    name = f"{registry.place}/lab/slam:1"
    first = small(engine, name, "first")
    engine.docker("push", name)
    engine.docker("image", "rm", name)
    executor = DockerExecutor(engine.engine, allowed=[f"{registry.place}/lab"])
    pinned = executor.prepare_image(name)
    assert pinned.reference == first
    assert re.fullmatch("sha256:[0-9a-f]{64}", pinned.digest)

    second = small(engine, name, "second")
    engine.docker("push", name)
    engine.docker("image", "rm", name)
    engine.docker("image", "rm", first)
    exact = f"{registry.place}/lab/slam:1@{pinned.digest}"
    assert executor.prepare_image(exact).reference == first
    assert executor.prepare_image(exact).digest == pinned.digest
    assert executor.prepare_image(name).reference == second

    reason, message = refusal(executor, f"{registry.place}/labor/slam")
    assert (reason, "may not use" in message) == (EndReason.image_unavailable, True)
    registry.end()
    assert executor.prepare_image(name).reference == second
    reason, message = refusal(DockerExecutor(engine.engine, pull=Pull.always), name)
    assert (reason, registry.place in message) == (EndReason.image_unavailable, True)


def test_a_locally_built_image_is_pinned_by_its_id(bench: Bench, engine: Dockerd) -> None:
    built = small(engine, "lab/built:1", "built")
    executor = DockerExecutor(engine.engine)
    made = executor.prepare_image("lab/built:1")
    assert made.reference == executor.prepare_image(f"lab/built:1@{built}").reference == built
    assert executor.prepare_image(f"lab/built:1@{made.digest}") == made


def test_the_command_and_volumes_of_an_image_are_used(bench: Bench, engine: Dockerd) -> None:
    text = "import os; open('/data/x', 'w').write('1'); print(os.getcwd(), os.environ['WORD'])"
    reported = [f'CMD ["python3", "-c", "{text}"]', "VOLUME /data", "WORKDIR /var/lab", "ENV WORD=said", "USER 0:0"]
    image = engine.load("lab/own:1", *reported, root=engines.python_root())
    own = bench.with_image(image)
    job, ending = own.run([])
    assert (ending.reason, log_of(job)) == (EndReason.done, "/var/lab said\n")
    assert (job.directory / "tmp" / ".volume-0" / "x").read_text() == "1"
    assert engine.docker("volume", "ls", "--quiet") == ""


@BOTH
def test_a_run_has_no_privileges(bench: Bench) -> None:
    text = (
        "import os, re\n"
        "said = dict(re.findall(r'(\\w+):\\s+(\\S+)', open('/proc/self/status').read()))\n"
        "print(*(said[each] for each in ('CapEff', 'CapBnd', 'NoNewPrivs', 'Seccomp')))\n"
        "print(os.getuid() > 9**9, {*os.getgroups()} <= {os.getgid()})"
    )
    (one, _), (two, _) = bench.run(text), bench.run("pass")
    assert log_of(one) == f"{'0' * 16} {'0' * 16} 1 2\nTrue True\n"
    assert (one.directory / "out").stat().st_uid != (two.directory / "out").stat().st_uid


@BOTH
def test_the_number_of_processes_is_limited(bench: Bench) -> None:
    text = (
        "import os, time\nn = 0\ntry:\n    while n < 5000:\n"
        "        if os.fork() == 0: time.sleep(60)\n        n += 1\nexcept OSError: print(n)"
    )
    job, ending = bench.run(text)
    assert ending.reason is EndReason.done
    assert 500 < int(log_of(job)) < 1024


@BOTH
def test_files_written_outside_the_output_folder_are_not_collected(bench: Bench) -> None:
    job, _ = bench.run(
        "import os\n"
        "os.symlink('/etc/shadow', '/out/link')\n"
        "for path in ('/out/../../x', '/out/../x', '/var/x'):\n"
        "    try: open(path, 'w')\n"
        "    except OSError as error: print(error.errno)"
    )
    outside, through, beside = log_of(job).split()
    # Podman makes the folder, for what it mounts below.
    assert (outside, through) == ("30", "30")
    assert beside in {"2", "30"}
    assert (job.directory / "out" / "link").is_symlink()
    assert sorted(entry.name for entry in (job.directory / "out").iterdir()) == ["link"]


RUNNER = """
import sys, time
from pathlib import Path
from kleinkram.contract.actions import Network, Resources
from kleinkram.runner.executors.docker.client import DockerClient
from kleinkram.runner.executors.docker.executor import DockerExecutor
from kleinkram.runner.executors.base import RunJob
socket, folder, key, image, text = sys.argv[1:]
job = RunJob(key, Path(folder), ["python3", "-c", text], image, Resources(), Network.none)
executor = DockerExecutor(DockerClient(Path(socket)))
if executor.poll(job) is not None:
    executor.submit(job)
while executor.poll(job) is None:
    time.sleep(0.05)

"""


@contextmanager
def another_runner(bench: Bench, engine: Dockerd, job: RunJob, text: str) -> Iterator[None]:
    """Submit or find the job in another process, which watches it and is killed at the end."""
    words = [str(engine.socket), str(job.directory), job.key, str(job.image), text]
    process = subprocess.Popen([sys.executable, "-c", RUNNER, *words])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def until_logged(job: RunJob, words: str) -> None:
    until = time.monotonic() + 60
    while words not in log_of(job):
        assert time.monotonic() < until, f"the log never had {words!r}"
        time.sleep(0.02)


@BOTH
def test_the_next_runner_reattaches_to_a_run(bench: Bench, engine: Dockerd) -> None:
    job = bench.job(COUNTS)
    with another_runner(bench, engine, job, COUNTS):
        until_logged(job, "line 20\n")
    assert wait_for_end(bench.executor, job, timeout_s=0.1) is None
    until_logged_by(bench, COUNTS, "line 60\n")
    bench.executor.cancel(job)
    assert bench.end_of(job).reason is EndReason.cancelled
    assert is_numbered(log_of(job))


@BOTH
def test_killed_runners_lose_and_duplicate_no_line_of_the_log(bench: Bench, engine: Dockerd) -> None:
    text = COUNTS.replace("10_000", "300").replace(
        "print(", "print(f'error {n}', file=__import__('sys').stderr); print("
    )
    job = bench.job(text, time_s=20)
    for n in (20, 120):
        with another_runner(bench, engine, job, text):
            until_logged(job, f"line {n}\n")
    ending = bench.end_of(job)
    assert (ending.reason, ending.exit_code) == (EndReason.done, 0)
    lines = log_of(job).splitlines()
    for word in ("line", "error"):
        assert [entry for entry in lines if entry.startswith(word)] == [f"{word} {n}" for n in range(300)]


def test_the_time_limit_includes_time_without_a_runner(bench: Bench, engine: Dockerd) -> None:
    job = bench.job(COUNTS, time_s=15)
    with another_runner(bench, engine, job, COUNTS):
        until_logged(job, "line 1\n")
    time.sleep(15)
    began = time.monotonic()
    assert bench.end_of(job).reason is EndReason.time
    assert time.monotonic() - began < 14, "counted anew"


def test_the_next_runner_opens_the_port_forwards_again(bench: Bench) -> None:
    with socket.create_server(("127.0.0.1", 0)) as api:
        answers(api, b"api:")
        text = CONNECT + "import time\nwhile True: print(dial('lab.example', 443), flush=True); time.sleep(0.05)"
        job = bench.job(text, network=Network.api, port_forwards=[PortForward("lab.example", 443, *api.getsockname())])
        bench.executor.submit(job)
        until_logged_by(bench, text, "api:\n")
        assert isinstance(bench.executor, DockerExecutor)
        bench.executor._monitors.pop(job.key).close()  # as if the runner were killed
        assert wait_for_end(bench.executor, job, timeout_s=1) is None
        before = log_of(job).count("api:")
        until = time.monotonic() + 60
        while log_of(job).count("api:") < before + 3:
            assert time.monotonic() < until
            time.sleep(0.05)


def test_a_container_removed_by_hand_is_lost(bench: Bench, engine: Dockerd) -> None:
    job = bench.job(COUNTS)
    bench.executor.submit(job)
    engine.docker("rm", "--force", f"kleinkram-{job.key}")
    assert bench.end_of(job).reason is EndReason.lost


def test_only_containers_of_this_runner_are_removed(bench: Bench, engine: Dockerd) -> None:
    jobs = [bench.job(COUNTS) for _ in range(3)]
    mine, other = (DockerExecutor(engine.engine, runner=entry) for entry in ("mine", "other"))
    for executor, job in zip((mine, mine, other), jobs, strict=True):
        executor.submit(job)
    again = DockerExecutor(engine.engine, runner="mine")
    again.remove_others({jobs[0].key})
    names = engine.docker("ps", "--all", "--format", "{{.Names}}").split()
    assert [f"kleinkram-{entry.key}" in names for entry in jobs] == [True, False, True]
    for executor, job in zip((mine, mine, other), jobs, strict=True):
        executor.remove(job)
