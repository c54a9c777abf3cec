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

from kleinkram.contract.token_format import has_valid_checksum
from kleinkram.standalone import object_store
from kleinkram.standalone.address import Listening, is_free
from kleinkram.standalone.data_dir import DataDir, load_secrets
from kleinkram.standalone.errors import NotRunning
from kleinkram.standalone.http_client import is_ready
from kleinkram.standalone.processes import start_ticks
from kleinkram.standalone.supervisor import stop_instance
from tests.integration.standalone.conftest import Instance, wait_until

SERVICES = ("store", "postgres", "api", "worker")


def _store_access(instance: Instance) -> object_store.StoreAccess:
    secrets = load_secrets(DataDir(instance.data_dir))
    return object_store.StoreAccess(instance.runtime_info["store_url"], secrets.s3_access_key, secrets.s3_secret_key)


def _answers(instance: Instance) -> bool:
    return is_ready(instance.runtime_info["url"]) and object_store.is_ready(
        _store_access(instance), object_store.BUCKET
    )


def _unexpected(output: str) -> str:
    """Return what a supervisor should not have output: of some stores it says that they take long to begin."""
    return "".join(
        line for line in output.splitlines(keepends=True) if "the store listens but accepts no writes" not in line
    )


def _runs_again(instance: Instance, service: str, killed: int) -> bool:
    return instance.runtime_info["services"][service] not in (None, killed)


def _sockets() -> set[Path]:
    return set(Path("/tmp").glob("seaweedfs-*.sock"))


def test_up_answers_and_ctrl_c_ends_everything(shared_instance: Instance) -> None:
    sockets_before = _sockets()
    process = shared_instance.up()
    wait_until(lambda: _answers(shared_instance))
    token = shared_instance.data_dir / "owner-token"
    assert token.stat().st_mode & 0o777 == 0o600
    assert has_valid_checksum(token.read_text().strip())
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, _unexpected(err)) == (0, "", "")
    ports = json.loads((shared_instance.data_dir / "ports.json").read_text()).values()
    numbers = {str(number) for port in ports for number in (port, port + 10_000)}
    # Those that an instance left that was killed, and had one of these numbers for something else, are not its own.
    sockets = [path for path in _sockets() - sockets_before if path.stem.rpartition("-")[2] in numbers]
    assert sockets == []
    assert shared_instance.processes == []
    assert not (shared_instance.data_dir / "instance.json").exists()


@pytest.mark.slow
def test_objects_tokens_and_ports_survive_a_restart(shared_instance: Instance) -> None:
    first = shared_instance.up()
    environments, token = shared_instance.runtime_info, (shared_instance.data_dir / "owner-token").read_text()
    assert object_store.request(_store_access(shared_instance), "PUT", "/kleinkram/kept", body=b"bytes").status == 200
    first.terminate()
    first.communicate(timeout=60)
    shared_instance.up()
    assert object_store.request(_store_access(shared_instance), "GET", "/kleinkram/kept").body == b"bytes"
    assert shared_instance.runtime_info["ports"] == environments["ports"]
    assert (shared_instance.data_dir / "owner-token").read_text() == token
    stop_instance(DataDir(shared_instance.data_dir))


def test_other_ports_of_the_store_refuse_requests(shared_instance: Instance) -> None:
    # Such as a page in a browser on this machine, which may ask loopback addresses whatever it likes.
    shared_instance.up()
    ports = json.loads((shared_instance.data_dir / "ports.json").read_text())
    access = _store_access(shared_instance)
    assert object_store.request(access, "PUT", "/kleinkram/safe", body=b"bytes").status == 200
    for port, method, path, status in (
        ("filer", "GET", "/buckets/", 404),
        ("filer", "DELETE", "/buckets/kleinkram?recursive=true", 404),
        ("filer", "PUT", "/buckets/x", 404),
        ("master", "GET", f"/col/delete?collection={object_store.BUCKET}", 404),
        ("master", "GET", "/vol/status", 404),  # names its collections
        ("master", "GET", "/dir/lookup?fileId=1,01637037d6", 404),  # signs what deletes an object
        ("master", "GET", "/vol/grow?count=1", 404),
        ("master", "POST", "/submit", 404),
        ("volume", "DELETE", "/1,01637037d6", 401),
    ):
        connection = http.client.HTTPConnection("127.0.0.1", ports[port], timeout=10)
        connection.request(method, path)
        assert (port, path, connection.getresponse().status) == (port, path, status)
        connection.close()
    assert object_store.request(access, "GET", "/kleinkram/safe").body == b"bytes"
    stop_instance(DataDir(shared_instance.data_dir))


