"""Recordings through HTTP."""

import uuid

from tests.integration.api_server import Api
from tests.integration.sample import Sample


def test_reads_a_recording_with_its_members_in_order(api: Api, sample: Sample) -> None:
    mission = api.mission(api.project()["id"])
    files = [sample.file(mission["id"], f"run/{name}.db3", size_bytes=10) for name in ("run_1", "run_0")]
    facts = {"kind": "rosbag2", "start_ns": 5, "end_ns": 9, "message_count": 3, "missing": ["run_2.db3"]}
    made = sample.recording(mission["id"], "run", files, **facts)
    seen = api.get(f"/recordings/{made}").ok()
    assert (seen["name"], seen["kind"], seen["mission"]["id"]) == ("run", "rosbag2", mission["id"])
    assert (seen["paths"], seen["file_ids"]) == (["run/run_0.db3", "run/run_1.db3"], files[::-1])
    assert (seen["start_ns"], seen["end_ns"], seen["message_count"], seen["size_bytes"]) == (5, 9, 3, 20)
    assert (seen["missing"], seen["unlisted"], seen["problems"]) == (["run_2.db3"], [], [])
    assert [item["id"] for item in api.all("/files", {"recording_id": made})] == files[::-1]


def test_lists_the_recordings_of_a_mission_by_name(api: Api, sample: Sample) -> None:
    mission = api.mission(api.project()["id"])["id"]
    api.get(f"/missions/{mission}").ok()  # so that an admin's look is noted already
    counts = []
    for name in "bca":
        sample.recording(mission, name, [sample.file(mission, f"{name}.mcap")])
        with api.statements() as statements:
            api.get(f"/missions/{mission}/recordings").ok()
        counts.append(len(statements))
    listed = api.all(f"/missions/{mission}/recordings", {"limit": "1"})
    assert [recording["name"] for recording in listed] == ["a", "b", "c"]
    assert counts == [3, 3, 3]


def test_missing_and_deleted_recordings_are_not_found(api: Api, sample: Sample) -> None:
    mission = api.mission(api.project()["id"])["id"]
    made = sample.recording(mission, "a", [sample.file(mission, "a.mcap")])
    api.delete(f"/missions/{mission}").ok()
    for path in (f"/recordings/{made}", f"/recordings/{uuid.uuid4()}", f"/missions/{mission}/recordings"):
        api.get(path).refused(404, "not_found")
