"""One `klein up` that tests may start, kill and start again, and the terminals in front of it."""

import json
import os
import signal
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from kleinkram.standalone.processes import marked_processes
from tests.acceptance.conftest import KLEIN, Terminal, wait_until
from tests.ports import choose_port

START_TIMEOUT_S = 90


def environment(home: Path, **more: str) -> dict[str, str]:
    """What a person's programs see: their own folders, and nothing of this machine's Kleinkram."""
    ours = {name: str(home / name[4:-5].lower()) for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_DATA_HOME")}
    kept = {key: value for key, value in os.environ.items() if not key.startswith("KLEINKRAM_")}
    return {**kept, **ours, **more}


@dataclass
class Cluster:
    """A data directory under `home`, and the supervisor that runs on it now, if one does."""

    home: Path
    options: list[str] = field(default_factory=list)
    settings: dict[str, str] = field(default_factory=dict)
    inside: tuple[str, ...] = ()  # what it runs inside of: the beginning of the command line
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
        """Run `klein up` and wait for its line."""
        command = [*self.inside, str(KLEIN), "up", "--data-dir", str(self.data_dir), "--port", str(self.port)]
        command += ["--s3-port", str(self.s3_port), *self.options]
        said = self.home / "up.out"
        with said.open("wb") as out, (self.home / "up.err").open("ab") as err:
            self.process = subprocess.Popen(
                command, env=environment(self.home, **self.settings), stdout=out, stderr=err
            )
        process = self.process
        wait_until(lambda: b"answers at" in said.read_bytes() or process.poll() is not None, "klein up to answer")
        if process.poll() is not None:
            pytest.fail(f"klein up failed: {(self.home / 'up.err').read_text()}")

    def runtime_info(self) -> dict[str, Any]:
        """What it says of itself."""
        runtime_info: dict[str, Any] = json.loads((self.data_dir / "instance.json").read_text())
        return runtime_info

    def kill(self, part: str) -> None:
        """Kill a part, or the `supervisor`, as a crash would. A part that is not running now is left alone."""
        if part == "supervisor":
            assert self.process is not None
            self.process.kill()
            self.process.wait()
        elif pid := self.runtime_info()["services"][part]:
            os.kill(pid, signal.SIGKILL)

    def start_again_if_dead(self) -> None:
        """What a person does who finds that nothing answers any more."""
        if self.process is None or self.process.poll() is not None:
            self.start()

    def end(self) -> None:
        """Press Ctrl-C, and see that nothing is left."""
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            assert self.process.wait(timeout=60) == 0
        wait_until(lambda: marked_processes(self.data_dir) == [], "all parts to be gone")