def test_down_ends_an_instance_and_fails_when_none_runs(shared_instance: Instance) -> None:
    process = shared_instance.up()
    stop_instance(DataDir(shared_instance.data_dir))
    process.communicate(timeout=60)
    assert process.returncode == 0
    assert shared_instance.processes == []
    with pytest.raises(NotRunning, match="is not running"):
        stop_instance(DataDir(shared_instance.data_dir))


def test_up_and_down_print_json(shared_instance: Instance) -> None:
    process = shared_instance.spawn(as_json=True)
    assert process.stdout is not None
    output = json.loads(process.stdout.readline())
    assert output == shared_instance.runtime_info
    assert output["data_dir"] == str(shared_instance.data_dir)
    assert output["pid"] == process.pid
    assert tuple(sorted(output["services"])) == tuple(sorted(SERVICES))
    wait_until(lambda: is_ready(output["url"]))
    assert object_store.is_ready(_store_access(shared_instance), object_store.BUCKET)
    klein = str(Path(sys.executable).parent / "klein")
    down = [klein, "down", "--data-dir", str(shared_instance.data_dir), "--json"]
    ended = json.loads(subprocess.run(down, check=True, capture_output=True, text=True).stdout)
    assert ended == {name: output[name] for name in ("data_dir", "pid", "services")}
    out, err = process.communicate(timeout=60)
    assert (out, _unexpected(err)) == ("", "")
    again = subprocess.run(down, check=False, capture_output=True, text=True)
    assert (again.returncode, again.stdout) == (1, "")
    assert "is not running" in again.stderr


def test_down_names_no_services_of_a_killed_instance(shared_instance: Instance) -> None:
    process = shared_instance.up()
    services = {name: pid for name, pid in shared_instance.runtime_info["services"].items() if pid is not None}
    # What one leaves that is killed, and what the next has not replaced yet.
    left = {**shared_instance.runtime_info, "pid": process.pid + 1, "services": services}
    (shared_instance.data_dir / "instance.json").write_text(json.dumps(left))
    ended = stop_instance(DataDir(shared_instance.data_dir))
    assert (ended.pid, ended.services) == (process.pid, {})
    process.communicate(timeout=60)


def test_down_never_signals_a_later_process_with_the_same_pid(shared_instance: Instance) -> None:
    with subprocess.Popen(["sleep", "1000"]) as stranger:
        lock = shared_instance.data_dir / "lock"
        lock.write_text(f'{{"pid": {stranger.pid}, "start_ticks": {(start_ticks(stranger.pid) or 0) - 1}}}')
        with pytest.raises(NotRunning):
            stop_instance(DataDir(shared_instance.data_dir))
        assert stranger.poll() is None
        stranger.kill()


def test_a_second_up_on_the_same_folder_is_refused(shared_instance: Instance) -> None:
    first = shared_instance.up()
    output = shared_instance.refused()
    assert f"already runs on {shared_instance.data_dir} (pid {first.pid})" in output
    wait_until(lambda: _answers(shared_instance))
    stop_instance(DataDir(shared_instance.data_dir))


def test_every_killed_service_is_restarted(shared_instance: Instance) -> None:
    process = shared_instance.up()
    for service in SERVICES:
        pid = shared_instance.runtime_info["services"][service]
        os.kill(pid, signal.SIGKILL)
        wait_until(partial(_runs_again, shared_instance, service, pid))
    wait_until(lambda: _answers(shared_instance))
    stop_instance(DataDir(shared_instance.data_dir))
    output = process.communicate(timeout=60)[1]
    for service in SERVICES:
        assert f"{service} has ended (killed by signal 9)" in output
        assert f"{service} was restarted" in output
    assert shared_instance.processes == []


def test_nothing_outlives_a_killed_supervisor_and_the_next_up_recovers(shared_instance: Instance) -> None:
    process = shared_instance.up()
    wait_until(lambda: "sleep" in [Path(f"/proc/{pid}/comm").read_text().strip() for pid in shared_instance.processes])
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


