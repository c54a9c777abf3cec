"""The life cycle of a run, from the queue to its artifacts."""

import uuid

from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, another, launch
from tests.integration.upload_client import fetch, sha256


def test_a_run_is_queued_claimed_executed_and_finished(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission)
    assert (made["state"], made["input_count"], made["may_cancel"]) == ("queued", 2, True)
    claim = runner.claim()
    assert claim["run_id"] == made["id"]
    assert {entry["path"]: entry["sha256"] for entry in claim["inputs"]} == {
        path: file["sha256"] for path, file in place.files.items()
    }
    assert runner.claim() is None, "it was given once"
    assert (
        runner.heartbeat(claim, "running", progress={"fraction": 0.5, "message": "half"}, image_digest="sha256:1")
        == "active"
    )
    seen = lab.get(f"/runs/{made['id']}").ok()
    assert (seen["state"], seen["progress"]["message"], seen["attempt"]) == ("running", "half", 1)
    runner.write(claim, 0, b"one\n")
    runner.write(claim, 4, b"two\n")
    assert lab.get(f"/runs/{made['id']}/log").ok()["text"] == "one\n"
    runner.upload_artifact(claim, "figures/track.txt", b"a track")
    runner.upload_artifact(claim, ".kleinkram/log", b"one\ntwo\n")
    report = {
        "findings": [{"severity": "warning", "code": "imu.gap", "message": "a gap", "file": "drive.bin"}],
        "metrics": [{"name": "ate_rmse", "value": 0.12, "unit": "m"}],
        "metadata": {"distance_m": 12.5},
        "previews": [{"path": "figures/track.txt", "title": "Track"}, {"path": "not there"}],
    }
    assert runner.finish(claim, report=report).ok() == {"state": "done"}
    assert runner.finish(claim, report=report).ok() == {"state": "done"}, "repeated"
    seen = lab.get(f"/runs/{made['id']}").ok()
    assert (seen["state"], seen["reason"], seen["artifact_count"], seen["metric_count"]) == ("done", "done", 1, 1)
    assert (seen["finding_counts"], seen["metadata"]) == ({"warning": 1}, {"distance_m": 12.5})
    assert [entry["path"] for entry in seen["previews"]] == ["figures/track.txt"]
    (metric,) = lab.all("/run-metrics", {"run_id": made["id"]})
    assert (metric["metric"]["value"], metric["metric"]["unit"]) == (0.12, "m")
    (listed,) = lab.all("/runs", {"mission_id": place.mission["id"]})
    assert listed["metrics"] == seen["metrics"] == [metric["metric"]]
    (finding,) = lab.all("/findings", {"mission_id": place.mission["id"], "code": "imu.*"})
    assert finding["finding"]["file"] == "drive.bin"
    (artifact,) = lab.all(f"/runs/{made['id']}/artifacts")
    expected = {"artifact_ids": [artifact["id"]]}
    (link,) = lab.post(f"/runs/{made['id']}/artifacts/download", expected).ok()["items"]
    assert fetch(link["url"])[1] == b"a track"
    log = lab.get(f"/runs/{made['id']}/log", {"offset": "4"}).ok()
    assert (log["text"], log["is_over"]) == ("two\n", True)


def test_a_claim_is_answered_again_after_a_lost_answer(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission)
    first = runner.claim()
    runner.active_ids.clear()
    again = runner.claim()
    assert (again["run_id"], again["attempt"]) == (made["id"], first["attempt"])


def test_a_run_whose_runner_is_lost_is_queued_again(lab: Api, runner: FakeRunner, place: Place) -> None:
    """Another runner gets it; requests of the first are refused, and nothing of its attempt remains."""
    made = launch(lab, runner, place.mission)
    first = runner.claim()
    runner.upload_artifact(first, "half", b"half a result")
    _expire_lease(lab, made["id"])
    other = another(lab, runner)
    other.register()
    second = other.claim()
    assert (second["run_id"], second["attempt"]) == (made["id"], 2)
    assert runner.heartbeat(first) == "lost"
    runner.finish(first).refused(409, "run_gone")
    assert lab.all(f"/runs/{made['id']}/artifacts") == []
    other.finish(second).ok()
    assert lab.get(f"/runs/{made['id']}").ok()["state"] == "done"


