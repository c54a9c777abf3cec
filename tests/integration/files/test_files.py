"""Files through HTTP: rename, move, label, delete."""

import uuid
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.integration.api_server import Api
from tests.integration.races import racing
from tests.integration.sample import Sample


@pytest.fixture(name="mission")
def _mission(api: Api) -> str:
    made: str = api.mission(api.project()["id"])["id"]
    return made


def test_reads_a_file_with_all_that_is_known_of_it(api: Api, sample: Sample, mission: str) -> None:
    file_id = sample.file(
        mission,
        "bags/a.mcap",
        labels=("night",),
        size_bytes=123,
        crc64nvme=bytes(8),
        start_ns=1,
        end_ns=5,
        message_count=2,
        compression=["zstd"],
    )
    seen = api.get(f"/files/{file_id}").ok()
    assert (seen["path"], seen["size_bytes"], seen["labels"]) == ("bags/a.mcap", 123, ["night"])
    assert (seen["state"], seen["content"], seen["format"]) == ("stored", "indexed", "mcap")
    assert (len(seen["sha256"]), seen["md5"], seen["crc64nvme"]) == (64, None, "0" * 16)
    assert (seen["start_ns"], seen["end_ns"], seen["message_count"]) == (1, 5, 2)
    assert (seen["compression"], seen["problems"], seen["recording_id"]) == (["zstd"], [], None)
    assert (seen["mission"]["id"], seen["uploaded_by"]["name"]) == (mission, "owner")


def test_unknown_ids_are_not_found(api: Api) -> None:
    unknown = str(uuid.uuid4())
    for answer in (
        api.get(f"/files/{unknown}"),
        api.patch(f"/files/{unknown}", {"path": "x"}),
        api.delete(f"/files/{unknown}"),
        api.get(f"/files/{unknown}/topics"),
        api.post(f"/files/{unknown}/verify"),
        api.post("/files/download", {"file_ids": [unknown]}),
    ):
        assert answer.refused(404, "not_found")["ref"] == unknown


def test_renaming_changes_the_path_and_nothing_else(api: Api, sample: Sample, mission: str) -> None:
    file_id = sample.file(mission, "a.mcap")
    before = api.get(f"/files/{file_id}").ok()
    renamed = api.patch(f"/files/{file_id}", {"path": "bags/Cafe\u0301.mcap"}).ok()
    assert renamed == {**before, "path": "bags/Café.mcap", "etag": renamed["etag"]}
    assert renamed["etag"] != before["etag"]
    (event,) = api.events(file_id)
    assert (event["operation"], event["before"], event["after"]) == (
        "file.update",
        {"path": "a.mcap"},
        {"path": "bags/Café.mcap"},
    )


def test_renaming_to_itself_or_another_case_works(api: Api, sample: Sample, mission: str) -> None:
    file_id = sample.file(mission, "a.mcap")
    api.patch(f"/files/{file_id}", {"path": "a.mcap"}).ok()
    assert api.events(file_id) == []
    assert api.patch(f"/files/{file_id}", {"path": "A.mcap"}).ok()["path"] == "A.mcap"


@pytest.mark.parametrize(
    ("there", "required", "code"),
    [
        ("a.mcap", "a.mcap", "name_taken"),
        ("Straße.mcap", "STRASSE.mcap", "name_taken"),
        ("caf\u00e9/x", "cafe\u0301/X", "name_taken"),
        ("a", "a/b", "path_conflict"),
        ("A", "a/b/c", "path_conflict"),
        ("a/b/c", "a", "path_conflict"),
        ("A/b/c", "a/B", "path_conflict"),
    ],
)
def test_a_path_that_is_taken_is_refused(
    api: Api, sample: Sample, mission: str, there: str, required: str, code: str
) -> None:
    sample.file(mission, there)
    file_id = sample.file(mission, "mine.mcap")
    problem = api.patch(f"/files/{file_id}", {"path": required}).refused(409, code)
    assert problem.get("other", there) == there
    assert api.get(f"/files/{file_id}").ok()["path"] == "mine.mcap"
    assert api.events(file_id) == []


@pytest.mark.parametrize(
    ("there", "required"), [("a.b", "a"), ("a", "a.b"), ("a-/x", "a"), ("a0", "a/b"), ("b/a", "a")]
)
def test_a_path_beside_a_similar_one_is_fine(api: Api, sample: Sample, mission: str, there: str, required: str) -> None:
    sample.file(mission, there)
    file_id = sample.file(mission, "mine.mcap")
    assert api.patch(f"/files/{file_id}", {"path": required}).ok()["path"] == required


