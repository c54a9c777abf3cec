"""A real browser in front of a real `klein up`, driven by small programs for Node."""

import json
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from kleinkram.server.http.web_app import BUILT
from tests.requirements import missing, need, need_browser
from tests.system.cluster import Cluster

WEB = Path(__file__).parents[3] / "web"
OUTPUT = Path(__file__).parents[3] / "output" / "web"

# Runs a program of this folder with a sign-in link of the owner, and returns the JSON that it prints.
RunBrowser = Callable[..., dict[str, Any]]


@pytest.fixture
def run_browser() -> RunBrowser:
    """Return a function that runs a browser program. Skips without a browser, its driver or the built app."""
    need("node")
    browser = need_browser()
    if not (WEB / "node_modules" / "playwright-core").is_dir() or not (BUILT / "index.html").is_file():
        missing("the web interface is not built: `make setup` builds it")

    def run(
        script: str, cluster: Cluster, *arguments: object, timeout_s: float = 560, inside: Sequence[str] = ()
    ) -> dict[str, Any]:
        link = cluster.terminal.run("session", "link").out.strip()
        program = Path(__file__).parent / script
        common = [str(WEB), browser, link, cluster.runtime_info()["url"]]
        command = [*inside, "node", str(program), *common, *map(str, arguments)]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=timeout_s)
        assert done.returncode == 0, done.stderr
        results: dict[str, Any] = json.loads(done.stdout)
        return results

    return run


@pytest.fixture
def pictures() -> Path:
    """The folder for screenshots, for people to look at. Checked pages have one with KLEINKRAM_TEST_PICTURES=1."""
    OUTPUT.mkdir(parents=True, exist_ok=True)
    return OUTPUT
