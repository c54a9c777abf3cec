"""Clocks of server, store and client an hour apart: transfers work, and expiries use the server's clock."""

import datetime
import filecmp
import json
import os
import subprocess
from dataclasses import replace
from email.utils import parsedate_to_datetime
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import urllib3

from tests.acceptance.browser import Browser, line_with
from tests.acceptance.conftest import Terminal, end
from tests.system.chaos.clocks import wrong_at_server, wrong_clock
from tests.system.cluster import Cluster, environment

pytestmark = pytest.mark.slow

_MIB = 1024 * 1024
_MEANWHILE = datetime.timedelta(minutes=5)


@pytest.mark.parametrize("hours", [1, pytest.param(-1, marks=pytest.mark.soak)])
def test_transfers_work_and_expiries_use_the_server_s_clock(cluster: Cluster, tmp_path: Path, hours: int) -> None:
    """The server is an hour off from its store and its database, and the client an hour to the other side."""
    cluster.settings |= wrong_at_server(tmp_path / "server", hours)
    cluster.start()
    url = cluster.runtime_info()["url"]
    home = tmp_path / "client"
    home.mkdir()
    client = Terminal(home, environment(home, **wrong_clock(-hours), BROWSER="true"))
    _sign_in_by_a_code(cluster, client, url)
    mission = ["-p", "p", "-m", "m"]
    client.run("project", "create", "p")
    files = [_file(tmp_path / "large.bin", 20 * _MIB), _file(tmp_path / "small.bin", 1000)]
    transfers = client.run("upload", *mission, "--create", *files, "--json").json()["items"]
    assert [transfer["moved_bytes"] for transfer in transfers] == [file.stat().st_size for file in files], (
        "nothing is sent twice"
    )
    client.run("verify", *mission, *files)
    client.run("verify", *mission, "--remote")
    client.run("download", *mission, "--dest", tmp_path / "back")
    assert all(filecmp.cmp(file, tmp_path / "back" / file.name, shallow=False) for file in files)
    client.run("share", "create", *mission, "--days", "1")
    (share,) = client.run("share", "list", *mission, "--json").json()["items"]
    ending = datetime.datetime.fromisoformat(share["expires_at"])
    a_day_on = _time_at(url) + datetime.timedelta(days=1)
    assert abs(ending - a_day_on) < _MEANWHILE
    assert abs(_time_at(url) - datetime.datetime.now(datetime.timezone.utc)) > datetime.timedelta(minutes=50)
    _check_reports(cluster, hours)


def _sign_in_by_a_code(cluster: Cluster, client: Terminal, url: str) -> None:
    link = urlsplit(cluster.terminal.run("session", "link").out.strip())
    with urllib3.PoolManager(retries=False, timeout=20) as pool:
        stranger = Browser(url, "", pool)
        browser = replace(stranger, cookie=stranger.sign_in("/auth/link", {"code": link.fragment}))
        process = client.start("login", url, "--device")
        browser.post("/auth/device/approve", {"user_code": line_with(process, "and type").split()[-1]})
        agreed = end(process)
    assert agreed.code == 0, agreed.err
    (endpoint,) = client.run("endpoint", "list", "--json").json()["items"]
    assert endpoint["person"] == "owner"


def _check_reports(cluster: Cluster, hours: int) -> None:
    """Check that the server's log and `klein doctor` report the difference."""
    lines = [json.loads(line) for line in (cluster.data_dir / "logs" / "api.log").read_text().splitlines()]
    (warning,) = [line for line in lines if "clocks of this server and of the store differ" in line["message"]]
    assert abs(warning["store_ahead_s"] + hours * 3600) < _MEANWHILE.total_seconds()
    command = cluster.terminal.command("doctor", "--data-dir", cluster.data_dir)
    runtime_info = subprocess.run(
        command, check=False, capture_output=True, text=True, env=cluster.terminal.environment
    ).stdout
    (line,) = [line for line in runtime_info.splitlines() if "clock against the API" in line]
    assert line.startswith("PROBLEM")
    assert "set the clocks of both machines by NTP" in line


def _time_at(url: str) -> datetime.datetime:
    return parsedate_to_datetime(urllib3.request("GET", f"{url}/health/live").headers["Date"])


def _file(path: Path, size_bytes: int) -> Path:
    path.write_bytes(os.urandom(size_bytes))
    os.utime(path, (1_700_000_000, 1_700_000_000))
    return path