@pytest.mark.parametrize(
    "path", ["", "/a", "a/", "a//b", "../a", "a/../b", ".", "a\nb", "a\x00", "x" * 300, "a\\b", "a/" * 600 + "b"]
)
def test_refuses_a_hostile_path(api: Api, sample: Sample, mission: str, path: str) -> None:
    file_id = sample.file(mission, "a.mcap")
    problem = api.patch(f"/files/{file_id}", {"path": path}).refused(422, "invalid_request")
    assert [one["field"] for one in problem["problems"]] == ["body.path"]


def test_moving_a_file_groups_both_missions_again(api: Api, sample: Sample, mission: str) -> None:
    target = api.mission(api.project()["id"])
    file_id = sample.file(mission, "a.mcap")
    moved = api.patch(f"/files/{file_id}", {"mission_id": target["id"], "path": "b.mcap"}).ok()
    assert (moved["mission"]["id"], moved["path"]) == (target["id"], "b.mcap")
    arrived, left = api.events(file_id)
    assert (arrived["operation"], arrived["project_id"]) == ("file.move_in", target["project"]["id"])
    assert (arrived["before"], arrived["after"]["mission"]) == ({"path": "a.mcap"}, target["name"])
    assert (left["operation"], left["mission_id"], left["after"]) == ("file.move_out", mission, {})
    jobs = api.sql("SELECT args ->> 'ref' FROM procrastinate_jobs WHERE task_name = 'group_recordings'")
    assert {mission, target["id"]} <= {ref for (ref,) in jobs}


def test_does_not_move_to_a_mission_that_is_not_there(api: Api, sample: Sample, mission: str) -> None:
    gone = api.mission(api.project()["id"])["id"]
    api.delete(f"/missions/{gone}").ok()
    file_id = sample.file(mission, "a.mcap")
    assert api.patch(f"/files/{file_id}", {"mission_id": gone}).refused(404, "not_found")["resource_type"] == "mission"
    assert api.sql("SELECT 1 FROM procrastinate_jobs WHERE args ->> 'ref' IN (%s, %s)", gone, mission) == []


def test_labels_replace_each_other_and_repeat_nothing(api: Api, sample: Sample, mission: str) -> None:
    file_id = sample.file(mission, "a.mcap", labels=("old",))
    assert api.patch(f"/files/{file_id}", {"labels": ["night", "rain", "night"]}).ok()["labels"] == ["night", "rain"]
    assert api.patch(f"/files/{file_id}", {"labels": []}).ok()["labels"] == []
    api.patch(f"/files/{file_id}", {"labels": ["a,b"]}).refused(422, "invalid_request")
    assert [event["after"] for event in api.events(file_id)] == [{"labels": []}, {"labels": ["night", "rain"]}]


def test_a_deleted_file_is_gone_and_its_path_is_free(api: Api, sample: Sample, mission: str) -> None:
    file_id = sample.file(mission, "a.mcap", size_bytes=9)
    expected = {"missions": 0, "files": 1, "size_bytes": 9, "read_by_runs": 0, "made_from_it": []}
    assert api.delete(f"/files/{file_id}", {"dry_run": "true"}).ok() == {**expected, "dry_run": True}
    assert api.delete(f"/files/{file_id}").ok() == {**expected, "dry_run": False}
    api.get(f"/files/{file_id}").refused(404, "not_found")
    other = sample.file(mission, "b.mcap")
    assert api.patch(f"/files/{other}", {"path": "a.mcap"}).ok()["path"] == "a.mcap"
    assert [event["operation"] for event in api.events(file_id)] == ["file.delete"]


def test_a_file_deleted_during_a_move_is_deleted_at_its_new_place(api: Api, sample: Sample) -> None:
    project = api.project()["id"]
    source, target = sorted((api.mission(project) for _ in range(2)), key=lambda mission: str(mission["id"]))
    file_id = sample.file(source["id"], "a.mcap")
    with racing(
        api, "SELECT 1 FROM mission WHERE id = ANY(%s::uuid[]) FOR UPDATE", [source["id"], target["id"]]
    ) as send:
        moved = send(api.patch, f"/files/{file_id}", {"mission_id": target["id"]})
        deleted = send(api.delete, f"/files/{file_id}")
    moved.result().ok()
    deleted.result().ok()
    deletion, move, _ = api.events(file_id)
    assert (deletion["operation"], deletion["before"]["mission"]) == ("file.delete", target["name"])
    assert move["after"] == {"mission": target["name"]}
    revisions = dict(api.sql("SELECT id::text, files_revision FROM mission WHERE project_id = %s", project))
    assert revisions == {source["id"]: 1, target["id"]: 2}


