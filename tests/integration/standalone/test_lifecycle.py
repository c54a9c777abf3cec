"""Start, stop, crash and recovery of `klein up`."""

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from kleinkram.contract.tokens import is_whole
from kleinkram.standalone import s3, store
from kleinkram.standalone.address import Listening
from kleinkram.standalone.data_dir import DataDir, load_secrets
from kleinkram.standalone.errors import NotRunning
from kleinkram.standalone.health import is_ready
from kleinkram.standalone.leftovers import stop_instance
from kleinkram.standalone.ports import is_free
from kleinkram.standalone.procs import start_ticks
from tests.integration.standalone.conftest import Instance, wait_until

PARTS = ("store", "postgres", "api", "worker")


def _store_access(instance: Instance) -> s3.StoreAccess:
    secrets = load_secrets(DataDir(instance.data_dir))
    return s3.StoreAccess(instance.told["store_url"], secrets.s3_access_key, secrets.s3_secret_key)


def _answers(instance: Instance) -> bool:
    return is_ready(instance.told["url"]) and s3.proves_ready(_store_access(instance), store.BUCKET)


def _unexpected(said: str) -> str:
    """Return what a supervisor should not have said: of some stores it says that they take long to begin."""
    return "".join(
        line for line in said.splitlines(keepends=True) if "the store listens but takes no bytes" not in line
    )


def _runs_again(instance: Instance, part: str, killed: int) -> bool:
    return instance.told["parts"][part] not in (None, killed)


def test_up_answers_and_ctrl_c_ends_everything(shared_instance: Instance) -> None:
    process = shared_instance.up()
    wait_until(lambda: _answers(shared_instance))
    token = shared_instance.data_dir / "owner-token"
    assert token.stat().st_mode & 0o777 == 0o600
    assert is_whole(token.read_text().strip())
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, _unexpected(err)) == (0, "", "")
    assert shared_instance.processes == []
    assert not (shared_instance.data_dir / "instance.json").exists()


@pytest.mark.slow
def test_objects_tokens_and_ports_survive_a_restart(shared_instance: Instance) -> None:
    first = shared_instance.up()
    told, token = shared_instance.told, (shared_instance.data_dir / "owner-token").read_text()
    assert s3.request(_store_access(shared_instance), "PUT", "/kleinkram/kept", body=b"bytes")[0] == 200
    first.terminate()
    first.communicate(timeout=60)
    shared_instance.up()
    assert s3.request(_store_access(shared_instance), "GET", "/kleinkram/kept") == (200, b"bytes")
    assert shared_instance.told["ports"] == told["ports"]
    assert (shared_instance.data_dir / "owner-token").read_text() == token
    stop_instance(DataDir(shared_instance.data_dir))


def test_the_store_gives_nothing_to_whoever_finds_its_other_ports(shared_instance: Instance) -> None:
    # Such as a page in a browser on this machine, which may ask loopback addresses whatever it likes.
    shared_instance.up()
    ports = json.loads((shared_instance.data_dir / "ports.json").read_text())
    access = _store_access(shared_instance)
    assert s3.request(access, "PUT", "/kleinkram/safe", body=b"bytes")[0] == 200
    for port, method, path, status in (
        ("filer", "GET", "/buckets/", 404),
        ("filer", "DELETE", "/buckets/kleinkram?recursive=true", 404),
        ("filer", "PUT", "/buckets/x", 404),
        ("master", "GET", f"/col/delete?collection={store.BUCKET}", 404),
        ("master", "GET", "/vol/status", 404),  # names its collections
        ("master", "GET", "/dir/lookup?fileId=1,01637037d6", 404),  # signs what deletes an object
        ("master", "GET", "/vol/grow?count=1", 404),
        ("master", "POST", "/submit", 404),
        ("volume", "DELETE", "/1,01637037d6", 401),
    ):
        asked = http.client.HTTPConnection("127.0.0.1", ports[port], timeout=10)
        asked.request(method, path)
        assert (port, path, asked.getresponse().status) == (port, path, status)
        asked.close()
    assert s3.request(access, "GET", "/kleinkram/safe") == (200, b"bytes")
    stop_instance(DataDir(shared_instance.data_dir))


def test_down_from_elsewhere_ends_it_and_says_so_when_nothing_runs(shared_instance: Instance) -> None:
    process = shared_instance.up()
    stop_instance(DataDir(shared_instance.data_dir))
    process.communicate(timeout=60)
    assert process.returncode == 0
    assert shared_instance.processes == []
    with pytest.raises(NotRunning, match="does not run"):
        stop_instance(DataDir(shared_instance.data_dir))


