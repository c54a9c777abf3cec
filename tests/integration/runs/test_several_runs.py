"""Requests of a runner about several runs at once: their contexts and their ends."""

from __future__ import annotations

import base64
import uuid
from typing import Any

from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, another, launch
from tests.integration.upload_client import upload

_USAGE = {"cpu_s": 1.5, "memory_bytes": 10, "peak_memory_bytes": 20, "read_bytes": 0, "written_bytes": 0}


def contexts(runner: FakeRunner, *claims: Any) -> list[Any]:
    body = {"runs": [{"run_id": claim["run_id"], "attempt": claim["attempt"]} for claim in claims]}
    return list(runner.api.post(f"/runners/{runner.id}/contexts", body).ok()["contexts"])


def end(runner: FakeRunner, *ends: tuple[Any, dict[str, Any]]) -> list[str | None]:
    """Report the ends of runs in one request; return their states."""
    usual = {"reason": "done", "message": "", "exit_code": 0}
    body = [
        {"run_id": claim["run_id"], "finish": {"attempt": claim["attempt"], **usual, **values}}
        for claim, values in ends
    ]
    return list(runner.api.post(f"/runners/{runner.id}/ends", {"ends": body}).ok()["states"])


def log_of(lab: Api, claim: Any, offset: int = 0) -> Any:
    return lab.get(f"/runs/{claim['run_id']}/log?offset={offset}").ok()


def base64_of(data: bytes) -> str:
    return base64.b64encode(data).decode()


def test_contexts_of_several_runs_are_those_of_each(lab: Api, runner: FakeRunner, place: Place) -> None:
    """Of two missions and two people, of whom one may not see the mission any more."""
    other_place = lab.mission(place.project["id"])
    upload(lab, other_place["id"], "other.bin", b"other")
    colleague = people.person(lab)
    lab.post(f"/missions/{other_place['id']}/grants", {"person_id": colleague.id, "right": "CREATE"}).ok(201)
    for mission in (place.mission, other_place, place.mission):
        launch(lab, runner, mission)
    launch(lab.as_(people.token(lab, colleague).secret), runner, other_place)
    claims = runner.claim_several(4)
    assert len(claims) == 4
    (grant,) = lab.get(f"/missions/{other_place['id']}/grants").ok()["items"]
    lab.delete(f"/missions/{other_place['id']}/grants/{grant['id']}").ok(204)
    alone = [runner.api.get(f"/runner/runs/{claim['run_id']}/context?attempt={claim['attempt']}") for claim in claims]
    assert [answer.status for answer in alone].count(200) == 3
    expected = [answer.ok() if answer.status == 200 else None for answer in alone]
    assert contexts(runner, *claims) == expected
    assert {len(context["files"]) for context in expected if context} == {1, 2}
    outdated = {**claims[0], "attempt": 7}
    assert contexts(runner, outdated, {"run_id": str(uuid.uuid4()), "attempt": 1}) == [None, None]


def test_ends_of_several_runs_do_not_affect_each_other(lab: Api, runner: FakeRunner, place: Place) -> None:
    for _ in range(5):
        launch(lab, runner, place.mission, right="CREATE")
    good, failed, maker, lost, silent = runner.claim_several(5)
    other = another(lab, runner)
    other.register()
    launch(lab, runner, place.mission)
    foreign = other.claim()
    runner.upload_artifact(maker, "map.bin", b"a map")
    report = {
        "metrics": [{"name": "ate", "value": 0.25, "unit": "m"}],
        "findings": [{"severity": "error", "code": "gap", "message": "A gap."}],
    }
    ends: list[tuple[Any, dict[str, Any]]] = [
        (good, {"report": report, "log": base64_of(b"reading\nwriting\n"), "image_digest": "sha256:stock"}),
        (failed, {"reason": "exit_code", "message": "It returned 1.", "exit_code": 1, "problems": ["no file"]}),
        (maker, {"report": {"mission_files": [{"path": "map.bin", "to": "maps/map.bin"}]}}),
        ({**lost, "attempt": 7}, {}),
        (foreign, {}),
        (silent, {"samples": [{"at_s": 1, "usage": _USAGE}], "placement": {"job_id": "4711_2"}}),
    ]
    states = ["done", "failed", "done", None, None, "done"]
    assert end(runner, *ends) == states
    assert end(runner, *ends) == states, "a repeated report changes nothing"
    runs = [lab.get(f"/runs/{claim['run_id']}").ok() for claim, _ in ends]
    assert [run["state"] for run in runs] == ["done", "failed", "done", "preparing", "preparing", "done"]
    assert (runs[0]["verdict"], runs[0]["metric_count"], runs[0]["finding_counts"]) == ("bad", 1, {"error": 1})
    assert (runs[1]["message"], runs[1]["exit_code"], runs[1]["problems"]) == ("It returned 1.", 1, ["no file"])
    assert (runs[2]["artifact_count"], runs[5]["placement"]["job_id"]) == (1, "4711_2")
    assert len(runs[5]["samples"]) == 1
    paths = {one["path"] for one in lab.get(f"/files?mission_id={place.mission['id']}").ok()["items"]}
    assert "maps/map.bin" in paths
    (metric,) = lab.get("/run-metrics", {"run_id": good["run_id"]}).ok()["items"]
    assert (metric["metric"]["name"], metric["metric"]["value"]) == ("ate", 0.25)
    events = lab.sql(
        "SELECT count(*) FROM audit_event WHERE operation = 'run.end' AND resource_id = %s", good["run_id"]
    )
    assert events == [(1,)]


def test_a_small_log_is_read_like_any_other(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    claim = runner.claim()
    whole = "0 °C\n".encode() * 100 + b"\xff\n"
    runner.write(claim, 0, whole[:60])
    assert end(runner, (claim, {"log": base64_of(whole)})) == ["done"]
    first = log_of(lab, claim)
    assert (first["text"], first["is_over"]) == (whole.decode(errors="replace"), True)
    assert log_of(lab, claim, len(whole) - 2)["text"] == "�\n"
    assert log_of(lab, claim, len(whole))["is_over"]
    lab.delete(f"/missions/{place.mission['id']}").ok()


def test_a_log_that_is_not_small_is_refused(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    claim = runner.claim()
    for log in (base64_of(b"x" * (32 * 1024 + 1)), "no base64"):
        finish = {"attempt": claim["attempt"], "reason": "done", "message": "", "log": log}
        runner.api.post(f"/runner/runs/{claim['run_id']}/finish", finish).refused(422, "invalid_request")
    runner.finish(claim, log=base64_of(b"x" * 32 * 1024)).ok()


def test_the_statements_do_not_depend_on_the_number_of_runs(lab: Api, runner: FakeRunner, place: Place) -> None:
    counts = []
    for number in (2, 6):
        for _ in range(number):
            launch(lab, runner, place.mission)
        claims = runner.claim_several(number)
        with lab.statements() as statements:
            assert None not in contexts(runner, *claims)
            assert {*end(runner, *((claim, {"log": base64_of(b"x")}) for claim in claims))} == {"done"}
        counts.append(len(statements))
    assert counts[0] == counts[1], statements