def test_each_process_gets_only_the_settings_it_needs(shared_instance: Instance) -> None:
    shared_instance.up()
    wait_until((shared_instance.data_dir / "environment-worker.json").exists)
    environments = {
        name: json.loads((shared_instance.data_dir / f"environment-{name}.json").read_text())
        for name in ("migrate", "api", "worker")
    }
    assert "KLEINKRAM_MIGRATION_DATABASE_URL" in environments["migrate"]
    assert "KLEINKRAM_MIGRATION_DATABASE_URL" not in environments["api"] | environments["worker"]
    assert urlsplit(environments["api"]["KLEINKRAM_DATABASE_URL"]).username == "kleinkram_serve"
    assert environments["api"]["KLEINKRAM_S3_PUBLIC_URL"] == shared_instance.runtime_info["store_url"]
    stop_instance(DataDir(shared_instance.data_dir))


def test_a_stop_during_the_start_leaves_nothing(instance: Instance) -> None:
    process = instance.spawn()
    wait_until(lambda: instance.processes)
    process.terminate()
    process.communicate(timeout=60)
    assert process.returncode == 0
    assert instance.processes == []


def test_a_port_taken_after_it_was_chosen_is_replaced(instance: Instance) -> None:
    process = instance.spawn(listening=Listening())
    ports = instance.data_dir / "ports.json"
    wait_until(ports.exists)
    chosen = json.loads(ports.read_text())["api"]  # the API is the last to take its port
    with socket.create_server(("127.0.0.1", chosen)):
        assert process.stdout is not None
        assert "answers at" in process.stdout.readline()
        assert instance.runtime_info["ports"]["api"] != chosen
        wait_until(lambda: _answers(instance))
        process.terminate()
        assert f"another program took port {chosen} (" in process.communicate(timeout=60)[1]
    assert instance.processes == []


def _port_taken_while_down(
    instance: Instance, process: "subprocess.Popen[str]", service: str, port: int
) -> socket.socket:
    """Kill a service, and take its port before the supervisor has seen it."""
    process.send_signal(signal.SIGSTOP)
    os.kill(instance.runtime_info["services"][service], signal.SIGKILL)
    wait_until(lambda: is_free(port))
    taken = socket.create_server(("127.0.0.1", port))
    process.send_signal(signal.SIGCONT)
    return taken


@pytest.mark.parametrize("service", ["api", "postgres"])
def test_a_chosen_port_taken_while_its_service_is_down_is_replaced(instance: Instance, service: str) -> None:
    process = instance.up(listening=Listening())
    before = instance.runtime_info["ports"][service]
    with _port_taken_while_down(instance, process, service, before):
        assert process.stdout is not None
        assert "answers at" in process.stdout.readline()
        assert instance.runtime_info["ports"][service] != before
        wait_until(lambda: _answers(instance))
        process.terminate()
        assert f"another program took port {before} (" in process.communicate(timeout=60)[1]
    assert instance.processes == []


def test_a_requested_port_taken_while_its_service_is_down_is_reported(shared_instance: Instance) -> None:
    process = shared_instance.up()
    port = shared_instance.runtime_info["ports"]["api"]
    with _port_taken_while_down(shared_instance, process, "api", port):
        assert process.stderr is not None
        output = next(line for line in process.stderr if "cannot use" in line)
        assert f"api cannot use port {port} (" in output
        assert "requested by --port: end that program" in output
    wait_until(lambda: _answers(shared_instance))
    assert shared_instance.runtime_info["ports"]["api"] == port
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


def test_a_suspended_supervisor_continues() -> None:
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
    assert "EndRequested" in process.communicate(timeout=60)[1]


def test_a_closed_terminal_ends_it_except_under_nohup() -> None:
    for before, ends in (((), True), (("nohup",), False)):
        process = _waiting(*before, for_s=60 if ends else 0.3)
        process.send_signal(signal.SIGHUP)
        assert process.stdout is not None
        assert process.stdout.readline() == ("" if ends else "went on\n")
        process.terminate()
        assert "EndRequested" in process.communicate(timeout=60)[1]


@pytest.mark.parametrize("failing", ["migrate", "api"])
def test_a_failing_start_is_reported_with_its_log(instance: Instance, failing: str) -> None:
    # What is not to fail waits, as the API does until it is environments to begin.
    script = f'if [ "$0" = {failing} ]; then echo no such thing >&2; exit 3; fi; [ "$0" != api ] || exec sleep 1000'
    output = instance.refused(server=("/bin/sh", "-c", script))
    assert f"The service '{failing}' ended (exit code 3)" in output
    assert "its last line: no such thing" in output
    assert instance.processes == []
