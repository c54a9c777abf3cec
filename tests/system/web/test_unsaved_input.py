"""Unsaved input survives an expired session and an unreachable server; a store on another origin works."""

import hashlib
from pathlib import Path

import pytest

from kleinkram.recordings.sample import generate_mcap
from tests.acceptance.conftest import wait_until
from tests.system.cluster import Cluster
from tests.system.conftest import OtherMachine
from tests.system.web.conftest import Act

_FIELDS = """
undeclared: refuse
fields:
  - {name: operator, type: string, required: true, description: Who held the remote.}
"""


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_unsaved_input_survives(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path) -> None:
    cluster.start()
    terminal = cluster.terminal
    (tmp_path / "fields.yaml").write_text(_FIELDS)
    (tmp_path / "said.yaml").write_text("operator: ada\n")
    drive = generate_mcap(tmp_path / "drive.mcap", size_bytes=300_000).path
    terminal.run("project", "create", "Alps", "--fields", tmp_path / "fields.yaml")
    terminal.run("upload", "-p", "Alps", "-m", "day", "--create", "--metadata", tmp_path / "said.yaml", drive)
    invited = terminal.run("person", "invite", "ada@lab.example", "--json").json()
    terminal.run("access", "grant", "WRITE", "-p", "Alps", "--to", "ada@lab.example")
    mission = terminal.run("mission", "list", "--json").json()["items"][0]["id"]
    wait_until(lambda: "/imu/data" in terminal.run("mission", "info", mission, "--json").out, "its topics to be known")
    later = tmp_path / "later.txt"
    later.write_text("what was seen")
    api = cluster.runtime_info()["services"]["api"]
    seen = act("lasting.mjs", cluster, invited["url"], mission, api, later, pictures, timeout_s=250)

    assert seen["errors"] == []
    assert seen["ended"] == 204
    assert seen["kept"] == ["grace", "Snow on the ridge."]
    for form in ("metadata", "notes", "upload"):
        assert "Your input on this page is kept. Sign in" in seen[f"{form}Told"]
    assert "Retrying automatically" in seen["away"]
    assert seen["alerts"] == 0, "calmly"
    assert seen["keptWhileAway"] == "edith"
    assert seen["changed"] == 200
    assert seen["loadsOfMission"] == 1, "the page was never loaded anew"
    assert seen["keptOfUpload"] == ["second", "beatrice"]
    assert "File uploaded." in seen["over"]
    assert cluster.runtime_info()["services"]["api"] != api
    runtime_info = {row["name"]: row for row in terminal.run("mission", "list", "--json").json()["items"]}
    assert runtime_info["day"]["metadata"] == {"operator": "edith"}
    assert runtime_info["second"]["metadata"] == {"operator": "beatrice"}


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_from_another_machine(
    cluster: Cluster, act: Act, other_machine: OtherMachine, pictures: Path, tmp_path: Path
) -> None:
    address = f"http://{other_machine.our_address}:{cluster.port}"
    cluster.options += ["--listen", "0.0.0.0", "--public-url", address]
    cluster.start()
    drive = Path(generate_mcap(tmp_path / "drive.mcap", size_bytes=12_000_000).path)
    cluster.terminal.run("project", "create", "Alps")
    seen = act("lasting_far.mjs", cluster, drive, pictures, inside=other_machine.command())

    store = f"http://{other_machine.our_address}:{cluster.s3_port}"
    assert seen["complaints"] == []
    assert "File uploaded." in seen["over"]
    assert seen["sha256"] == hashlib.sha256(drive.read_bytes()).hexdigest()
    assert {line.split()[1] for line in seen["hosts"]} == {address, store}
    assert f"PUT {store}" in seen["hosts"], "straight to the store, by its public address"
