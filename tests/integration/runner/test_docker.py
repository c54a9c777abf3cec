"""Containers: what no other executor has: images, an engine that may go away, leftovers."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network
from kleinkram.contract.runs import EndReason
from kleinkram.runner.docker.executor import DockerExecutor
from kleinkram.runner.docker.images import Pull
from kleinkram.runner.work import CannotStart, Door, Work
from tests.integration.runner import engines
from tests.integration.runner.conftest import Bench, lent, log_of
from tests.integration.runner.engines import Dockerd, Registry
from tests.integration.runner.test_executors import KNOCKS, answers, until_said

pytestmark = pytest.mark.slow
BOTH = pytest.mark.parametrize("bench", ["docker", "podman"], indirect=True)

# Says what it does for as long as nobody ends it.
COUNTS = "import time\nfor n in range(10_000): print(f'line {n}', flush=True); time.sleep(0.01)"


@pytest.fixture(params=["docker", pytest.param("podman", marks=pytest.mark.soak)])
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    """Somewhere to run things, by each engine."""
    yield from lent(request.param, request, tmp_path)


@pytest.fixture
def engine(bench: Bench) -> Dockerd:
    """The engine of the bench."""
    assert bench.engine is not None
    return bench.engine


@pytest.fixture
def registry(tmp_path: Path) -> Iterator[Registry]:
    """A registry of the tests' own, started."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        made = Registry(tmp_path / "registry", free.getsockname()[1])
    made.start()
    yield made
    made.end()


def small(engine: Dockerd, name: str, word: str) -> str:
    """Make an image with a file and nothing else, and return its id."""
    return engine.load(name, f"LABEL word={word}", root=engines.root_of({"word": word.encode()}))


def refusal(executor: DockerExecutor, image: str) -> tuple[EndReason, str]:
    with pytest.raises(CannotStart) as caught:
        executor.prepare(image)
    return caught.value.ending.reason, caught.value.ending.message


def is_numbered(text: str) -> bool:
    """Whether lines are those of `COUNTS`: none missing, none twice."""
    lines = text.splitlines()
    return lines == [f"line {n}" for n in range(len(lines))]


def test_an_image_that_is_not_there(bench: Bench, engine: Dockerd) -> None:
    reason, message = refusal(DockerExecutor(engine.engine, pull=Pull.never), "lab/nonsense:1")
    assert (reason, "lab/nonsense:1" in message) == (EndReason.image_unavailable, True)
    with pytest.raises(CannotStart, match="not on this runner"):
        bench.executor.start(bench.with_image("lab/nonsense:1").work("pass"))


def test_an_image_for_another_machine(bench: Bench, engine: Dockerd) -> None:
    engine.load_foreign("lab/foreign:1", engines.root_of({"word": b"foreign"}), "arm64")
    reason, message = refusal(DockerExecutor(engine.engine), "lab/foreign:1")
    assert (reason, "arm64" in message) == (EndReason.not_possible, True)


def test_a_program_for_another_machine(bench: Bench, engine: Dockerd) -> None:
    image = engine.load("lab/odd:1", root=engines.root_of({"odd": b"\x7fELF but not really"}))
    with pytest.raises(CannotStart, match="/odd") as caught:
        bench.executor.start(bench.with_image(image).work(["/odd"]))
    assert caught.value.ending.reason is EndReason.command_not_found


def test_images_come_from_registries_and_a_digest_stays_what_it_is(
    bench: Bench, engine: Dockerd, registry: Registry
) -> None:
    name = f"{registry.place}/lab/slam:1"
    first = small(engine, name, "first")
    engine.docker("push", name)
    engine.docker("image", "rm", name)
    executor = DockerExecutor(engine.engine, allowed=[f"{registry.place}/lab"])
    pinned = executor.prepare(name)
    assert pinned.reference == first
    assert re.fullmatch("sha256:[0-9a-f]{64}", pinned.digest)

    second = small(engine, name, "second")
    engine.docker("push", name)
    engine.docker("image", "rm", name)
    engine.docker("image", "rm", first)
    exact = f"{registry.place}/lab/slam:1@{pinned.digest}"
    assert executor.prepare(exact).reference == first
    assert executor.prepare(exact).digest == pinned.digest
    assert executor.prepare(name).reference == second

    reason, message = refusal(executor, f"{registry.place}/labor/slam")
    assert (reason, "may not use" in message) == (EndReason.image_unavailable, True)
    registry.end()
    assert executor.prepare(name).reference == second
    reason, message = refusal(DockerExecutor(engine.engine, pull=Pull.always), name)
    assert (reason, registry.place in message) == (EndReason.image_unavailable, True)