def test_a_run_that_loses_its_runners_repeatedly_fails(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission)
    for attempt in (1, 2, 3):
        runner.active_ids.clear()
        assert runner.claim()["attempt"] == attempt
        _expire_lease(lab, made["id"])
    runner.active_ids.clear()
    assert runner.claim() is None
    seen = lab.get(f"/runs/{made['id']}").ok()
    assert (seen["state"], seen["reason"]) == ("failed", "lost")
    assert "3 times" in seen["message"]


def test_a_started_run_stays_with_its_runner_for_longer(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    claim = runner.claim()
    lasting = []
    for state in ("running", "collecting"):
        assert runner.heartbeat(claim, state) == "active"
        (lasts,) = lab.sql("SELECT lease_ends_at - now() FROM run WHERE id = %s", uuid.UUID(claim["run_id"]))
        lasting.append(lasts[0].total_seconds())
    assert 50 < lasting[0] <= 60 < 800 < lasting[1] <= 900


def test_runs_of_a_silent_runner_can_be_cancelled(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission)
    runner.heartbeat(runner.claim(), "collecting")
    assert lab.post(f"/runs/{made['id']}/cancel").ok()["state"] == "collecting"
    other = another(lab, runner)
    other.register()
    assert other.claim() is None
    assert lab.get(f"/runs/{made['id']}").ok()["state"] == "collecting", "its runner was heard a moment ago"
    lab.sql("UPDATE runner SET last_seen_at = now() - interval '61 seconds' WHERE id = %s", uuid.UUID(runner.id))
    assert other.claim() is None
    assert lab.get(f"/runs/{made['id']}").ok()["state"] == "cancelled"


def _expire_lease(lab: Api, run_id: str) -> None:
    lab.sql("UPDATE run SET lease_ends_at = now() - interval '1 second' WHERE id = %s", uuid.UUID(run_id))


def test_a_restored_artifact_is_a_file_with_its_lineage(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission, right="CREATE")
    claim = runner.claim()
    runner.upload_artifact(claim, "clean.bin", b"cleaned")
    runner.upload_artifact(claim, "second.bin", b"other")
    mission_files = [
        {"path": "clean.bin", "to": "clean/drive.bin", "derived_from": ["drive.bin"]},
        {"path": "second.bin", "to": "drive.bin"},
    ]
    runner.finish(claim, report={"mission_files": mission_files}).ok()
    files = {entry["path"]: entry for entry in lab.all("/files", {"mission_id": place.mission["id"]})}
    assert files["clean/drive.bin"]["origin"] == "run"
    assert files["clean/drive.bin"]["sha256"] == sha256(b"cleaned")
    (problem,) = lab.get(f"/runs/{made['id']}").ok()["problems"]
    assert problem.startswith("second.bin did not become a file of the mission")
    assert files["drive.bin"]["sha256"] == place.files["drive.bin"]["sha256"], "nothing was replaced"
    origin = lab.get(f"/files/{files['clean/drive.bin']['id']}/lineage").ok()["made_by"]
    assert origin["run"]["id"] == made["id"]
    assert [entry["path"] for entry in origin["inputs"]] == ["drive.bin"]
    (reader,) = lab.get(f"/files/{files['drive.bin']['id']}/lineage").ok()["read_by"]
    assert [entry["path"] for entry in reader["files"]] == ["clean/drive.bin"]


def test_an_action_with_the_right_read_creates_no_mission_files(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission)
    claim = runner.claim()
    runner.upload_artifact(claim, "clean.bin", b"cleaned")
    runner.finish(claim, report={"mission_files": [{"path": "clean.bin", "to": "clean.bin"}]}).ok()
    assert len(lab.all("/files", {"mission_id": place.mission["id"]})) == 2
    assert "right: CREATE" in lab.get(f"/runs/{made['id']}").ok()["problems"][0]


def test_a_run_without_heartbeats_has_its_image_digest(lab: Api, runner: FakeRunner, place: Place) -> None:
    launched = launch(lab, runner, place.mission)
    runner.finish(runner.claim(), image_digest="sha256:short").ok()
    assert lab.get(f"/runs/{launched['id']}").ok()["image_digest"] == "sha256:short"


def test_results_of_an_identical_run_are_reused_unless_forced(lab: Api, runner: FakeRunner, place: Place) -> None:
    first = launch(lab, runner, place.mission)
    claim = runner.claim()
    runner.heartbeat(claim, image_digest="sha256:stock")
    runner.upload_artifact(claim, "made", b"made")
    of_file = [{"name": f"of_file_{number}", "value": number, "file": "drive.bin"} for number in range(20)]
    report = {
        "previews": [{"path": "made", "title": "Made"}],
        "metadata": {"robot": "spot"},
        "metrics": [*of_file, {"name": "of_run", "value": 1}],
    }
    runner.finish(claim, report=report).ok()
    second = launch(lab, runner, place.mission, force=False)
    assert (second["state"], second["reuses_id"]) == ("done", first["id"])
    assert second["artifact_count"] == 1
    shown = [lab.get(f"/runs/{entry['id']}").ok() for entry in (first, second)]
    for values in ("previews", "metadata", "problems", "finding_counts", "metric_count", "metrics"):
        assert shown[0][values] == shown[1][values]
    assert [entry["name"] for entry in shown[1]["metrics"][:2]] == ["of_run", "of_file_0"]
    assert len(shown[1]["metrics"]) == 12
    assert shown[1]["previews"] != []
    assert [entry["path"] for entry in lab.all(f"/runs/{second['id']}/artifacts")] == ["made"]
    changed = {"parameters": [{"name": "rate", "type": "number", "default": 1.0}]}
    assert launch(lab, runner, place.mission, force=False, **changed)["state"] == "queued"
    assert launch(lab, runner, place.mission, force=True)["state"] == "queued"


def test_runs_are_cancelled_in_the_queue_and_while_active(lab: Api, runner: FakeRunner, place: Place) -> None:
    queued = launch(lab, runner, place.mission)
    assert lab.post(f"/runs/{queued['id']}/cancel").ok()["state"] == "cancelled"
    assert runner.claim() is None
    active_ids = launch(lab, runner, place.mission)
    claim = runner.claim()
    assert lab.post(f"/runs/{active_ids['id']}/cancel").ok()["cancel_requested_at"] is not None
    assert runner.heartbeat(claim) == "cancel"
    assert runner.finish(claim, "cancelled").ok() == {"state": "cancelled"}
    assert lab.post(f"/runs/{active_ids['id']}/cancel").ok()["state"] == "cancelled", "repeated"


def test_a_mission_that_is_deleted_ends_its_runs(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    claim = runner.claim()
    launch(lab, runner, place.mission)
    lab.delete(f"/missions/{place.mission['id']}").ok()
    assert runner.heartbeat(claim) == "cancel"
    assert runner.claim() is None, "what waits is not begun"
    runner.finish(claim, "cancelled").ok()


def test_a_launch_without_matching_files_is_refused(lab: Api, runner: FakeRunner, place: Place) -> None:
    action = {"name": "bags", "script": "x", "inputs": {"paths": ["*.bag"]}}
    (refused,) = lab.post("/runs", {"mission_ids": [place.mission["id"]], "definition": action}).ok()["items"]
    assert refused["outcome"] == "refused"
    assert refused["problem"]["code"] == "no_inputs"
    assert "*.bag" in refused["problem"]["detail"]


def test_a_queued_run_says_what_it_waits_for(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission, resources={"cores": 4})
    lab.sql("UPDATE runner SET capacity = capacity || '{\"cores\": 2}' WHERE id = %s", runner.id)
    assert "it has 2 cores and 4 are asked for" in lab.get(f"/runs/{made['id']}").ok()["waits_for"]
    assert "is queued for" in launch(lab, runner, place.mission)["waits_for"]


def test_claims_respect_free_resources(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission, resources={"cores": 3, "memory": "8GB"})
    assert runner.claim(cores=2) is None
    assert runner.claim(memory_bytes=7 * 10**9) is None
    assert runner.claim(cores=3) is not None


def test_each_wrong_parameter_is_named(lab: Api, runner: FakeRunner, place: Place) -> None:
    parameters = [{"name": "rate", "type": "number", "minimum": 0}, {"name": "topic", "type": "topic"}]
    action = {"name": "count", "script": "x", "parameters": parameters}
    expected = {"mission_ids": [place.mission["id"]], "definition": action, "parameters": {"rate": -1, "speed": 2}}
    problems = lab.post("/runs", expected).refused(422, "invalid_request")["problems"]
    assert {entry["field"] for entry in problems} == {"parameters.rate", "parameters.topic", "parameters.speed"}
