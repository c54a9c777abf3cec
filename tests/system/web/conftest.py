"""A real browser in front of a real `klein up`, driven by small programs for Node."""

import json
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from kleinkram.server.http.web_app import BUILT
from tests.requirements import missing, need, path_of
from tests.system.cluster import Cluster

WEB = Path(__file__).parents[3] / "web"
OUTPUT = Path(__file__).parents[3] / "output" / "web"

# Runs a program beside the tests as the owner of a house, and returns what it saw.
Act = Callable[..., dict[str, Any]]


@pytest.fixture
def act() -> Act:
    """Runs a program with the browser; skipped where there is no browser, driver or built app."""
    need("chromium", "node")
    browser = path_of("chromium")
    if not (WEB / "node_modules" / "playwright-core").is_dir() or not (BUILT / "index.html").is_file():
        missing("the web interface is not built: `make setup` builds it")

    def run(
        script: str, cluster: Cluster, *arguments: object, timeout_s: float = 200, inside: Sequence[str] = ()
    ) -> dict[str, Any]:
        link = cluster.terminal.run("session", "link").out.strip()
        program = Path(__file__).parent / script
        places = [str(WEB), str(browser), link, cluster.runtime_info()["url"]]
        command = [*inside, "node", str(program), *places, *map(str, arguments)]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=timeout_s)
        assert done.returncode == 0, done.stderr
        seen: dict[str, Any] = json.loads(done.stdout)
        return seen

    return run


@pytest.fixture
def pictures() -> Path:
    """Where the pictures of pages are kept, to be looked at."""
    OUTPUT.mkdir(parents=True, exist_ok=True)
    return OUTPUT
