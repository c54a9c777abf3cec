"""Processing of uploaded bytes: summaries, verification, damage, deletion."""

import os
from collections.abc import Callable
from typing import Any

import pytest

from kleinkram.recordings.sample import generate_bag, generate_mcap
from kleinkram.server.blobs.queries import SMALL_BYTES
from kleinkram.server.maintenance import collect_garbage
from tests.integration import upload_client
from tests.integration.api_server import Api
from tests.integration.jobs import on_site, run_jobs
from tests.integration.upload_client import begin, fetch, upload, upload_all

Generate = Callable[..., Any]


@pytest.fixture(name="api", scope="module")
def _api(start_api: Any) -> Api:
    """An API of its own: its jobs are run by these tests alone."""
    api: Api = start_api(garbage_grace_s=0)
    return api


def _blob(api: Api, file_id: str) -> tuple[str, str]:
    row = api.sql("SELECT b.id::text, b.key FROM blob b JOIN file f ON f.blob_id = b.id WHERE f.id = %s", file_id)[0]
    return str(row[0]), str(row[1])


@pytest.mark.parametrize(("name", "generate"), [("run.mcap", generate_mcap), ("run.bag", generate_bag)])
def test_a_recording_is_summarised_and_verified(
    api: Api, mission_id: str, tmp_path: Any, name: str, generate: Generate
) -> None:
    generate(tmp_path / name, size_bytes=2_000_000, seed=3)
    body = (tmp_path / name).read_bytes()
    file = upload(api, mission_id, name, body)
    assert api.get(f"/missions/{mission_id}").ok()["pending_file_count"] == 1
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"], read["content_reason"]) == ("verified", "indexed", None)
    assert read["md5"] == upload_client.checksum("md5", body)
    topics = api.all(f"/files/{file['id']}/topics")
    assert sum(topic["count"] for topic in topics) == read["message_count"] > 0
    imu = next(topic for topic in topics if topic["name"] == "/imu/data")
    assert imu["rate_hz"] == pytest.approx(200, rel=0.01)
    mission = api.get(f"/missions/{mission_id}").ok()
    assert (mission["start_ns"], mission["end_ns"]) == (read["start_ns"], read["end_ns"])
    assert mission["recordings_current"] is True
    recordings = api.all(f"/missions/{mission_id}/recordings")
    assert [(item["name"], item["kind"]) for item in recordings] == [(name, "single")]


def test_many_small_files_are_summarised_in_one_job(start_api: Any, tmp_path: Any) -> None:
    api: Api = start_api()
    mission_id = api.mission(api.project()["id"])["id"]
    generate_mcap(tmp_path / "run.mcap", size_bytes=80_000, seed=7)
    recording = (tmp_path / "run.mcap").read_bytes()
    assert len(recording) <= SMALL_BYTES
    bodies = {f"{number}.bin": os.urandom(100) for number in range(20)}
    files = upload_all(api, mission_id, {**bodies, "run.mcap": recording, "bad.bin": b"bad", "gone.bin": b"gone"})
    (_, bad), (_, gone) = (_blob(api, files[path]["id"]) for path in ("bad.bin", "gone.bin"))
    on_site(api, lambda site: site.storage.put_object(bad, b"dab"))
    on_site(api, lambda site: site.storage.delete(gone))
    waiting = "SELECT count(*) FROM procrastinate_jobs WHERE task_name = 'examine_blob' AND status = 'todo'"
    assert api.sql(waiting) == [(23,)]
    ran = run_jobs(api)
    assert 3 <= ran.count("examine_blob") <= 12, "what is damaged is told by a job of its own, as far as it is one"
    assert "verify_blob" not in ran
    result = {item["path"]: item for item in api.all("/files", {"mission_id": mission_id})}
    states = {path: (item["state"], item["content"]) for path, item in result.items()}
    damaged = {"bad.bin": ("corrupt", "error"), "gone.bin": ("lost", "error"), "run.mcap": ("verified", "indexed")}
    assert states == dict.fromkeys(bodies, ("verified", "opaque")) | damaged
    assert result["run.mcap"]["depth"] == "scan"
    topics = api.all(f"/files/{files['run.mcap']['id']}/topics")
    assert sum(topic["count"] for topic in topics) == result["run.mcap"]["message_count"] > 0
    assert result["0.bin"]["md5"] == upload_client.checksum("md5", bodies["0.bin"])


def test_two_recordings_of_one_stem_are_two(api: Api, mission_id: str, tmp_path: Any) -> None:
    generate_mcap(tmp_path / "run.mcap", size_bytes=500_000, seed=4)
    generate_bag(tmp_path / "run.bag", size_bytes=500_000, seed=5)
    for name in ("run.mcap", "run.bag"):
        upload(api, mission_id, name, (tmp_path / name).read_bytes())
    run_jobs(api)
    assert [item["name"] for item in api.all(f"/missions/{mission_id}/recordings")] == ["run.bag", "run.mcap"]


def test_a_member_that_is_missing_is_named(api: Api, mission_id: str) -> None:
    yaml = (
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  message_count: 9\n"
        "  relative_file_paths: [run_0.mcap, run_1.mcap]\n"
    )
    upload(api, mission_id, "run/metadata.yaml", yaml.encode() + os.urandom(4).hex().encode().join([b"# ", b"\n"]))
    upload(api, mission_id, "run/run_0.mcap", b"\x89MCAP0\r\n" + os.urandom(9))
    upload(api, mission_id, "run/run_7.mcap", b"\x89MCAP0\r\n" + os.urandom(9))
    run_jobs(api)
    recording = api.all(f"/missions/{mission_id}/recordings")[0]
    assert (recording["kind"], recording["missing"], recording["unlisted"]) == (
        "rosbag2",
        ["run_1.mcap"],
        ["run_7.mcap"],
    )
    assert ("member-missing", "run_1.mcap") in {(item["code"], item["where"]) for item in recording["problems"]}
    assert (recording["content"], recording["lost"]["messages"]) == ("broken", 9)


