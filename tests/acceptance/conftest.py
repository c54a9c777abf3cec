"""One `klein up` for all acceptance tests, and terminals that use it."""

import json
import os
import signal
import subprocess
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

from tests.klein import KLEIN, run_klein
from tests.ports import choose_port
from tests.template_instance import copy_template

from .browser import Browser

TIMEOUT_S = 60.0
_LONGEST_PAUSE_S = 2.0


@dataclass(frozen=True)
class Ran:
    """The result of a command."""

    code: int
    out: str
    err: str

    def json(self) -> Any:
        """Parse stdout, which contains nothing but JSON."""
        return json.loads(self.out)


@dataclass(frozen=True)
class Terminal:
    """A terminal of one person, with its own configuration and journals."""

    home: Path
    environment: dict[str, str]
    prefix: tuple[str, ...] = ()  # the beginning of each command line

    def run(self, *arguments: object, code: int | None = 0, stdin: str = "") -> Ran:
        """Run a command to its end, and check its exit code unless `code` is None."""
        words = [str(argument) for argument in arguments]
        done = run_klein(words, self.environment, stdin=stdin, prefix=self.prefix)
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
        """The number of uploaded parts in the journals."""
        return sum(max(0, len(journal.read_text().splitlines()) - 1) for journal in self.journals())


@dataclass(frozen=True)
class Instance:
    """A running `klein up`."""

    data_dir: Path

    def runtime_info(self) -> dict[str, Any]:
        """The contents of its `instance.json`."""
        runtime_info: dict[str, Any] = json.loads((self.data_dir / "instance.json").read_text())
        return runtime_info

    def kill_process(self, name: str) -> int:
        """Kill one of its processes with SIGKILL, and return its pid."""
        pid: int = self.runtime_info()["services"][name]
        os.kill(pid, signal.SIGKILL)
        return pid


def wait_until(condition: Callable[[], bool], description: str, *, timeout_s: float = TIMEOUT_S) -> None:
    """Wait until a condition holds; fail with its description after a timeout.

    Conditions that start a command take CPU time from what they wait for: at most a quarter of the time is theirs.
    """
    deadline = time.monotonic() + timeout_s
    started = time.monotonic()
    while not condition():
        ended = time.monotonic()
        if ended > deadline:
            pytest.fail(f"timeout while waiting for: {description}")
        time.sleep(min(max(0.02, 3 * (ended - started)), _LONGEST_PAUSE_S))
        started = time.monotonic()


def end(process: "subprocess.Popen[str]") -> Ran:
    """Wait for the end of a command."""
    out, err = process.communicate(timeout=100)
    return Ran(process.returncode, out, err)


@pytest.fixture(scope="package")
def instance(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Instance]:
    """One instance for all stories. It ends after them, because even an idle instance uses CPU time."""
    with running_instance(tmp_path_factory.mktemp("up")) as running:
        yield running


@contextmanager
def running_instance(home: Path, *options: str, **settings: str) -> Iterator[Instance]:
    """Run `klein up` in an empty folder; `settings` are additional environment variables."""
    copy_template(home / "data")
    short = {"KLEINKRAM_PART_URL_S": "4", "KLEINKRAM_DOWNLOAD_URL_S": "4"}  # so that slow transfers outlive them
    often = {"KLEINKRAM_SIGN_INS_PER_MINUTE": "1000"}  # all stories come from one address
    environment = {**_environment(home, home / "data"), **short, **often, **settings}
    ports = ["--port", str(choose_port()), "--s3-port", str(choose_port())]  # the default ports may be in use
    process = subprocess.Popen([str(KLEIN), "up", *ports, *options], env=environment, stdout=subprocess.PIPE, text=True)
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
    """A terminal of the same person with other journals, as on another machine."""
    return _terminal(instance, tmp_path / "two")


@pytest.fixture
def project(terminal: Terminal) -> str:
    """A new project."""
    name = f"project-{uuid.uuid4().hex[:8]}"
    terminal.run("project", "create", name)
    return name


@pytest.fixture
def browser(terminal: Terminal) -> Iterator[Browser]:
    """The browser of the owner of `klein up`, signed in by a one-time link."""
    link = urlsplit(terminal.run("session", "link").out.strip())
    url = f"{link.scheme}://{link.netloc}"
    with urllib3.PoolManager(retries=False, timeout=20) as pool:
        signed_out = Browser(url, "", pool)
        yield replace(signed_out, cookie=signed_out.sign_in("/auth/link", {"code": link.fragment}))


@pytest.fixture
def away(tmp_path: Path) -> Terminal:
    """A terminal on another machine, without a saved server."""
    return terminal_away(tmp_path / "away")


def terminal_away(home: Path) -> Terminal:
    """Return a terminal on another machine, without a saved server."""
    home.mkdir()
    return Terminal(home, {**_environment(home, home / "none"), "BROWSER": "true"})


def _terminal(instance: Instance, home: Path) -> Terminal:
    home.mkdir()
    return Terminal(home, _environment(home, instance.data_dir))


def _environment(home: Path, data_dir: Path) -> dict[str, str]:
    ours = {name: str(home / name[4:-5].lower()) for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_DATA_HOME")}
    inherited = {key: value for key, value in os.environ.items() if not key.startswith("KLEINKRAM_")}
    return {**inherited, **ours, "KLEINKRAM_DATA_DIR": str(data_dir), "KLEINKRAM_PACKAGE_INDEX": "off"}
