"""The order in which queued runs start: priorities, turns of projects and people, large runs, concurrent claims."""

from __future__ import annotations

import uuid
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, another, definition, launch
from tests.integration.upload_client import upload

_COPY = """
INSERT INTO run (id, mission_id, launch_project_id, version_id, parameters, network, cores, memory_bytes, disk_bytes,
  gpus, labels, needs_images, priority, inputs_fingerprint, started_by_id, input_count, input_bytes, created_at)
SELECT gen_random_uuid(), mission_id, launch_project_id, version_id, parameters, network, cores, memory_bytes,
  disk_bytes, gpus, labels, needs_images, priority, inputs_fingerprint, started_by_id, input_count, input_bytes,
  created_at + number * interval '1 microsecond'
FROM run, generate_series(1, %s) number WHERE id = %s
"""


@pytest.fixture
def second_mission(lab: Api) -> Any:
    """A mission with a file, in another project."""
    mission = lab.mission(lab.project()["id"])
    upload(lab, mission["id"], "drive.bin", uuid.uuid4().bytes)
    return mission


def _queue(lab: Api, runner: FakeRunner, mission: Any, count: int, **values: Any) -> None:
    """Queue some equal runs, one after the other."""
    made = launch(lab, runner, mission, **values)
    lab.sql(_COPY, count - 1, made["id"])


def _claim_all(runner: FakeRunner, **free: Any) -> list[str]:
    """Claim run by run, and return the missions."""
    missions = []
    while (claim := runner.claim(**free)) is not None:
        missions.append(claim["mission_id"])
    return missions


def _age(lab: Api, run_id: str, interval: str) -> None:
    lab.sql("UPDATE run SET created_at = created_at - CAST(%s AS interval) WHERE id = %s", interval, run_id)


def test_projects_take_turns(lab: Api, runner: FakeRunner, place: Place, second_mission: Any) -> None:
    """The runs of a small project, queued behind those of a large one, do not wait for these."""
    _queue(lab, runner, place.mission, 6)
    _queue(lab, runner, second_mission, 2)
    large, small = place.mission["id"], second_mission["id"]
    assert _claim_all(runner) == [large, small, large, small, large, large, large, large]


def test_projects_share_cores_rather_than_runs(lab: Api, runner: FakeRunner, place: Place, second_mission: Any) -> None:
    _queue(lab, runner, place.mission, 3, resources={"cores": 3})
    _queue(lab, runner, second_mission, 4, resources={"cores": 1})
    wide, narrow = place.mission["id"], second_mission["id"]
    assert _claim_all(runner) == [wide, narrow, narrow, narrow, wide, narrow, wide]


def test_on_a_machine_for_one_run_projects_alternate(
    lab: Api, runner: FakeRunner, place: Place, second_mission: Any
) -> None:
    """No project has a run when the next one is claimed: the one whose last start is longest ago is next."""
    _queue(lab, runner, place.mission, 4)
    _queue(lab, runner, second_mission, 2)
    order = []
    while (claim := runner.claim()) is not None:
        order.append(claim["mission_id"])
        runner.finish(claim).ok()
    large, small = place.mission["id"], second_mission["id"]
    assert order == [large, small, large, small, large, large]


def test_people_take_turns_within_a_project(lab: Api, runner: FakeRunner, place: Place) -> None:
    colleague = people.person(lab)
    people.grant(lab, colleague.group_id, Right.create, project_id=place.project["id"])
    _queue(lab, runner, place.mission, 5)
    own = launch(lab.as_(colleague.token), runner, place.mission)
    assert own["id"] in [runner.claim()["run_id"] for _ in range(2)]


def test_higher_priorities_start_first(lab: Api, runner: FakeRunner, place: Place, second_mission: Any) -> None:
    low, normal, high = (
        _launch(lab, runner, mission, priority)
        for mission, priority in ((place.mission, "low"), (place.mission, "normal"), (second_mission, "high"))
    )
    assert [runner.claim()["run_id"] for _ in range(3)] == [high["id"], normal["id"], low["id"]]
    assert [run["priority"] for run in (low, normal, high)] == ["low", "normal", "high"]


def test_a_run_of_low_priority_waits_no_more_than_an_hour_longer(
    lab: Api, runner: FakeRunner, place: Place, second_mission: Any
) -> None:
    """Afterwards it takes its project's turn, but after what its own people launched with normal priority."""
    low = _launch(lab, runner, place.mission, "low")
    own = launch(lab, runner, place.mission)
    _queue(lab, runner, second_mission, 3)
    _age(lab, low["id"], "61 minutes")
    order = [runner.claim()["run_id"] for _ in range(4)]
    assert (order[0], order[2]) == (own["id"], low["id"])