def test_up_and_down_say_in_json_what_runs_and_what_ended(shared_instance: Instance) -> None:
    process = shared_instance.spawn(as_json=True)
    assert process.stdout is not None
    said = json.loads(process.stdout.readline())
    assert said == shared_instance.told
    assert said["data_dir"] == str(shared_instance.data_dir)
    assert said["pid"] == process.pid
    assert tuple(sorted(said["parts"])) == tuple(sorted(PARTS))
    wait_until(lambda: is_ready(said["url"]))
    assert s3.proves_ready(_store_access(shared_instance), store.BUCKET)
    klein = str(Path(sys.executable).parent / "klein")
    down = [klein, "down", "--data-dir", str(shared_instance.data_dir), "--json"]
    ended = json.loads(subprocess.run(down, check=True, capture_output=True, text=True).stdout)
    assert ended == {name: said[name] for name in ("data_dir", "pid", "parts")}
    out, err = process.communicate(timeout=60)
    assert (out, _unexpected(err)) == ("", "")
    again = subprocess.run(down, check=False, capture_output=True, text=True)
    assert (again.returncode, again.stdout) == (1, "")
    assert "does not run" in again.stderr


def test_down_names_no_parts_of_an_instance_that_was_killed(shared_instance: Instance) -> None:
    process = shared_instance.up()
    parts = {name: pid for name, pid in shared_instance.told["parts"].items() if pid is not None}
    # What one leaves that is killed, and what the next has not replaced yet.
    left = {**shared_instance.told, "pid": process.pid + 1, "parts": parts}
    (shared_instance.data_dir / "instance.json").write_text(json.dumps(left))
    ended = stop_instance(DataDir(shared_instance.data_dir))
    assert (ended.pid, ended.parts) == (process.pid, {})
    process.communicate(timeout=60)


def test_down_never_signals_a_process_that_got_the_pid_since(shared_instance: Instance) -> None:
    with subprocess.Popen(["sleep", "1000"]) as stranger:
        lock = shared_instance.data_dir / "lock"
        lock.write_text(f'{{"pid": {stranger.pid}, "start_ticks": {(start_ticks(stranger.pid) or 0) - 1}}}')
        with pytest.raises(NotRunning):
            stop_instance(DataDir(shared_instance.data_dir))
        assert stranger.poll() is None
        stranger.kill()


def test_a_second_up_on_the_same_folder_is_refused(shared_instance: Instance) -> None:
    first = shared_instance.up()
    said = shared_instance.refused()
    assert f"already runs on {shared_instance.data_dir} (pid {first.pid})" in said
    wait_until(lambda: _answers(shared_instance))
    stop_instance(DataDir(shared_instance.data_dir))


def test_every_part_that_is_killed_comes_back(shared_instance: Instance) -> None:
    process = shared_instance.up()
    for part in PARTS:
        pid = shared_instance.told["parts"][part]
        os.kill(pid, signal.SIGKILL)
        wait_until(partial(_runs_again, shared_instance, part, pid))
    wait_until(lambda: _answers(shared_instance))
    stop_instance(DataDir(shared_instance.data_dir))
    said = process.communicate(timeout=60)[1]
    for part in PARTS:
        assert f"{part} has ended (killed by signal 9)" in said
        assert f"{part} was started again" in said
    assert shared_instance.processes == []


def test_nothing_outlives_a_killed_supervisor_and_the_next_up_recovers(shared_instance: Instance) -> None:
    process = shared_instance.up()
    wait_until(
        lambda: "sleep" in [Path(f"/proc/{each}/comm").read_text().strip() for each in shared_instance.processes]
    )
    before = set(shared_instance.processes)
    process.kill()
    process.communicate(timeout=60)
    # The worker's own child has no bond to the supervisor: it is what the next start must end.
    wait_until(lambda: len(shared_instance.processes) <= 1)
    survivors = set(shared_instance.processes)
    assert survivors < before
    shared_instance.up()
    assert not survivors & set(shared_instance.processes)
    wait_until(lambda: _answers(shared_instance))
    stop_instance(DataDir(shared_instance.data_dir))


def test_each_process_is_told_what_it_needs_and_no_more(shared_instance: Instance) -> None:
    shared_instance.up()
    wait_until((shared_instance.data_dir / "told-worker.json").exists)
    told = {
        name: json.loads((shared_instance.data_dir / f"told-{name}.json").read_text())
        for name in ("migrate", "api", "worker")
    }
    assert "KLEINKRAM_MIGRATION_DATABASE_URL" in told["migrate"]
    assert "KLEINKRAM_MIGRATION_DATABASE_URL" not in told["api"] | told["worker"]
    assert urlsplit(told["api"]["KLEINKRAM_DATABASE_URL"]).username == "kleinkram_serve"
    assert told["api"]["KLEINKRAM_S3_PUBLIC_URL"] == shared_instance.told["store_url"]
    stop_instance(DataDir(shared_instance.data_dir))


