"""Guarantees of every executor: its folders only, enforced limits, and a reported end."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import threading
import time
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors import local
from kleinkram.runner.executors.base import CannotStart, Ending, RunJob, wait_for_end
from kleinkram.runner.executors.docker import container as docker_container
from kleinkram.runner.executors.kubernetes import pod_log
from kleinkram.runner.executors.port_forward import PortForward
from kleinkram.runner.executors.supervision import GRACE_S, boot_time_s
from tests.integration.runner.conftest import (
    EVERYWHERE,
    EVERYWHERE_IN_IMAGES,
    LOCALLY,
    LOCALLY_EVERYWHERE,
    NOT_ON_THAT_CLUSTER,
    Bench,
    log_of,
)
from tests.requirements import missing

LASTING = "import time; print('ready', flush=True); time.sleep(60)"


@pytest.fixture
def isolated(bench: Bench) -> Bench:
    if bench.executor.abilities.isolation is Isolation.none:
        missing("this kernel gives no namespaces to this user")
    return bench


def ending_of_start(bench: Bench, job: RunJob) -> Ending:
    """Return how a job ended that cannot be started, whether the executor notices it on submission or later."""
    try:
        bench.executor.submit(job)
    except CannotStart as error:
        return error.ending
    return bench.end_of(job)


def until_logged_by(bench: Bench, text: str, words: str) -> None:
    until = time.monotonic() + 60
    while words not in log_of(bench.made[-1]):
        bench.executor.poll(bench.made[-1])
        assert time.monotonic() < until, f"never said {words!r}: {text}"
        time.sleep(0.02)


@EVERYWHERE_IN_IMAGES
def test_a_job_reads_in_and_writes_out(isolated: Bench) -> None:
    job = isolated.job(
        "import os, pathlib\n"
        "pathlib.Path('/out/copy').write_text(pathlib.Path('/in/drive.txt').read_text())\n"
        "pathlib.Path('/tmp/scratch').write_text('x')\n"
        "print('to stdout'); os.write(2, b'to stderr')"
    )
    (job.directory / "in" / "drive.txt").write_text("bytes of a drive")
    isolated.executor.submit(job)
    ending = isolated.end_of(job)
    assert (ending.reason, ending.exit_code) == (EndReason.done, 0)
    assert (job.directory / "out" / "copy").read_text() == "bytes of a drive"
    # The last words of each, though no line ends with them.
    assert all(words in log_of(job) for words in ("to stdout", "to stderr"))


def test_a_job_can_write_only_to_its_output_folder(isolated: Bench) -> None:
    paths = ["/in/drive.txt", "/in/other", "/usr/other", "/etc/other", "/other", "/proc/sys/vm/swappiness"]
    job = isolated.job(
        f"for path in {paths}:\n"
        "    try:\n"
        "        with open(path, 'a') as file: file.write('1')\n"
        "        print('written')\n"
        "    except OSError as error: print(error.strerror)"
    )
    (job.directory / "in" / "drive.txt").write_text("bytes of a drive")
    isolated.executor.submit(job)
    assert isolated.end_of(job).reason is EndReason.done
    refusals = log_of(job).splitlines()
    assert len(refusals) == len(paths)
    assert all(re.search("Read-only|Permission|denied", refusal) for refusal in refusals), refusals
    assert (job.directory / "in" / "drive.txt").read_text() == "bytes of a drive"


@EVERYWHERE_IN_IMAGES
def test_the_sandbox_hides_the_machine(isolated: Bench) -> None:
    secret = isolated.folder / "credentials.json"
    secret.write_text("a token")
    job, ending = isolated.run(
        "import os, pathlib\n"
        f"print(pathlib.Path({str(secret)!r}).exists(), pathlib.Path({str(isolated.folder)!r}).exists())\n"
        "print(sorted(os.environ))\n"
        "print(max(int(name) for name in os.listdir('/proc') if name.isdigit()))"
    )
    assert ending.reason is EndReason.done
    seen, environment, processes = log_of(job).splitlines()
    assert seen == "False False"
    # Every pod is told where the API server of its cluster is.
    names = {name for name in re.findall(r"\w+", environment) if not name.startswith("KUBERNETES_")}
    assert names <= {
        "HOME",
        "HOSTNAME",
        "LANG",
        "LC_CTYPE",
        "PATH",
        "PYTHONUNBUFFERED",
        "TMPDIR",
        # Podman's own.
        "TERM",
        "container",
    }
    assert int(processes) < 10


@NOT_ON_THAT_CLUSTER
def test_without_network_nothing_can_be_reached(isolated: Bench) -> None:
    with socket.create_server(("0.0.0.0", 0)) as decoy:
        port = decoy.getsockname()[1]
        job, ending = isolated.run(
            "import socket\n"
            f"for host in ('127.0.0.1', {isolated.machine!r}, {socket.gethostname()!r}, '192.0.2.1'):\n"
            f"    try: socket.create_connection((host, {port}), 1)\n"
            "    except OSError as error: print('none')\n"
        )
        assert (ending.reason, log_of(job).split()) == (EndReason.done, ["none"] * 4)
        decoy.settimeout(0)
        with pytest.raises(BlockingIOError):
            decoy.accept()


def test_an_open_network_reaches_the_machine(bench: Bench) -> None:
    with socket.create_server((bench.machine, 0)) as there:
        address = there.getsockname()
        job = bench.job(f"import socket; socket.create_connection({address}, 5)", network=Network.open)
        bench.executor.submit(job)
        assert bench.end_of(job).reason is EndReason.done


@pytest.mark.parametrize("code", [1, 3, 255])
def test_exit_codes_are_reported(bench: Bench, code: int) -> None:
    _, ending = bench.run(f"raise SystemExit({code})")
    assert (ending.reason, ending.exit_code) == (EndReason.exit_code, code)
    assert str(code) in ending.message


@EVERYWHERE
def test_a_crash_is_reported(bench: Bench) -> None:
    _, ending = bench.run("import os; os.kill(os.getpid(), 11)")
    assert (ending.reason, ending.exit_code) == (EndReason.signal, 139)
    assert "SIGSEGV" in ending.message


@EVERYWHERE
def test_a_missing_command(bench: Bench) -> None:
    ending = ending_of_start(bench, bench.job(["/usr/bin/nonsense"]))
    assert (ending.reason, "/usr/bin/nonsense" in ending.message) == (EndReason.command_not_found, True)


@pytest.mark.slow
@EVERYWHERE_IN_IMAGES
def test_too_much_memory_ends_the_run_alone(bench: Bench) -> None:
    _, ending = bench.run(
        "import time\nheld = []\nwhile True: held.append(bytearray(b'x' * 5_000_000)); time.sleep(0.01)",
        memory_bytes=100_000_000,
    )
    assert (ending.reason, ending.exit_code) == (EndReason.memory, None)
    assert "100 MB" in ending.message


_PROCESS_ONLY = pytest.mark.parametrize("bench", ["process"], indirect=True)
_MEMORY_OUTSIDE_PROCESSES = {
    "memory file": "file = os.memfd_create('held')\nwhile True: os.write(file, bytes(1_000_000))",
    "memory file, mapped once": (
        "import mmap\nfor n in range(1000):\n    file = os.memfd_create('held'); os.ftruncate(file, 1_000_000)\n"
        "    with mmap.mmap(file, 1_000_000) as held: held.write(bytes(1_000_000))"
    ),
    "System V segment": (
        "import ctypes\nlibc = ctypes.CDLL(None)\nlibc.shmat.restype = ctypes.c_void_p\nfor n in range(1000):\n"
        "    key = libc.shmget(0, 1_000_000, 0o1600)\n    assert key >= 0, 'no segment'\n"
        "    held = libc.shmat(key, None, 0); ctypes.memset(held, 1, 1_000_000); libc.shmdt(ctypes.c_void_p(held))"
    ),
    "tmpfs": (
        "import subprocess\nscript = 'mount -t tmpfs none /tmp && head -c 400000000 /dev/zero > /tmp/held'\n"
        "subprocess.run(['unshare', '-Urm', 'sh', '-c', script], check=True)"
    ),
}


@_PROCESS_ONLY
@pytest.mark.parametrize("kind", _MEMORY_OUTSIDE_PROCESSES)
def test_memory_outside_processes_is_counted_or_denied(isolated: Bench, kind: str) -> None:
    _, ending = isolated.run(f"import os\n{_MEMORY_OUTSIDE_PROCESSES[kind]}", memory_bytes=60_000_000, time_s=20)
    assert ending.reason in {EndReason.memory, EndReason.exit_code}


@_PROCESS_ONLY
def test_shared_memory_is_counted(isolated: Bench) -> None:
    text = "with open('/dev/shm/held', 'wb') as file: file.write(bytes(60_000_000))\nimport time; time.sleep(10)"
    assert isolated.run(text, memory_bytes=50_000_000)[1].reason is EndReason.memory


@_PROCESS_ONLY
def test_processes_can_share_memory(isolated: Bench) -> None:
    text = (
        "import multiprocessing as m\nfrom multiprocessing.shared_memory import SharedMemory\n"
        "def fill(name):\n    held = SharedMemory(name); held.buf[:3] = b'abc'; held.close()\n"
        "held = SharedMemory(create=True, size=1_000_000)\n"
        "m.get_context('fork').Process(target=fill, args=(held.name,)).start()\n"
        "[each.join() for each in m.active_children()]\n"
        "assert bytes(held.buf[:3]) == b'abc'; held.close(); held.unlink()"
    )
    _, ending = isolated.run(text)
    assert ending.reason is EndReason.done, log_of(isolated.made[-1])


@NOT_ON_THAT_CLUSTER
@pytest.mark.parametrize("place", ["/out", "/tmp"])
def test_too_much_disk_ends_the_run(isolated: Bench, place: str) -> None:
    _, ending = isolated.run(
        f"with open('{place}/large', 'wb') as stream:\n    while True: stream.write(b'x' * 1_000_000)",
        disk_bytes=20_000_000,
    )
    assert ending.reason is EndReason.disk
    assert "20 MB" in ending.message


@NOT_ON_THAT_CLUSTER
def test_empty_files_are_counted(isolated: Bench) -> None:
    text = "import itertools\nfor n in itertools.count():\n    open(f'/out/{n}', 'w').close()"
    assert isolated.run(text, disk_bytes=2_000_000)[1].reason is EndReason.disk


@pytest.mark.slow
@NOT_ON_THAT_CLUSTER
def test_many_small_files_are_counted(isolated: Bench) -> None:
    _, ending = isolated.run(
        "import itertools\nfor n in itertools.count():\n    open(f'/out/{n}', 'wb').write(b'x' * 4096)",
        disk_bytes=4_000_000,
    )
    assert ending.reason is EndReason.disk


@pytest.mark.slow
def test_the_time_limit_ends_the_run(bench: Bench) -> None:
    _, ending = bench.run(LASTING, time_s=1)
    assert ending.reason is EndReason.time


@pytest.mark.slow
def test_a_fork_bomb_is_contained(isolated: Bench) -> None:
    _, ending = isolated.run("import os\nwhile True:\n    try: os.fork()\n    except OSError: pass", time_s=2)
    assert ending.reason in {EndReason.time, EndReason.memory}


@pytest.mark.slow
def test_a_run_that_ignores_sigterm_is_killed(bench: Bench) -> None:
    text = "import signal, time; signal.signal(15, signal.SIG_IGN); print('ready', flush=True); time.sleep(60)"
    job = bench.job(text)
    bench.executor.submit(job)
    until_logged_by(bench, text, "ready\n")
    began = time.monotonic()
    bench.executor.cancel(job)
    assert bench.end_of(job).reason is EndReason.cancelled
    assert time.monotonic() - began < GRACE_S + 7


@EVERYWHERE
def test_a_cancelled_run_may_clean_up(bench: Bench) -> None:
    text = (
        "import signal, sys, time\n"
        "def end(*_): print('tidied', flush=True); sys.exit(0)\n"
        "signal.signal(signal.SIGTERM, end); print('ready', flush=True); time.sleep(60)"
    )
    job = bench.job(text)
    bench.executor.submit(job)
    until_logged_by(bench, text, "ready\n")
    bench.executor.cancel(job)
    assert bench.end_of(job).reason is EndReason.cancelled
    assert "tidied" in log_of(job)
    bench.executor.cancel(job)


@pytest.mark.slow
def test_endless_output_is_cut(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (local, docker_container, pod_log):
        monkeypatch.setattr(module, "LOG_BYTES", 1_000_000)
    job, ending = bench.run("while True: print('y' * 1000)", time_s=2)
    assert ending.reason is EndReason.time
    assert 1_000_000 <= (job.directory / "log").stat().st_size < 1_001_000
    assert "the log is full" in log_of(job)


@pytest.mark.slow
def test_no_line_is_lost(bench: Bench) -> None:
    job, ending = bench.run("for n in range(200_000): print(f'line {n} of a log')")
    assert ending.reason is EndReason.done
    assert log_of(job).splitlines() == [f"line {n} of a log" for n in range(200_000)]


@pytest.mark.slow
def test_background_processes_of_a_run_end_with_it(isolated: Bench) -> None:
    job, ending = isolated.run(
        "import os, time\n"
        "if os.fork() == 0:\n    os.setsid()\n    time.sleep(1)\n    open('/out/late', 'w').write('x')\n"
    )
    assert ending.reason is EndReason.done
    time.sleep(1.2)
    assert not (job.directory / "out" / "late").exists()


@pytest.mark.slow
def test_another_runner_reattaches(bench: Bench) -> None:
    job = bench.job(LASTING)
    bench.executor.submit(job)
    until_logged_by(bench, LASTING, "ready\n")
    other = bench.again()
    assert wait_for_end(other, job, timeout_s=0.1) is None
    other.cancel(job)
    ending = wait_for_end(other, job, timeout_s=10)
    assert ending is not None
    assert ending.reason is EndReason.cancelled


@pytest.mark.slow
@LOCALLY
def test_usage_is_reported(bench: Bench) -> None:
    text = "held = bytearray(b'x' * 60_000_000)\nn = sum(i * i for i in range(1_000_000))\nprint('ready', flush=True)\n"
    job = bench.job(text + "import time; time.sleep(0.5)")
    bench.executor.submit(job)
    assert bench.end_of(job).reason is EndReason.done
    used = bench.executor.usage(job)
    assert used is not None
    assert used.peak_memory_bytes > 60_000_000
    assert used.cpu_s > 0.05


@pytest.mark.parametrize("bench", ["process"], indirect=True)
def test_a_job_whose_supervisor_is_killed_is_lost(isolated: Bench) -> None:
    job = isolated.job(LASTING)
    isolated.executor.submit(job)
    until_logged_by(isolated, LASTING, "ready\n")
    supervisor = int((job.directory / "supervisor").read_text())
    left = [int(pid) for pid in Path(f"/proc/{supervisor}/task/{supervisor}/children").read_text().split()]
    os.kill(supervisor, signal.SIGKILL)
    assert isolated.end_of(job).reason is EndReason.lost
    until = time.monotonic() + 60
    while any(
        Path(f"/proc/{pid}").exists() and "Z" not in Path(f"/proc/{pid}/stat").read_text().split()[2] for pid in left
    ):
        assert time.monotonic() < until
        time.sleep(0.02)


@pytest.mark.parametrize("bench", ["process"], indirect=True)
def test_images_need_an_engine(bench: Bench) -> None:
    with pytest.raises(CannotStart, match="no image") as caught:
        bench.executor.submit(bench.with_image("lab/slam:1").job(LASTING))
    assert caught.value.ending.reason is EndReason.not_possible
    with pytest.raises(CannotStart, match="no image"):
        bench.executor.prepare_image("lab/slam:1")


def answers(server: socket.socket, words: bytes) -> None:
    """Answer each connection with these words and the data received."""

    def answer() -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = server.accept()
                with connection:
                    values = b""
                    while data := connection.recv(65536):
                        values += data
                    connection.sendall(words + values)

    threading.Thread(target=answer, daemon=True).start()


CONNECT = """
import socket
def dial(host, port, data=b''):
    try:
        with socket.create_connection((host, port), 5) as there:
            there.sendall(data); there.shutdown(socket.SHUT_WR)
            return b''.join(iter(lambda: there.recv(65536), b'')).decode()
    except OSError:
        return 'none'
