"""Heartbeats about several runs in one request."""

import uuid
from typing import Any

from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, another, launch

_USAGE = {"cpu_s": 1.5, "memory_bytes": 10, "peak_memory_bytes": 20, "read_bytes": 0, "written_bytes": 0}


def _send(runner: FakeRunner, *heartbeats: Any) -> list[str]:
    """Send heartbeats in one request, and return the status of each lease."""
    answer = runner.api.post(f"/runners/{runner.id}/heartbeats", {"runs": heartbeats}).ok()
    assert [reply["run_id"] for reply in answer["runs"]] == [heartbeat["run_id"] for heartbeat in heartbeats]
    return [reply["status"] for reply in answer["runs"]]


def _about(claim: Any, state: str = "running", **values: Any) -> Any:
    return {"run_id": claim["run_id"], "attempt": claim["attempt"], "state": state, **values}


def test_heartbeats_of_different_runs_do_not_affect_each_other(lab: Api, runner: FakeRunner, place: Place) -> None:
    for _ in range(6):
        launch(lab, runner, place.mission)
    calm, starting, busy, ending, cancelled, outdated = runner.claim_several(6)
    progress = {"fraction": 0.25, "message": "a quarter"}
    assert _send(runner, _about(calm), _about(ending), _about(busy, progress=progress)) == ["active"] * 3
    lab.post(f"/runs/{cancelled['run_id']}/cancel").ok()
    other = another(lab, runner)
    other.register()
    launch(lab, runner, place.mission)
    foreign = other.claim()
    placement = {"job_id": "4711_3", "node": "node7", "gpus": ["GPU-1"]}
    statuses = _send(
        runner,
        _about(foreign),
        _about(busy, progress={"fraction": 0.5, "message": "half"}, usage=_USAGE),
        _about(starting, "preparing", progress=progress),
        _about(calm),
        _about(ending, "collecting", image_digest="sha256:1", placement=placement),
        _about(cancelled),
        _about({**outdated, "attempt": 7}),
        _about({"run_id": str(uuid.uuid4()), "attempt": 1}),
    )
    assert statuses == ["lost", "active", "active", "active", "active", "cancel", "lost", "lost"]
    seen = {
        name: lab.get(f"/runs/{claim['run_id']}").ok()
        for name, claim in {"calm": calm, "starting": starting, "busy": busy, "ending": ending}.items()
    }
    assert {name: run["state"] for name, run in seen.items()} == {
        "calm": "running",
        "starting": "preparing",
        "busy": "running",
        "ending": "collecting",
    }
    assert [seen[name]["started_at"] is None for name in ("calm", "starting")] == [False, True]
    assert (seen["busy"]["progress"]["message"], seen["busy"]["usage"]) == ("half", _USAGE)
    assert (seen["starting"]["progress"]["message"], seen["calm"]["progress"]) == ("a quarter", None)
    assert (seen["ending"]["image_digest"], seen["ending"]["placement"]["node"]) == ("sha256:1", "node7")
    assert lab.get(f"/runs/{foreign['run_id']}").ok()["state"] == "preparing"


def test_of_unchanged_runs_only_notable_ones_are_answered(lab: Api, runner: FakeRunner, place: Place) -> None:
    runner.api.post("/runners", runner.registration() | {"lease_s": 1000}).ok()
    for _ in range(5):
        launch(lab, runner, place.mission)
    calm, due, ending, cancelled, outdated = claims = runner.claim_several(5)
    _send(runner, *map(_about, claims[:2]), _about(ending, "collecting"), *map(_about, claims[3:]))
    lab.sql("UPDATE run SET lease_ends_at = now() + interval '900 s' WHERE id = ANY (%s)", _ids(due, ending))
    lab.post(f"/runs/{cancelled['run_id']}/cancel").ok()
    other = another(lab, runner)
    other.register()
    launch(lab, runner, place.mission)
    foreign = other.claim()
    unchanged = [calm, due, ending, cancelled, {**outdated, "attempt": 7}, foreign]
    named = [{"run_id": claim["run_id"], "attempt": claim["attempt"]} for claim in unchanged]
    with lab.statements() as statements:
        reply = runner.api.post(f"/runners/{runner.id}/heartbeats", {"runs": [], "unchanged": named}).ok()
    assert {one["run_id"]: one["status"] for one in reply["runs"]} == {
        due["run_id"]: "active",
        ending["run_id"]: "active",
        cancelled["run_id"]: "cancel",
        outdated["run_id"]: "lost",
        foreign["run_id"]: "lost",
    }
    rows = lab.sql("SELECT id, lease_ends_at - now() > interval '950 s', state FROM run")
    leases = {str(run_id): (is_renewed, state) for run_id, is_renewed, state in rows}
    renewed = [leases[claim["run_id"]] for claim in (calm, due, ending)]
    assert renewed == [(True, "running"), (True, "running"), (True, "collecting")]
    calm_only = {"runs": [], "unchanged": named[:1]}
    with lab.statements() as fewer:
        assert runner.api.post(f"/runners/{runner.id}/heartbeats", calm_only).ok()["runs"] == []
    assert len(fewer) < len(statements), "what is not notable is only looked up"


def _ids(*claims: Any) -> list[uuid.UUID]:
    return [uuid.UUID(claim["run_id"]) for claim in claims]


def test_the_progress_of_the_preparation_ends_with_it(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    claim = runner.claim()
    runner.heartbeat(claim, "preparing", progress={"fraction": 0.5, "message": "downloading"})
    runner.heartbeat(claim, "running")
    assert lab.get(f"/runs/{claim['run_id']}").ok()["progress"] is None
    runner.heartbeat(claim, "preparing")
    assert lab.get(f"/runs/{claim['run_id']}").ok()["state"] == "running", "it never goes back"


def test_many_samples_are_thinned(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    claim = runner.claim()
    for part in range(9):
        samples = [{"at_s": 100 * part + number, "usage": _USAGE} for number in range(100)]
        runner.heartbeat(claim, samples=samples)
    times = [sample["at_s"] for sample in lab.get(f"/runs/{claim['run_id']}").ok()["samples"]]
    assert (len(times) <= 720, times[0], times[-1]) == (True, 0, 899)
    assert times == sorted(times)


def test_the_number_of_statements_does_not_depend_on_the_number_of_runs(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    for _ in range(12):
        launch(lab, runner, place.mission)
    claims = runner.claim_several(12)
    counts = []
    for some in (claims[:1], claims):
        _send(runner, *map(_about, some))
        with lab.statements() as statements:
            _send(runner, *map(_about, some))
        counts.append(len(statements))
    assert counts[0] == counts[1], statements
