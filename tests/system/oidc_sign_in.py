"""A real OpenID provider (npm `oidc-provider`) and a real browser (Chromium, by `playwright-core`), for tests.

Both are installed once into a folder outside of the repository, from the lock file in `tests/system/oidc`.
"""

import json
import os
import secrets
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import urllib3

from tests.ports import choose_port
from tests.requirements import need, need_browser, need_node

CLIENT_ID, CLIENT_SECRET = "kleinkram", "a secret, with: + and % in it"


@pytest.fixture(name="node", scope="session")
def _node() -> Path:
    """The folder with the programs of `tests/system/oidc` and their packages. Skips or fails without Node."""
    need("node")
    return need_node()


@dataclass
class RealProvider:
    """The process of the provider. Its address does not change. Any name can sign in."""

    node: Path
    redirect_uri: str
    port: int = field(default_factory=choose_port)
    process: "subprocess.Popen[str] | None" = None

    @property
    def url(self) -> str:
        """Its issuer."""
        return f"http://127.0.0.1:{self.port}"

    def start(self, *, late_s: int = 0) -> None:
        """Restart it with a new key, and with a clock that is `late_s` slow."""
        self.end()
        configuration = {
            "port": self.port,
            "redirect_uri": self.redirect_uri,
            "late_s": late_s,
            "kid": secrets.token_hex(4),
            "logout_uri": self.redirect_uri.replace("/callback/", "/backchannel-logout/"),
        }
        configuration |= {"client_id": CLIENT_ID, "client_secret": CLIENT_SECRET}
        command = ["node", "provider.mjs", json.dumps(configuration)]
        self.process = subprocess.Popen(
            command, cwd=self.node, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def remove(self, name: str) -> None:
        """Remove an account."""
        assert urllib3.request("POST", f"{self.url}/test/remove/{name}").status == 204

    def end(self) -> None:
        """Kill it."""
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None


@dataclass
class Chromium:
    """A real browser. A command that takes more than seconds fails the test with the address of the page."""

    process: "subprocess.Popen[str]"

    def do(self, act: str, **how: object) -> Any:
        """Send a command to `drive.mjs`, and return its result."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"act": act, **how}) + "\n")
        self.process.stdin.flush()
        return self.answer()

    def answer(self) -> Any:
        """Return the driver's next answer."""
        assert self.process.stdout is not None
        answer = json.loads(self.process.stdout.readline())
        assert "error" not in answer, answer["error"]
        return answer["told"]

    def goto(self, url: str) -> None:
        """Open an address."""
        self.do("goto", url=url)

    def fill(self, name: str, value: str) -> None:
        """Type into the field of a name."""
        self.do("fill", selector=f"[name={name}]", value=value)

    def click(self, selector: str) -> None:
        """Click what a selector finds."""
        self.do("click", selector=selector)

    def see(self, text: str) -> None:
        """Wait until the page shows a text."""
        self.do("see", text=text)

    def arrive(self, path: str) -> str:
        """Wait until the browser is at a path; return its whole address."""
        return str(self.do("arrive", path=path))

    def text(self) -> str:
        """Return the text of the page."""
        return str(self.do("text"))

    def intercept(self, pattern: str) -> None:
        """Stop the browser from opening addresses that match a pattern."""
        self.do("keep", pattern=pattern)

    def intercepted(self) -> str:
        """Wait until the browser tries to open such an address, and return it."""
        return str(self.do("kept"))


@pytest.fixture(name="driver", scope="module")
def _driver(node: Path) -> Iterator[Chromium]:
    browser = need_browser()
    process = subprocess.Popen(
        ["node", "drive.mjs", browser],
        cwd=node,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    chromium = Chromium(process)
    try:
        chromium.answer()
        yield chromium
    finally:
        # Ends the browser too, even if a failed test left it waiting.
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()


@pytest.fixture(name="chromium")
def _chromium(driver: Chromium) -> Chromium:
    """A browser with an empty profile."""
    driver.do("fresh")
    return driver