def test_one_built_here_is_known_by_its_id(bench: Bench, engine: Dockerd) -> None:
    built = small(engine, "lab/built:1", "built")
    executor = DockerExecutor(engine.engine)
    made = executor.prepare("lab/built:1")
    assert made.reference == executor.prepare(f"lab/built:1@{built}").reference == built
    assert executor.prepare(f"lab/built:1@{made.digest}") == made


def test_the_images_own_command_and_volumes(bench: Bench, engine: Dockerd) -> None:
    text = "import os; open('/data/x', 'w').write('1'); print(os.getcwd(), os.environ['WORD'])"
    told = [f'CMD ["python3", "-c", "{text}"]', "VOLUME /data", "WORKDIR /var/lab", "ENV WORD=said", "USER 0:0"]
    image = engine.load("lab/own:1", *told, root=engines.python_root())
    own = bench.with_image(image)
    work, ending = own.run([])
    assert (ending.reason, log_of(work)) == (EndReason.done, "/var/lab said\n")
    assert (work.folder / "tmp" / ".volume-0" / "x").read_text() == "1"
    assert engine.docker("volume", "ls", "--quiet") == ""


@BOTH
def test_a_run_is_nobody_and_may_nothing(bench: Bench) -> None:
    text = (
        "import os, re\n"
        "said = dict(re.findall(r'(\\w+):\\s+(\\S+)', open('/proc/self/status').read()))\n"
        "print(*(said[each] for each in ('CapEff', 'CapBnd', 'NoNewPrivs', 'Seccomp')))\n"
        "print(os.getuid() > 9**9, {*os.getgroups()} <= {os.getgid()})"
    )
    (one, _), (two, _) = bench.run(text), bench.run("pass")
    assert log_of(one) == f"{'0' * 16} {'0' * 16} 1 2\nTrue True\n"
    assert (one.folder / "out").stat().st_uid != (two.folder / "out").stat().st_uid


@BOTH
def test_processes_are_counted(bench: Bench) -> None:
    text = (
        "import os, time\nn = 0\ntry:\n    while n < 5000:\n"
        "        if os.fork() == 0: time.sleep(60)\n        n += 1\nexcept OSError: print(n)"
    )
    work, ending = bench.run(text)
    assert ending.reason is EndReason.done
    assert 500 < int(log_of(work)) < 1024


@BOTH
def test_what_is_written_beside_is_not(bench: Bench) -> None:
    work, _ = bench.run(
        "import os\n"
        "os.symlink('/etc/shadow', '/out/link')\n"
        "for path in ('/out/../../x', '/out/../x', '/var/x'):\n"
        "    try: open(path, 'w')\n"
        "    except OSError as error: print(error.errno)"
    )
    outside, through, beside = log_of(work).split()
    # Podman makes the folder, for what it mounts below.
    assert (outside, through) == ("30", "30")
    assert beside in {"2", "30"}
    assert (work.folder / "out" / "link").is_symlink()
    assert sorted(each.name for each in (work.folder / "out").iterdir()) == ["link"]


RUNNER = """
import json, os, signal, sys
from pathlib import Path
from kleinkram.contract.actions import Network, Resources
from kleinkram.runner.docker.engine import Engine
from kleinkram.runner.docker.executor import DockerExecutor
from kleinkram.runner.work import Work
socket, folder, key, image, text = sys.argv[1:]
work = Work(key, Path(folder), ["python3", "-c", text], image, Resources(), Network.none)
DockerExecutor(Engine(Path(socket))).start(work)
os.kill(os.getpid(), signal.SIGKILL)
"""