def test_high_priority_requires_delete(lab: Api, runner: FakeRunner, place: Place) -> None:
    writer = people.person(lab)
    people.grant(lab, writer.group_id, Right.write, project_id=place.project["id"])
    body = {"mission_ids": [place.mission["id"]], "definition": definition(runner), "priority": "high"}
    (refused,) = lab.as_(writer.token).post("/runs", body).ok()["items"]
    assert refused["problem"]["code"] == "forbidden"
    assert "high priority" in refused["problem"]["detail"]
    earlier = _launch(lab, runner, place.mission, "high")
    again = lab.as_(writer.token).post(f"/runs/{earlier['id']}/retry?force=true").ok(201)
    assert again["priority"] == "normal"
    assert lab.post(f"/runs/{earlier['id']}/retry?force=true").ok(201)["priority"] == "high"


def test_a_large_run_is_not_passed_for_ever(lab: Api, runner: FakeRunner, place: Place) -> None:
    """Once it waited for ten minutes, the runner starts nothing else until it fits."""
    large = launch(lab, runner, place.mission, resources={"cores": 4})
    _queue(lab, runner, place.mission, 3)
    passing = runner.claim(cores=3)
    assert passing["run_id"] != large["id"], "it does not fit yet, and others need not wait for it"
    _age(lab, large["id"], "11 minutes")
    assert runner.claim(cores=3) is None
    assert runner.claim(cores=4)["run_id"] == large["id"]
    assert len(_claim_all(runner)) == 2


def test_one_runner_alone_keeps_room_for_a_large_run(lab: Api, runner: FakeRunner, place: Place) -> None:
    others = [another(lab, runner) for _ in range(2)]
    for other in others:
        other.register()
    large = launch(lab, runner, place.mission, resources={"cores": 4})
    _queue(lab, runner, place.mission, 4)
    _age(lab, large["id"], "11 minutes")
    claims = [one.claim(cores=3) for one in sorted([runner, *others], key=lambda one: one.id)]
    assert [claim is None for claim in claims] == [True, False, False]


def test_a_claim_of_several_runs_is_as_fair_as_several_claims(
    lab: Api, runner: FakeRunner, place: Place, second_mission: Any
) -> None:
    _queue(lab, runner, place.mission, 20)
    _queue(lab, runner, second_mission, 3)
    counts = Counter(claim["mission_id"] for claim in runner.claim_several(8))
    assert counts == {place.mission["id"]: 5, second_mission["id"]: 3}
    assert len(runner.claim_several(100)) == 15


def test_lost_answers_with_several_runs_are_repaired(lab: Api, runner: FakeRunner, place: Place) -> None:
    """The next claim is answered with all runs that the runner does not know, and with the same attempts."""
    _queue(lab, runner, place.mission, 6, network="api")
    known, *lost = runner.claim_several(4)
    runner.active_ids = [known["run_id"]]
    repeated = runner.claim_several(100)
    assert {(claim["run_id"], claim["attempt"]) for claim in repeated} == {
        (claim["run_id"], claim["attempt"]) for claim in lost
    }
    for claim in (*lost, *repeated):
        assert lab.as_(claim["token"]).get(f"/runs/{claim['run_id']}").status == 200, "a job has either token"
    assert len(runner.claim_several(100)) == 2


def test_a_runner_of_an_earlier_version_gets_one_run(lab: Api, runner: FakeRunner, place: Place) -> None:
    _queue(lab, runner, place.mission, 2)
    assert runner.claim() is not None
    assert runner.claim() is not None
    assert runner.claim() is None


def test_runs_of_people_who_lost_their_right_are_cancelled(lab: Api, runner: FakeRunner, place: Place) -> None:
    colleague = people.person(lab)
    people.grant(lab, colleague.group_id, Right.create, project_id=place.project["id"])
    theirs = [launch(lab.as_(colleague.token), runner, place.mission)["id"] for _ in range(2)]
    own = launch(lab, runner, place.mission)
    lab.sql("DELETE FROM access_grant WHERE group_id = %s", colleague.group_id)
    assert [claim["run_id"] for claim in runner.claim_several(10)] == [own["id"]]
    assert [lab.get(f"/runs/{run_id}").ok()["state"] for run_id in theirs] == ["cancelled", "cancelled"]


@pytest.mark.parametrize("max_runs", [1, 7])
def test_concurrent_claims_share_the_queue(
    lab: Api, runner: FakeRunner, place: Place, second_mission: Any, max_runs: int
) -> None:
    """Each run goes to one runner, none is left, and both projects start."""
    runners = [runner, *(another(lab, runner) for _ in range(5))]
    for one in runners[1:]:
        one.register()
    _queue(lab, runner, place.mission, 50)
    _queue(lab, runner, second_mission, 10)

    def drain(one: FakeRunner) -> Sequence[str]:
        got = []
        # Of what others claim at the same moment, an answer may know nothing yet.
        while claims := one.claim_several(max_runs, wait_s=1):
            got += [claim["run_id"] for claim in claims]
        return got

    with ThreadPoolExecutor(len(runners)) as pool:
        claimed = [run_id for got in pool.map(drain, runners) for run_id in got]
    assert (len(claimed), len({*claimed})) == (60, 60)


def _launch(lab: Api, runner: FakeRunner, mission: Any, priority: str) -> Any:
    body = {"mission_ids": [mission["id"]], "definition": definition(runner), "force": True, "priority": priority}
    (made,) = lab.post("/runs", body).ok()["items"]
    return made["run"]