"""


@LOCALLY_EVERYWHERE
def test_with_port_forwards_only_the_api_and_the_store_answer(isolated: Bench) -> None:
    with contextlib.ExitStack() as stack:
        api, store, decoy = (stack.enter_context(socket.create_server(("0.0.0.0", 0))) for _ in range(3))
        answers(api, b"api:")
        answers(store, b"store:")
        forwards = [
            PortForward("kleinkram.lab.example", 443, "127.0.0.1", api.getsockname()[1]),
            PortForward("store.lab.example", 443, "127.0.0.1", store.getsockname()[1]),
            PortForward("192.168.77.7", 9000, "127.0.0.1", store.getsockname()[1]),
            PortForward("127.0.0.1", 8000, "127.0.0.1", api.getsockname()[1]),
        ]
        ports = [entry.getsockname()[1] for entry in (api, store, decoy)]
        refused = [(host, port) for host in ("127.0.0.1", isolated.machine, "127.1.0.1") for port in ports]
        refused += [("store.lab.example", 80), ("192.168.77.7", 443), ("127.0.0.1", 443), ("192.0.2.1", 443)]
        job = isolated.job(
            CONNECT
            + f"for host, port in {[(entry.host, entry.port) for entry in forwards]}: print(dial(host, port, b'hi'))\n"
            f"print({{dial(host, port) for host, port in {refused}}})\n"
            "print(len(dial('store.lab.example', 443, bytes(3_000_000))))",
            network=Network.api,
            port_forwards=forwards,
        )
        isolated.executor.submit(job)
        assert isolated.end_of(job).reason is EndReason.done
        assert log_of(job).splitlines() == ["api:hi", "store:hi", "store:hi", "api:hi", "{'none'}", "3000006"]
        decoy.settimeout(0)
        with pytest.raises(BlockingIOError):
            decoy.accept()


@LOCALLY
def test_the_target_of_a_port_forward_may_be_unavailable(isolated: Bench) -> None:
    with socket.create_server(("127.0.0.1", 0)) as gone:
        port = gone.getsockname()[1]
    forward = PortForward("kleinkram.lab.example", 443, "127.0.0.1", port)
    text = CONNECT + "print(dial('kleinkram.lab.example', 443) in ('', 'none'))"
    job = isolated.job(text, network=Network.api, port_forwards=[forward])
    isolated.executor.submit(job)
    assert isolated.end_of(job).reason is EndReason.done
    assert log_of(job) == "True\n"


@LOCALLY
def test_ipv6_addresses_cannot_be_forwarded(isolated: Bench) -> None:
    job = isolated.job("pass", network=Network.api, port_forwards=[PortForward("2001:db8::1", 443, "127.0.0.1", 1)])
    with pytest.raises(CannotStart, match="IPv6") as caught:
        isolated.executor.submit(job)
    assert caught.value.ending.reason is EndReason.not_possible


def test_a_job_whose_lease_expires_is_ended(bench: Bench) -> None:
    job = bench.job(LASTING)
    bench.executor.set_lease(job, boot_time_s() + 1.5, create=True)
    bench.executor.submit(job)
    ending = bench.end_of(job)
    assert ending.reason is EndReason.lost
    assert "no news from its runner for too long" in ending.message