def test_a_file_with_a_wrong_extension_is_opaque(api: Api, mission_id: str) -> None:
    file = upload(api, mission_id, "holiday.bag", b"\xff\xd8\xff\xe0" + os.urandom(1000))
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"]) == ("verified", "opaque")
    assert [problem["code"] for problem in read["problems"]] == ["extension-lies"]


def test_an_altered_object_is_corrupt_and_can_be_repaired(api: Api, mission_id: str) -> None:
    body = os.urandom(5000)
    file = upload(api, mission_id, "run.bin", body)
    run_jobs(api)
    _, key = _blob(api, file["id"])
    on_site(api, lambda site: site.storage.put_object(key, body[:-1] + bytes([body[-1] ^ 1])))
    api.post(f"/files/{file['id']}/verify").ok(202)
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert read["state"] == "corrupt"
    assert "CRC-64/NVME" in read["state_reason"]
    api.post("/files/download", {"file_ids": [file["id"]]}).refused(409, "file_unavailable")
    assert 'kleinkram_blobs{state="corrupt"} 1' in api.metrics()
    repaired = upload(api, mission_id, "run.bin", body)
    assert (repaired["id"], repaired["state"]) == (file["id"], "stored")
    assert api.events(file["id"])[0]["operation"] == "file.repair"
    link = api.post("/files/download", {"file_ids": [file["id"]]}).ok()["items"][0]
    assert fetch(link["url"]) == (200, body)


def test_a_vanished_object_is_lost(api: Api, mission_id: str) -> None:
    body = os.urandom(50)
    file = upload(api, mission_id, "run.bin", body)
    _, key = _blob(api, file["id"])
    on_site(api, lambda site: site.storage.delete(key))
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["state_reason"]) == ("lost", "the store no longer has the object")
    assert begin(api, mission_id, {"copy.bin": body})[0]["decision"] == "upload", "what is lost is nobody's twin"


def test_objects_are_deleted_only_when_nothing_refers_to_them(api: Api, mission_id: str) -> None:
    body = os.urandom(700)
    first = upload(api, mission_id, "first.bin", body)
    run_jobs(api)
    second = begin(api, mission_id, {"second.bin": body})[0]["file"]
    _, key = _blob(api, first["id"])
    for file in (first, second):
        assert on_site(api, lambda site: site.storage.find(key)) is not None
        api.delete(f"/files/{file['id']}").ok()
        on_site(api, collect_garbage)  # still in the trash: nothing goes
        assert on_site(api, lambda site: site.storage.find(key)) is not None
        api.sql("UPDATE file SET deleted_at = now() - interval '31 days' WHERE id = %s", file["id"])
        on_site(api, collect_garbage)
        on_site(api, collect_garbage)
    assert on_site(api, lambda site: site.storage.find(key)) is None
    assert api.sql("SELECT count(*) FROM blob WHERE key = %s", key) == [(0,)]
    assert api.events(first["id"])[0]["operation"] == "file.purge"


def test_an_expired_project_is_deleted_with_its_contents(api: Api) -> None:
    project = api.project()
    mission_id = api.mission(project["id"])["id"]
    upload(api, mission_id, "run.bin", os.urandom(10))
    run_jobs(api)
    api.delete(f"/projects/{project['id']}").ok()
    api.sql("UPDATE project SET deleted_at = now() - interval '31 days' WHERE id = %s", project["id"])
    for _ in range(3):
        on_site(api, collect_garbage)
    assert api.sql("SELECT count(*) FROM project WHERE id = %s", project["id"]) == [(0,)]
    assert api.sql("SELECT count(*) FROM mission WHERE id = %s", mission_id) == [(0,)]


def test_a_blob_marked_for_deletion_is_not_linked(api: Api, mission_id: str) -> None:
    body = os.urandom(300)
    file = upload(api, mission_id, "run.bin", body)
    api.sql(
        "UPDATE blob SET marked_for_deletion_at = now() WHERE id = (SELECT blob_id FROM file WHERE id = %s)", file["id"]
    )
    assert begin(api, mission_id, {"again.bin": body})[0]["decision"] == "upload"


@pytest.mark.parametrize(
    ("size_bytes", "expected"), [(30, {"examine_blob"}), (SMALL_BYTES, {"verify_blob", "summarise_blob"})]
)
def test_blobs_and_missions_of_failed_jobs_are_processed_again(
    api: Api, mission_id: str, size_bytes: int, expected: set[str]
) -> None:
    file = upload(api, mission_id, "run.bag", b"#ROSBAG V2.0\n" + os.urandom(size_bytes))
    api.sql("DELETE FROM procrastinate_jobs")
    on_site(api, collect_garbage)
    assert api.sql("SELECT count(*) FROM procrastinate_jobs WHERE task_name <> 'group_recordings'") == [(0,)], (
        "too early"
    )
    api.sql("UPDATE blob SET created_at = now() - interval '1 hour' WHERE id = %s", _blob(api, file["id"])[0])
    on_site(api, collect_garbage)
    on_site(api, collect_garbage)  # a second round asks for nothing twice
    jobs = api.sql("SELECT task_name, args ->> 'ref' FROM procrastinate_jobs WHERE status = 'todo'")
    assert {job for job, _ in jobs} == {"group_recordings", *expected}
    assert len(jobs) == len(set(jobs))
    run_jobs(api)
    assert api.get(f"/files/{file['id']}").ok()["state"] == "verified"
    assert api.get(f"/missions/{mission_id}").ok()["recordings_current"] is True