@BOTH
def test_a_runner_is_killed_and_another_one_finds_its_run(bench: Bench, engine: Dockerd) -> None:
    work = bench.work(COUNTS)
    words = [str(engine.socket), str(work.folder), work.key, str(work.image), COUNTS]
    killed = subprocess.run([sys.executable, "-c", RUNNER, *words], check=False, timeout=60)
    assert killed.returncode == -signal.SIGKILL
    until_said(bench, COUNTS, "line 20\n")
    assert bench.executor.wait(work, timeout_s=0.1) is None
    bench.executor.stop(work)
    assert bench.end_of(work).reason is EndReason.cancelled
    assert is_numbered(log_of(work))


def kill_warden(work: Work) -> None:
    os.kill(int(re.findall(r'"pid": (\d+)', (work.folder / "warden.json").read_text())[0]), signal.SIGKILL)


@BOTH
def test_a_warden_is_killed_and_nothing_is_lost_or_said_twice(bench: Bench) -> None:
    text = COUNTS.replace("10_000", "300").replace(
        "print(", "print(f'error {n}', file=__import__('sys').stderr); print("
    )
    work = bench.work(text, time_s=8)
    bench.executor.start(work)
    for n in (20, 120):
        until_said(bench, text, f"line {n}\n")
        kill_warden(work)
        assert bench.executor.wait(work, timeout_s=0.5) is None
    ending = bench.end_of(work)
    assert (ending.reason, ending.exit_code) == (EndReason.done, 0)
    lines = log_of(work).splitlines()
    for word in ("line", "error"):
        assert [each for each in lines if each.startswith(word)] == [f"{word} {n}" for n in range(300)]


def test_a_runs_time_is_counted_while_nobody_watches(bench: Bench) -> None:
    work = bench.work(COUNTS, time_s=6)
    bench.executor.start(work)
    until_said(bench, COUNTS, "line 1\n")
    kill_warden(work)
    time.sleep(6)
    began = time.monotonic()
    assert bench.end_of(work).reason is EndReason.time
    assert time.monotonic() - began < 5, "counted anew"


def test_doors_are_made_again_by_the_next_warden(bench: Bench) -> None:
    with socket.create_server(("127.0.0.1", 0)) as api:
        answers(api, b"api:")
        text = KNOCKS + "import time\nwhile True: print(knock('lab.example', 443), flush=True); time.sleep(0.05)"
        work = bench.work(text, network=Network.api, doors=[Door("lab.example", 443, *api.getsockname())])
        bench.executor.start(work)
        until_said(bench, text, "api:\n")
        kill_warden(work)
        until_gone = time.monotonic() + 10
        assert bench.executor.wait(work, timeout_s=1) is None
        before = log_of(work).count("api:")
        while log_of(work).count("api:") < before + 3:
            assert time.monotonic() < until_gone
            time.sleep(0.05)


def test_a_container_that_somebody_removes_is_lost(bench: Bench, engine: Dockerd) -> None:
    work = bench.work(COUNTS)
    bench.executor.start(work)
    engine.docker("rm", "--force", f"kleinkram-{work.key}")
    assert bench.end_of(work).reason is EndReason.lost


def test_leftovers_are_swept_but_not_anothers(bench: Bench, engine: Dockerd) -> None:
    works = [bench.work(COUNTS) for _ in range(3)]
    mine, other = (DockerExecutor(engine.engine, runner=each) for each in ("mine", "other"))
    for executor, work in zip((mine, mine, other), works, strict=True):
        executor.start(work)
    again = DockerExecutor(engine.engine, runner="mine")
    again.sweep({works[0].key})
    names = engine.docker("ps", "--all", "--format", "{{.Names}}").split()
    assert [f"kleinkram-{each.key}" in names for each in works] == [True, False, True]
    for executor, work in zip((mine, mine, other), works, strict=True):
        executor.remove(work)
