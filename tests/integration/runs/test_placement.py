"""Where a run is on a cluster: reported by its runner, shown by the API and by `klein`, and searched."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from typer.testing import CliRunner

from kleinkram.cli.main import app
from kleinkram.client import connect
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runs import RunFilter
from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, launch

_WAITING = {"job_id": "4711_3", "queued_s": 12.0}
_PLACED = _WAITING | {"node": "gpu07", "gpus": ["GPU-5f2e"], "requeues": 1}
_ACCOUNTED = _PLACED | {"cpu_s": 41.25, "peak_memory_bytes": 1_500_000_000}
Klein = Callable[..., str]


@pytest.fixture(name="klein")
def _klein(lab: Api, monkeypatch: pytest.MonkeyPatch) -> Klein:
    """A terminal of the owner; returns what a command prints, standard error included."""
    monkeypatch.setenv("KLEINKRAM_URL", lab.url)
    monkeypatch.setenv("KLEINKRAM_TOKEN", str(lab.token))
    monkeypatch.delenv("COLUMNS", raising=False)

    def run(*arguments: str) -> str:
        ran = CliRunner().invoke(app, [*arguments])
        assert ran.exit_code == 0, ran.output
        return ran.output

    return run


@pytest.fixture(name="claimed")
def _claimed(lab: Api, runner: FakeRunner, place: Place) -> Any:
    """A run that its runner has."""
    launch(lab, runner, place.mission)
    return runner.claim()


def test_a_run_shows_why_its_job_waits_and_then_where_it_runs(
    lab: Api, runner: FakeRunner, claimed: Any, klein: Klein
) -> None:
    why = "waits in the queue of Slurm: Resources"
    runner.heartbeat(claimed, "preparing", placement=_WAITING, progress={"fraction": 0, "message": why})
    assert f"preparing: {why}" in klein("run", "info", claimed["run_id"])
    assert f"preparing: {why}" in klein("run", "list", "--job", "4711_3")

    runner.heartbeat(claimed, placement=_PLACED)
    running = lab.get(f"/runs/{claimed['run_id']}").ok()
    assert running["placement"] == _PLACED | {"cpu_s": None, "peak_memory_bytes": None}
    assert running["isolation"] == "container"
    runner.finish(claimed, placement=_ACCOUNTED).ok()
    assert lab.get(f"/runs/{claimed['run_id']}").ok()["placement"] == _ACCOUNTED
    shown = [" ".join(line.split()) for line in klein("run", "info", claimed["run_id"]).splitlines()]
    where = ["isolation: container", "node: gpu07", "job: 4711_3", "queue wait: 12.0 s", "requeued: 1 time"]
    accounted = ["GPUs: GPU-5f2e", "accounted: 41.2 s of cores, 1.5 GB of memory at most"]
    assert [line for line in [*where, *accounted] if line not in shown] == []


def test_runs_are_searched_by_node_job_and_isolation(lab: Api, runner: FakeRunner, place: Place, klein: Klein) -> None:
    for node in ("gpu07", "gpu08"):
        launch(lab, runner, place.mission)
        claimed = runner.claim()
        runner.finish(claimed, placement={"node": node, "job_id": f"of {claimed['run_id']}"}).ok()
    here = {"mission_id": place.mission["id"]}
    assert len(lab.get("/runs", {**here, "node": "gpu08"}).ok()["items"]) == 1
    (by_job,) = lab.get("/runs", {"job_id": f"of {claimed['run_id']}"}).ok()["items"]
    assert by_job["id"] == claimed["run_id"]
    client = connect(lab.url, token=lab.token)
    on_node = RunFilter(mission_id=place.mission["id"], node="gpu07", isolation=[Isolation.container])
    assert [run.placement and run.placement.node for run in client.runs.list(on_node)] == ["gpu07"]
    assert client.runs.count(RunFilter(mission_id=place.mission["id"], isolation=[Isolation.none])) == 0
    shown = klein("run", "list", "-m", place.mission["id"], "--node", "gpu08")
    assert "gpu08, job of" in shown
    assert "gpu07" not in shown


def test_klein_and_the_sdk_set_the_isolation_of_a_project_and_say_what_it_means(
    lab: Api, place: Place, klein: Klein
) -> None:
    shown = klein("project", "update", place.project["id"], "--isolation", "namespaces")
    assert "may also start in namespaces, without containers" in shown
    assert "namespaces, or stronger" in shown
    assert json.loads(klein("project", "info", place.project["id"], "--json"))["isolation"] == "namespaces"
    client = connect(lab.url, token=lab.token)
    changed = client.projects.update(place.project["id"], isolation=Isolation.container)
    assert changed.isolation is Isolation.container


def test_klein_lists_the_isolation_and_the_lease_of_runners(lab: Api, runner: FakeRunner, klein: Klein) -> None:
    slurm = runner.registration(executor="slurm", isolation="namespaces") | {"lease_s": 3600}
    runner.api.post("/runners", slurm).ok()
    (row,) = [line for line in klein("runner", "list").splitlines() if f"runner {runner.id[:4]}" in line]
    assert "slurm" in row
    assert "namespaces" in row
    assert "3600 s" in row
