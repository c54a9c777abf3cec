"""Unsaved input survives an expired session and an unreachable server; a store on another origin works."""

import hashlib
from pathlib import Path

import pytest

from kleinkram.recordings.sample import generate_mcap
from tests.acceptance.conftest import wait_until
from tests.system.cluster import Cluster
from tests.system.conftest import OtherMachine
from tests.system.web.conftest import RunBrowser

_FIELDS = """
undeclared: refuse
fields:
  - {name: operator, type: string, required: true, description: Who held the remote.}
"""


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_unsaved_input_survives_an_expired_session_and_a_server_restart(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    terminal = cluster.terminal
    (tmp_path / "fields.yaml").write_text(_FIELDS)
    (tmp_path / "metadata.yaml").write_text("operator: ada\n")
    drive = generate_mcap(tmp_path / "drive.mcap", size_bytes=300_000).path
    terminal.run("project", "create", "Alps", "--fields", tmp_path / "fields.yaml")
    terminal.run("upload", "-p", "Alps", "-m", "day", "--create", "--metadata", tmp_path / "metadata.yaml", drive)
    invited = terminal.run("person", "invite", "ada@lab.example", "--json").json()
    terminal.run("access", "grant", "WRITE", "-p", "Alps", "--to", "ada@lab.example")
    mission = terminal.run("mission", "list", "--json").json()["items"][0]["id"]
    wait_until(
        lambda: "/imu/data" in terminal.run("mission", "info", mission, "--json").out, "its topics to be indexed"
    )
    later = tmp_path / "later.txt"
    later.write_text("notes")
    api = cluster.runtime_info()["services"]["api"]
    results = run_browser("lasting.mjs", cluster, invited["url"], mission, api, later, pictures, timeout_s=560)

    assert results["errors"] == []
    assert results["endStatus"] == 204
    assert results["keptInputs"] == ["grace", "Snow on the ridge."]
    for form in ("metadata", "notes", "upload"):
        assert "Your input on this page is kept. Sign in" in results[f"{form}Message"]
    assert "Retrying automatically" in results["unreachable"]
    assert results["alerts"] == 0, "the notice is no alert"
    assert results["keptWhileUnreachable"] == "edith"
    assert results["changeStatus"] == 200
    assert results["missionPageLoads"] == 1, "the page was reloaded"
    assert results["keptUploadInputs"] == ["second", "beatrice"]
    assert "File uploaded." in results["finished"]
    assert cluster.runtime_info()["services"]["api"] != api
    missions = {row["name"]: row for row in terminal.run("mission", "list", "--json").json()["items"]}
    assert missions["day"]["metadata"] == {"operator": "edith"}
    assert missions["second"]["metadata"] == {"operator": "beatrice"}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_browser_on_another_machine_uploads_and_downloads(
    cluster: Cluster, run_browser: RunBrowser, other_machine: OtherMachine, pictures: Path, tmp_path: Path
) -> None:
    address = f"http://{other_machine.our_address}:{cluster.port}"
    cluster.options += ["--listen", "0.0.0.0", "--public-url", address]
    cluster.start()
    drive = Path(generate_mcap(tmp_path / "drive.mcap", size_bytes=12_000_000).path)
    cluster.terminal.run("project", "create", "Alps")
    results = run_browser("lasting_far.mjs", cluster, drive, pictures, inside=other_machine.command())

    store = f"http://{other_machine.our_address}:{cluster.s3_port}"
    assert results["consoleErrors"] == []
    assert "File uploaded." in results["finished"]
    assert results["sha256"] == hashlib.sha256(drive.read_bytes()).hexdigest()
    assert {line.split()[1] for line in results["hosts"]} == {address, store}
    assert f"PUT {store}" in results["hosts"], "uploads go directly to the public URL of the store"
