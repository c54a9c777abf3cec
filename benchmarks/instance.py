"""The measured instance: starts and ends it, runs `klein` commands, waits until it is idle."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import urllib3

ROOT = Path(__file__).resolve().parent.parent
STAGE = ROOT / ".bench"
DATA = STAGE / "data"
KLEIN = Path(sys.executable).parent / "klein"
GB = 1_000_000_000


def variables() -> dict[str, str]:
    """Return the environment of everything that runs here."""
    homes = {name: str(STAGE / name.lower()) for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_DATA_HOME")}
    # Verification runs at full speed between two runs instead of slowly during them; rate limits are off.
    limits = ("SIGN_INS", "SEARCHES")
    unbounded = {f"KLEINKRAM_{what}_PER_MINUTE": "0" for what in limits}
    at_once = {"KLEINKRAM_VERIFY_BYTES_PER_S": "2000000000"}
    return {**os.environ, **homes, **at_once, **unbounded, "KLEINKRAM_DATA_DIR": str(DATA)}


def klein(*arguments: str) -> str:
    """Run one command."""
    command = [str(KLEIN), *arguments]
    return subprocess.run(command, env=variables(), check=True, stdout=subprocess.PIPE, text=True).stdout


@contextmanager
def instance() -> Iterator[dict[str, str]]:
    """Run an instance; yields the environment by which a side reaches API and store."""
    # Not the usual port, which another instance of this machine may have.
    command = [str(KLEIN), "up", "--port", str(_free_port())]
    process = subprocess.Popen(command, env=variables(), stdout=subprocess.PIPE, text=True)
    try:
        if not (process.stdout and process.stdout.readline()):
            raise SystemExit("Kleinkram did not start")
        worker = psutil.Process(endpoint_info()["services"]["worker"])
        inherited = {
            key: value
            for key, value in worker.environ().items()
            if key.startswith("KLEINKRAM_") and key != "KLEINKRAM_METRICS_PORT"  # that port is the worker's own
        }
        yield {**variables(), **inherited}
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=60)


def endpoint_info() -> dict[str, Any]:
    """Return the contents of `instance.json`."""
    facts: dict[str, Any] = json.loads((DATA / "instance.json").read_text())
    return facts


@contextmanager
def api_process(environment: Mapping[str, str]) -> Iterator[tuple[str, psutil.Process]]:
    """Run one more API process beside the instance's own; yields its URL and the process."""
    port = _free_port()
    without = {key: value for key, value in environment.items() if key != "KLEINKRAM_OWNER_TOKEN_FILE"}
    process = subprocess.Popen([sys.executable, "-m", "kleinkram.server", "api", "--port", str(port)], env=without)
    url = f"http://127.0.0.1:{port}"
    try:
        _wait_until_ready(url)
        yield url, psutil.Process(process.pid)
    finally:
        process.terminate()
        process.wait(timeout=60)


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
        return port


def _wait_until_ready(url: str) -> None:
    until = time.monotonic() + 60
    while time.monotonic() < until:
        try:
            if urllib3.request("GET", f"{url}/health/ready", retries=False, timeout=5).status == 200:
                return
        except urllib3.exceptions.HTTPError:
            pass
        time.sleep(0.1)
    raise SystemExit("an API process did not begin to answer")


def settle() -> None:
    """Wait until no job is queued or running, so that none disturbs a measurement."""
    while True:
        with urllib.request.urlopen(
            f"http://127.0.0.1:{endpoint_info()['ports']['api_metrics']}/metrics", timeout=60
        ) as answer:
            lines = answer.read().decode().splitlines()
        busy = [
            line for line in lines if line.startswith("kleinkram_jobs{") and ('"todo"' in line or '"doing"' in line)
        ]
        if (
            sum(
                float(line.rsplit(" ", 1)[1])
                for line in busy
                if "finish_uploads" not in line and "collect_garbage" not in line
            )
            == 0
        ):
            return
        time.sleep(0.2)


def mission_with(name: str, source: Path) -> str:
    """Upload a file into a new mission; returns the mission's id."""
    klein("upload", "-p", "bench", "-m", name, "--create", str(source))
    settle()
    mission = json.loads(klein("mission", "info", name, "-p", "bench", "--json"))
    return str(mission["mission"]["id"])
