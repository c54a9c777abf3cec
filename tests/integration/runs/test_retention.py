"""Retention of inputs, artifacts, logs and runs."""

import threading
import uuid

import pytest

from kleinkram.contract.access import Scope, TokenKind
from kleinkram.server.context import AppContext
from kleinkram.server.events import hub as hubs
from kleinkram.server.events.hub import MAX_STREAMS_PER_PERSON
from kleinkram.server.maintenance import collect_garbage, maintain_runs
from kleinkram.server.s3.storage import Storage
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.jobs import on_site
from tests.integration.runs.conftest import FakeRunner, Place, another, launch
from tests.integration.upload_client import crc64, send, sha256, wait_until


def test_inputs_stay_as_long_as_a_run_may_read_them(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission)
    file_id = place.files["drive.bin"]["id"]
    lab.sql("UPDATE run_input SET file_id = NULL WHERE file_id = %s", file_id)
    (blob_id,) = lab.sql("DELETE FROM file WHERE id = %s RETURNING blob_id", file_id)[0]
    on_site(lab, _collect_garbage)
    assert lab.sql("SELECT marked_for_deletion_at FROM blob WHERE id = %s", blob_id) == [(None,)]
    lab.post(f"/runs/{made['id']}/cancel").ok()
    on_site(lab, _collect_garbage)
    assert lab.sql("SELECT marked_for_deletion_at IS NOT NULL FROM blob WHERE id = %s", blob_id) in ([(True,)], [])


def test_artifacts_of_a_run_remain_until_its_mission_is_deleted(lab: Api, runner: FakeRunner, place: Place) -> None:
    """The mission's deletion removes all of them; the audit log still names the token of the run."""
    launch(lab, runner, place.mission, network="api", right="WRITE")
    claim = runner.claim()
    lab.as_(claim["token"]).patch(f"/missions/{place.mission['id']}", {"notes": "by the run"}).ok()
    runner.write(claim, 0, b"a line\n")
    runner.upload_artifact(claim, "made", b"made")
    runner.upload_artifact(claim, ".kleinkram/log", b"a line\n")
    runner.finish(claim).ok()
    blobs = _blobs(lab, claim["run_id"])
    assert len(blobs) == 2
    on_site(lab, _collect_garbage)
    assert lab.sql("SELECT count(*) FROM blob WHERE id = ANY(%s) AND marked_for_deletion_at IS NULL", blobs) == [(2,)]
    assert lab.sql("SELECT count(*) FROM log_chunk WHERE run_id = %s", claim["run_id"]) == [(0,)], "joined"
    lab.delete(f"/missions/{place.mission['id']}").ok()
    lab.sql("UPDATE upload SET cleaned_at = now() WHERE mission_id = %s", place.mission["id"])
    lab.sql("UPDATE mission SET deleted_at = now() - interval '1 year' WHERE id = %s", place.mission["id"])
    for _ in range(3):
        on_site(lab, _collect_garbage)
    assert lab.sql("SELECT count(*) FROM run WHERE id = %s", claim["run_id"]) == [(0,)]
    assert lab.sql("SELECT count(*) FROM blob WHERE id = ANY(%s) AND marked_for_deletion_at IS NULL", blobs) == [(0,)]
    assert lab.sql("SELECT count(*) FROM token WHERE kind = 'run' AND run_id IS NULL AND revoked_at IS NOT NULL")[0][0]


