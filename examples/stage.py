"""What the parts of the demo share: its folder, its commands, its steps."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

STAGE = Path(__file__).resolve().parent.parent / ".demo"
KLEIN = Path(sys.executable).parent / "klein"
# Where packages of scripts come from: a fact of this machine, which the instance of the demo needs, too.
_PASSED_ON = {"KLEINKRAM_PACKAGE_INDEX"}


class Failed(Exception):
    """A step failed."""


class Story:
    """The steps, their output and their times."""

    def __init__(self) -> None:
        self.times: list[tuple[str, float]] = []
        self.started = time.monotonic()

    @contextmanager
    def step(self, title: str) -> Iterator[None]:
        """Run one step and measure its time."""
        print(f"\n\033[1m{title}\033[0m", flush=True)
        started = time.monotonic()
        yield
        self.times.append((title, time.monotonic() - started))

    def close(self) -> None:
        """Print the time of each step."""
        print("\n\033[1mTime per step\033[0m")
        for title, seconds in self.times:
            print(f"  {seconds:6.1f} s  {title}")
        print(f"  {time.monotonic() - self.started:6.1f} s  total\n")


def environment(who: str | None = None) -> dict[str, str]:
    """Return the environment of `klein`: with the demo's instance only, or for another person without any instance."""
    if who is not None:
        homes = {f"XDG_{kind}_HOME": str(STAGE / who / kind.lower()) for kind in ("CONFIG", "STATE", "DATA")}
        return {**environment(), **homes, "KLEINKRAM_DATA_DIR": str(STAGE / who / "none"), "BROWSER": "true"}
    inherited = {
        key: value for key, value in os.environ.items() if key in _PASSED_ON or not key.startswith("KLEINKRAM_")
    }
    homes = {"XDG_CONFIG_HOME": STAGE / "config", "XDG_STATE_HOME": STAGE / "state", "XDG_DATA_HOME": STAGE / "share"}
    return {
        **inherited,
        **{key: str(path) for key, path in homes.items()},
        "KLEINKRAM_DATA_DIR": str(STAGE / "data"),
        "COLUMNS": "140",
    }


def klein(
    *arguments: str | Path, show: bool = True, expect: int = 0, who: str | None = None, token: str | None = None
) -> str:
    """Run one command as a person would, or as a robot with `token`; returns its stdout."""
    command = [str(KLEIN), *map(str, arguments)]
    if show:
        print(f"{who or ''}$ klein {' '.join(map(str, arguments))}", flush=True)
    known = (
        environment(who) if token is None else {**environment(who), "KLEINKRAM_TOKEN": token, "KLEINKRAM_URL": url()}
    )
    done = subprocess.run(command, capture_output=True, text=True, env=known, cwd=STAGE, check=False)
    if show:
        for text in (done.stdout, done.stderr):
            print("".join(f"  {line}\n" for line in text.splitlines()), end="", flush=True)
    if done.returncode != expect:
        detail = "" if show else done.stderr
        raise Failed(f"`klein {' '.join(map(str, arguments))}` ended with {done.returncode}, not {expect}. {detail}")
    return done.stdout


def url() -> str:
    """Return the URL of the demo's instance."""
    return str(json.loads((STAGE / "data" / "instance.json").read_text())["url"])
