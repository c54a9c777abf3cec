"""A `klein up` that tests may start, kill and restart, and terminals for it."""

import json
import os
import signal
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from kleinkram.standalone.processes import marked_processes
from tests.acceptance.conftest import Terminal, wait_until
from tests.klein import KLEIN
from tests.ports import choose_port
from tests.template_instance import copy_template

START_TIMEOUT_S = 90


def environment(home: Path, **more: str) -> dict[str, str]:
    """Return an environment with its own folders, and without the `KLEINKRAM_` variables of this machine."""
    ours = {name: str(home / name[4:-5].lower()) for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_DATA_HOME")}
    inherited = {key: value for key, value in os.environ.items() if not key.startswith("KLEINKRAM_")}
    return {**inherited, **ours, **more}


# On a machine that is busy with four of them.
_START_TIMEOUT_S = 180.0


@dataclass
class Cluster:
    """A data directory under `home`, and its supervisor if one is running."""

    home: Path
    options: list[str] = field(default_factory=list)
    settings: dict[str, str] = field(default_factory=dict)
    inside: tuple[str, ...] = ()  # the beginning of its command line
    process: "subprocess.Popen[bytes] | None" = None
    port: int = field(default_factory=choose_port)
    s3_port: int = field(default_factory=choose_port)

    @property
    def data_dir(self) -> Path:
        """Where the instance lives."""
        return self.home / "data"

    @property
    def terminal(self) -> Terminal:
        """A person on the same machine."""
        return Terminal(self.home, environment(self.home, KLEINKRAM_DATA_DIR=str(self.data_dir)))

    def start(self) -> None:
        """Run `klein up` and wait for its line. A new data directory begins with a migrated database."""
        copy_template(self.data_dir)
        command = [*self.inside, str(KLEIN), "up", "--data-dir", str(self.data_dir), "--port", str(self.port)]
        command += ["--s3-port", str(self.s3_port), *self.options]
        output = self.home / "up.out"
        with output.open("wb") as out, (self.home / "up.err").open("ab") as err:
            self.process = subprocess.Popen(
                command, env=environment(self.home, **self.settings), stdout=out, stderr=err
            )
        process = self.process
        wait_until(
            lambda: b"answers at" in output.read_bytes() or process.poll() is not None,
            "klein up to answer",
            timeout_s=_START_TIMEOUT_S,
        )
        if process.poll() is not None:
            pytest.fail(f"klein up failed: {(self.home / 'up.err').read_text()}")

    def runtime_info(self) -> dict[str, Any]:
        """Return the contents of its `instance.json`."""
        runtime_info: dict[str, Any] = json.loads((self.data_dir / "instance.json").read_text())
        return runtime_info

    def kill(self, part: str) -> None:
        """Kill a part, or the `supervisor`, with SIGKILL. No effect on a part that is not running."""
        if part == "supervisor":
            assert self.process is not None
            self.process.kill()
            self.process.wait()
        elif pid := self.runtime_info()["services"][part]:
            os.kill(pid, signal.SIGKILL)

    def start_again_if_dead(self) -> None:
        """Start it if its supervisor has ended."""
        if self.process is None or self.process.poll() is not None:
            self.start()

    def end(self) -> None:
        """Send SIGINT, and wait until all processes have ended."""
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            assert self.process.wait(timeout=60) == 0
        wait_until(lambda: marked_processes(self.data_dir) == [], "all parts to be gone")