def test_an_unrecorded_artifact_upload_is_recovered(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    claim, data = runner.claim(), bytes(20_000_000)
    upload_id = runner.begin(claim, "large", data)["id"]
    (opened,) = lab.sql("SELECT multipart_id FROM upload WHERE id = %s", upload_id)
    lab.sql("UPDATE upload SET multipart_id = NULL WHERE id = %s", upload_id)  # the API died before it could
    assert runner.begin(claim, "large", data)["id"] == upload_id
    assert lab.sql("SELECT multipart_id FROM upload WHERE id = %s", upload_id) == [opened]


@pytest.mark.parametrize("size_bytes", [100, 10_000_000])
def test_an_artifact_is_stored_if_its_runner_is_killed_on_completion(
    lab: Api, runner: FakeRunner, place: Place, size_bytes: int
) -> None:
    launch(lab, runner, place.mission)
    claim, data = runner.claim(), bytes(size_bytes)
    begun = runner.begin(claim, "map.ply", data)
    send(runner.api, begun, data)
    marked = "state = 'completing', completing_since = now(), sha256 = %s, crc64nvme = %s"  # and the store was away
    hashes = (bytes.fromhex(entry) for entry in (sha256(data), crc64(data)))
    lab.sql(f"UPDATE upload SET {marked} WHERE id = %s", *hashes, begun["id"])
    expected = {"path": "map.ply", "size_bytes": size_bytes, "sha256": sha256(data)}
    body = {"attempt": claim["attempt"], "files": [expected]}
    (decision,) = runner.api.post(f"/runner/runs/{claim['run_id']}/uploads", body).ok()["items"]
    assert decision["decision"] == "already_present"
    runner.finish(claim).ok()
    (stored,) = lab.all(f"/runs/{claim['run_id']}/artifacts")
    assert (stored["path"], stored["size_bytes"]) == ("map.ply", size_bytes)


def test_deleting_an_input_names_the_files_made_from_it(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission, right="CREATE")
    claim = runner.claim()
    runner.upload_artifact(claim, "clean", b"cleaned")
    mission_files = [{"path": "clean", "to": "clean/drive", "derived_from": ["drive.bin"]}]
    runner.finish(claim, report={"mission_files": mission_files}).ok()
    reported = lab.delete(f"/files/{place.files['drive.bin']['id']}", {"dry_run": "true"}).ok()
    assert (reported["read_by_runs"], reported["made_from_it"]) == (1, ["clean/drive"])
    other = lab.delete(f"/files/{place.files['notes/day.txt']['id']}").ok()
    assert (other["read_by_runs"], other["made_from_it"]) == (1, []), "it was read, and nothing was made of it"


def test_a_run_is_assigned_to_one_of_several_concurrent_runners(lab: Api, runner: FakeRunner, place: Place) -> None:
    """Ten runners claim forty runs at the same time: each is started once."""
    runs = [launch(lab, runner, place.mission)["id"] for _ in range(40)]
    runners = [another(lab, runner) for _ in range(10)]
    for entry in runners:
        entry.register()
    claimed: list[str] = []

    def ask(entry: FakeRunner) -> None:
        while (result := entry.claim()) is not None:
            claimed.append(result["run_id"])

    threads = [threading.Thread(target=ask, args=(entry,)) for entry in runners]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(claimed) == sorted(runs)


def test_waiting_readers_get_new_log_chunks(lab: Api, runner: FakeRunner, place: Place) -> None:
    got: list[str] = []
    waiting = threading.Thread(target=lambda: got.append(runner.claim(wait_s=20)["run_id"]))
    waiting.start()
    made = launch(lab, runner, place.mission)
    waiting.join(timeout=15)
    assert got == [made["id"]]


def test_a_log_is_read_while_it_grows(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission)
    claim = runner.claim()
    pieces: list[str] = []

    def follow() -> None:
        offset, is_over = 0, False
        while not is_over:
            piece = lab.get(f"/runs/{made['id']}/log", {"offset": str(offset), "wait_s": "10"}).ok()
            pieces.append(piece["text"])
            offset, is_over = piece["next_offset"], piece["is_over"]

    following = threading.Thread(target=follow)
    following.start()
    text = "".join(f"line {number} ä\n" for number in range(20_000)).encode()
    for start in range(0, len(text), 70_001):
        runner.write(claim, start, text[start : start + 70_001])
    runner.upload_artifact(claim, ".kleinkram/log", text)
    runner.finish(claim).ok()
    following.join(timeout=30)
    assert "".join(pieces).encode() == text


def test_a_chunk_that_is_replaced_during_a_read_is_found_again(
    lab: Api, runner: FakeRunner, place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = launch(lab, runner, place.mission)
    runner.write(runner.claim(), 0, b"a line\n")
    read, gone = Storage.read_range, [True]

    async def read_range(self: Storage, key: str, **what: int) -> bytes:
        if gone and gone.pop():  # as when the log was joined just then, and its pieces let go
            raise FileNotFoundError(key)
        return await read(self, key, **what)

    monkeypatch.setattr(Storage, "read_range", read_range)
    assert lab.get(f"/runs/{made['id']}/log").ok()["text"] == "a line\n"


def test_a_log_missing_from_the_store_is_reported(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission)
    runner.write(runner.claim(), 0, b"a line\n")
    ((key,),) = lab.sql("SELECT key FROM log_chunk WHERE run_id = %s", made["id"])
    on_site(lab, lambda context: context.storage.delete(key))
    lab.get(f"/runs/{made['id']}/log").refused(503, "store_unavailable")


def test_only_the_runner_of_a_run_can_read_how_it_ended(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    claim = runner.claim()
    runner.finish(claim).ok()
    runner.finish(claim).ok()
    other = people.person(lab)
    stranger = FakeRunner(lab.as_(people.token(lab, other, [Scope.run], kind=TokenKind.runner).secret))
    stranger.finish(claim).refused(409, "run_gone")


def _blobs(lab: Api, run_id: str) -> list[uuid.UUID]:
    left = lab.sql("SELECT blob_id FROM run_artifact WHERE run_id = %s", run_id)
    return [row[0] for row in left + lab.sql("SELECT log_blob_id FROM run WHERE id = %s", run_id)]


async def _collect_garbage(context: AppContext) -> None:
    await maintain_runs(context)
    await collect_garbage(context)


def test_runners_that_wait_take_no_streams_from_their_owner(lab: Api) -> None:
    admin = people.person(lab, admin=True)
    runner = FakeRunner(lab.as_(people.token(lab, admin, [Scope.run], kind=TokenKind.runner).secret))
    runner.register()
    threads = [threading.Thread(target=runner.claim, kwargs={"wait_s": 10}) for _ in range(MAX_STREAMS_PER_PERSON + 1)]
    for thread in threads:
        thread.start()
    hub = lab.app.state.hub
    wait_until(lambda: len(hub._long_polls) > MAX_STREAMS_PER_PERSON)
    mine = lab.as_(people.token(lab, admin).secret)
    assert mine.get("/events", {"for_s": "0"}).status == 200
    for thread in threads:
        thread.join()


def test_waiting_log_readers_do_not_block_other_requests(
    lab: Api, runner: FakeRunner, place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hubs, "MAX_LONG_POLLS_PER_ACCOUNT", 3)
    made = launch(lab, runner, place.mission)
    path, waiting = f"/runs/{made['id']}/log", {"wait_s": "10"}
    threads = [threading.Thread(target=lab.get, args=(path, waiting)) for _ in range(3)]
    for thread in threads:
        thread.start()
    hub = lab.app.state.hub
    wait_until(lambda: len(hub._long_polls) == 3)
    lab.get(path, waiting).refused(429, "too_many_streams")
    lab.get(path).ok()
    other = lab.as_(people.token(lab, people.person(lab, admin=True)).secret)
    assert other.get(path, {"wait_s": "0.1"}).status == 200, "each account has its own number"
    runner.finish(runner.claim())
    for thread in threads:
        thread.join()


def test_a_log_reader_is_woken_by_its_own_run_alone(lab: Api, runner: FakeRunner, place: Place) -> None:
    mine, other = (launch(lab, runner, place.mission) for _ in range(2))
    reader = threading.Thread(target=lab.get, args=(f"/runs/{mine['id']}/log", {"wait_s": "4"}))
    reader.start()
    hub = lab.app.state.hub
    wait_until(lambda: len(hub._long_polls) == 1)
    with lab.statements() as statements:
        for _ in range(20):
            noted = f'["run_log", "changed", "{other["id"]}", null, "{place.mission["id"]}", null]'
            lab.sql("SELECT pg_notify('kleinkram_changes', %s)", noted)
        reader.join()
    assert len([entry for entry in statements if "log_chunk" in entry]) < 10
