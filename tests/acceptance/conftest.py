"""A whole `klein up` for the session, and people at terminals who use it."""

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import urllib3

from tests.ports import choose_port

from .browser import Browser

KLEIN = Path(sys.executable).parent / "klein"
PATIENCE_S = 60.0


@dataclass(frozen=True)
class Ran:
    """What a command did."""

    code: int
    out: str
    err: str

    def json(self) -> Any:
        """The JSON on stdout, which is all there is on it."""
        return json.loads(self.out)


@dataclass(frozen=True)
class Terminal:
    """One person's terminal: their own configuration and journals, in front of one server."""

    home: Path
    environment: dict[str, str]
    prefix: tuple[str, ...] = ()  # what its commands run inside of

    def run(self, *arguments: object, code: int | None = 0, stdin: str = "") -> Ran:
        """Run a command to its end and check its exit code, unless that is None."""
        done = subprocess.run(
            self.command(*arguments), env=self.environment, input=stdin, capture_output=True, text=True, timeout=100
        )
        ran = Ran(done.returncode, done.stdout, done.stderr)
        assert code is None or ran.code == code, f"klein {arguments}: {ran}"
        return ran

    def start(self, *arguments: object) -> "subprocess.Popen[str]":
        """Start a command and leave it running."""
        return subprocess.Popen(
            self.command(*arguments), env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def command(self, *arguments: object) -> list[str]:
        """The command line."""
        return [*self.prefix, str(KLEIN), *(str(argument) for argument in arguments)]

    def journals(self) -> list[Path]:
        """The journals of uploads that have not ended."""
        return [*(self.home / "state" / "kleinkram" / "uploads").glob("*.jsonl")]

    def parts_sent(self) -> int:
        """How many parts the journals say the store has taken."""
        return sum(max(0, len(journal.read_text().splitlines()) - 1) for journal in self.journals())


@dataclass(frozen=True)
class Instance:
    """A running `klein up`."""

    data_dir: Path

    def runtime_info(self) -> dict[str, Any]:
        """What it says of itself."""
        runtime_info: dict[str, Any] = json.loads((self.data_dir / "instance.json").read_text())
        return runtime_info

    def kill_part(self, name: str) -> int:
        """Kill one of its parts, as a crash would, and return the pid it had."""
        pid: int = self.runtime_info()["services"][name]
        os.kill(pid, signal.SIGKILL)
        return pid


def wait_until(holds: Callable[[], bool], what: str) -> None:
    """Wait for something, and fail by its name when it does not come."""
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        if time.monotonic() > deadline:
            pytest.fail(f"waited in vain: {what}")
        time.sleep(0.02)


def end(process: "subprocess.Popen[str]") -> Ran:
    """Wait for a command's end."""
    out, err = process.communicate(timeout=100)
    return Ran(process.returncode, out, err)


@pytest.fixture(scope="package")
def instance(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Instance]:
    """One instance for all stories; even an idle one takes CPU time, so it ends with them."""
    with running_instance(tmp_path_factory.mktemp("up")) as running:
        yield running


@contextmanager
def running_instance(home: Path, **settings: str) -> Iterator[Instance]:
    """Run `klein up` in an empty folder; `settings` are further variables of its environment."""
    short = {"KLEINKRAM_PART_URL_S": "4", "KLEINKRAM_DOWNLOAD_URL_S": "4"}  # so that slow transfers outlive them
    often = {"KLEINKRAM_SIGN_INS_PER_MINUTE": "1000"}  # all stories come from one address
    environment = {**_environment(home, home / "data"), **short, **often, **settings}
    ports = ["--port", str(choose_port()), "--s3-port", str(choose_port())]  # the usual ones may be somebody's
    process = subprocess.Popen([str(KLEIN), "up", *ports], env=environment, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline(), "klein up did not start"
        yield Instance(home / "data")
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)


@pytest.fixture
def terminal(instance: Instance, tmp_path: Path) -> Terminal:
    """A person on the machine that runs the instance."""
    return _terminal(instance, tmp_path / "one")


@pytest.fixture
def other_terminal(instance: Instance, tmp_path: Path) -> Terminal:
    """The same person with other journals, as on another machine."""
    return _terminal(instance, tmp_path / "two")


@pytest.fixture
def project(terminal: Terminal) -> str:
    """A project of the test's own."""
    name = f"project-{uuid.uuid4().hex[:8]}"
    terminal.run("project", "create", name)
    return name


@pytest.fixture
def browser(terminal: Terminal) -> Iterator[Browser]:
    """The browser of the owner of `klein up`, signed in by a one-time link."""
    link = urlsplit(terminal.run("session", "link").out.strip())
    url = f"{link.scheme}://{link.netloc}"
    with urllib3.PoolManager(retries=False, timeout=20) as pool:
        stranger = Browser(url, "", pool)
        yield replace(stranger, cookie=stranger.sign_in("/auth/link", {"code": link.fragment}))


@pytest.fixture
def away(tmp_path: Path) -> Terminal:
    """A terminal on another machine: it knows of no server."""
    return terminal_away(tmp_path / "away")


def terminal_away(home: Path) -> Terminal:
    """A terminal on another machine, of whoever signs in there: it knows of no server."""
    home.mkdir()
    return Terminal(home, {**_environment(home, home / "none"), "BROWSER": "true"})


def _terminal(instance: Instance, home: Path) -> Terminal:
    home.mkdir()
    return Terminal(home, _environment(home, instance.data_dir))


def _environment(home: Path, data_dir: Path) -> dict[str, str]:
    ours = {name: str(home / name[4:-5].lower()) for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_DATA_HOME")}
    inherited = {key: value for key, value in os.environ.items() if not key.startswith("KLEINKRAM_")}
    return {**inherited, **ours, "KLEINKRAM_DATA_DIR": str(data_dir)}