def test_a_stop_during_the_start_leaves_nothing(instance: Instance) -> None:
    process = instance.spawn()
    wait_until(lambda: instance.processes)
    process.terminate()
    process.communicate(timeout=60)
    assert process.returncode == 0
    assert instance.processes == []


def test_a_port_that_is_taken_after_it_was_chosen_is_chosen_again(instance: Instance) -> None:
    process = instance.spawn(listening=Listening())
    ports = instance.data_dir / "ports.json"
    wait_until(ports.exists)
    chosen = json.loads(ports.read_text())["api"]  # the API is the last to take its port
    with socket.create_server(("127.0.0.1", chosen)):
        assert process.stdout is not None
        assert "answers at" in process.stdout.readline()
        assert instance.told["ports"]["api"] != chosen
        wait_until(lambda: _answers(instance))
        process.terminate()
        assert f"another program took port {chosen} (" in process.communicate(timeout=60)[1]
    assert instance.processes == []


def _port_taken_while_down(instance: Instance, process: "subprocess.Popen[str]", part: str, port: int) -> socket.socket:
    """Kill a part, and take its port before the supervisor has seen it."""
    process.send_signal(signal.SIGSTOP)
    os.kill(instance.told["parts"][part], signal.SIGKILL)
    wait_until(lambda: is_free(port))
    taken = socket.create_server(("127.0.0.1", port))
    process.send_signal(signal.SIGCONT)
    return taken


@pytest.mark.parametrize("part", ["api", "postgres"])
def test_a_chosen_port_that_is_taken_while_its_part_is_down_is_chosen_again(instance: Instance, part: str) -> None:
    process = instance.up(listening=Listening())
    before = instance.told["ports"][part]
    with _port_taken_while_down(instance, process, part, before):
        assert process.stdout is not None
        assert "answers at" in process.stdout.readline()
        assert instance.told["ports"][part] != before
        wait_until(lambda: _answers(instance))
        process.terminate()
        assert f"another program took port {before} (" in process.communicate(timeout=60)[1]
    assert instance.processes == []


def test_a_port_that_was_asked_for_and_is_taken_while_its_part_is_down_is_named(shared_instance: Instance) -> None:
    process = shared_instance.up()
    port = shared_instance.told["ports"]["api"]
    with _port_taken_while_down(shared_instance, process, "api", port):
        assert process.stderr is not None
        said = next(line for line in process.stderr if "cannot have" in line)
        assert f"api cannot have port {port} (" in said
        assert "which --port asked for: end that program" in said
    wait_until(lambda: _answers(shared_instance))
    assert shared_instance.told["ports"]["api"] == port
    stop_instance(DataDir(shared_instance.data_dir))


_WAITING = """
import signal
import sys
from kleinkram.standalone import supervisor
signal.pthread_sigmask(signal.SIG_BLOCK, supervisor._WATCHED)
print("waiting", flush=True)
supervisor.pause(float(sys.argv[1]))
print("went on", flush=True)
supervisor.pause(60)
"""


def _waiting(*before: str, for_s: float = 0.3) -> "subprocess.Popen[str]":
    command = [*before, sys.executable, "-c", _WAITING, str(for_s)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "waiting\n"
    return process


def test_a_supervisor_that_is_stopped_until_after_its_time_goes_on() -> None:
    """Ctrl-Z and fg."""
    process = _waiting()
    wait_until(lambda: Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] == "S")
    process.send_signal(signal.SIGSTOP)
    over = time.monotonic() + 0.4
    wait_until(lambda: time.monotonic() > over)
    process.send_signal(signal.SIGCONT)
    assert process.stdout is not None
    assert process.stdout.readline() == "went on\n"
    process.terminate()
    assert "StopAsked" in process.communicate(timeout=60)[1]


def test_a_terminal_that_goes_ends_it_unless_nohup_said_otherwise() -> None:
    for before, ends in (((), True), (("nohup",), False)):
        process = _waiting(*before, for_s=60 if ends else 0.3)
        process.send_signal(signal.SIGHUP)
        assert process.stdout is not None
        assert process.stdout.readline() == ("" if ends else "went on\n")
        process.terminate()
        assert "StopAsked" in process.communicate(timeout=60)[1]


@pytest.mark.parametrize("failing", ["migrate", "api"])
def test_a_server_that_cannot_start_is_named_with_its_log(instance: Instance, failing: str) -> None:
    # What is not to fail waits, as the API does until it is told to begin.
    script = f'if [ "$0" = {failing} ]; then echo no such thing >&2; exit 3; fi; [ "$0" != api ] || exec sleep 1000'
    said = instance.refused(server=("/bin/sh", "-c", script))
    assert f"The part '{failing}' ended (exit code 3)" in said
    assert "its last line: no such thing" in said
    assert instance.processes == []