def test_the_audit_log_names_who_requested_a_verification(api: Api, sample: Sample, mission: str) -> None:
    file_id = sample.file(mission, "a.mcap")
    api.post(f"/files/{file_id}/verify").ok(202)
    (event,) = api.events(file_id)
    assert (event["operation"], event["resource_name"], event["actor"]["name"]) == ("file.verify", "a.mcap", "owner")


@pytest.mark.parametrize("resource_type", ["project", "mission", "file"])
def test_two_deletions_at_once_are_one(api: Api, sample: Sample, resource_type: str) -> None:
    project = api.project()["id"]
    mission = api.mission(project)["id"]
    resource_id = {"project": project, "mission": mission, "file": sample.file(mission, "a.mcap")}[resource_type]
    locked, locked_id = ("project", project) if resource_type == "project" else ("mission", mission)
    with racing(api, f"SELECT 1 FROM {locked} WHERE id = %s FOR UPDATE", locked_id) as send:
        both = [send(api.delete, f"/{resource_type}s/{resource_id}") for _ in range(2)]
    assert sorted(item.result().status for item in both) == [200, 404]
    assert [event["operation"] for event in api.events(resource_id)].count(f"{resource_type}.delete") == 1


def test_changing_a_file_takes_at_most_a_fixed_number_of_queries(api: Api, sample: Sample, mission: str) -> None:
    for number in range(20):
        sample.file(mission, f"{number}.mcap")
    file_id = sample.file(mission, "a.mcap")
    with api.statements() as statements:
        api.patch(f"/files/{file_id}", {"path": "b.mcap"}).ok()
    assert len(statements) <= 16


def test_topics_of_a_file_come_by_name_in_pages(api: Api, sample: Sample, mission: str) -> None:
    topics = [{"name": name, "message_type": "sensor_msgs/msg/Imu", "count": 5} for name in ("/c", "/a", "/b")]
    file_id = sample.file(mission, "a.mcap", topics=[*topics, {"name": "/a", "message_type": None, "rate_hz": 1.5}])
    rows = api.all(f"/files/{file_id}/topics", {"limit": "2"})
    assert [row["name"] for row in rows] == ["/a", "/a", "/b", "/c"]
    assert {row["file_id"] for row in rows} == {file_id}
    assert {row["rate_hz"] for row in rows if row["message_type"] is None} == {1.5}


def test_requesting_a_verification_enqueues_it(api: Api, sample: Sample, mission: str) -> None:
    blob_id = sample.blob()
    file_id = sample.link(mission, "a.mcap", blob_id)
    assert api.post(f"/files/{file_id}/verify").ok(202)["id"] == file_id
    results = api.sql("SELECT count(*) FROM procrastinate_jobs WHERE args ->> 'ref' = %s", blob_id)
    assert results == [(1,)]


def test_concurrent_moves_to_conflicting_paths_cannot_both_succeed(api: Api, sample: Sample, mission: str) -> None:
    for round_ in range(5):
        ids = [sample.file(mission, f"{round_} {name}") for name in ("first", "second")]
        bodies = [{"path": f"{round_} x"}, {"path": f"{round_} X/y"}]
        with ThreadPoolExecutor(2) as pool:
            answers = list(
                pool.map(lambda item: api.patch(f"/files/{item[0]}", item[1]), zip(ids, bodies, strict=True))
            )
        assert sorted(answer.status for answer in answers) == [200, 409]


def test_the_longest_paths_fit_and_longer_ones_are_refused(api: Api, sample: Sample, mission: str) -> None:
    letters = "".join(chr(0x1F300 + number * 7 % 700) for number in range(60))
    file_id = sample.file(mission, "a.mcap")
    path = "/".join([letters] * 9)
    assert api.patch(f"/files/{file_id}", {"path": path}).ok()["path"] == path
    api.patch(f"/files/{file_id}", {"path": "/".join([letters] * 12)}).refused(422, "invalid_request")
