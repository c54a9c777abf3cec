"""All files of a mission on one time axis."""

import uuid

from kleinkram import connect
from tests.integration.api_server import Api
from tests.integration.sample import Sample

T0 = 1_700_000_000_000_000_000


def test_files_come_with_their_times_and_recordings(api: Api, sample: Sample) -> None:
    mission = api.mission(api.project()["id"])["id"]
    first = sample.file(mission, "b/one.mcap", start_ns=T0, end_ns=T0 + 5, size_bytes=7)
    other = sample.file(mission, "a.yaml", content="opaque", format="yaml")
    recording = sample.recording(mission, "b", [first])
    api.sql("UPDATE mission SET start_ns = %s, end_ns = %s WHERE id = %s", T0, T0 + 5, mission)
    result = api.get(f"/missions/{mission}/timeline").ok()
    assert (result["start_ns"], result["end_ns"], result["next"]) == (T0, T0 + 5, None)
    bare = {
        "recording_id": None,
        "start_ns": None,
        "end_ns": None,
        "size_bytes": 100,
        "state": "stored",
        "is_derived": False,
    }
    timed = {
        "recording_id": recording,
        "start_ns": T0,
        "end_ns": T0 + 5,
        "size_bytes": 7,
        "state": "stored",
        "is_derived": False,
    }
    assert result["items"] == [
        {"id": other, "path": "a.yaml", "content": "opaque", **bare},
        {"id": first, "path": "b/one.mcap", "content": "indexed", **timed},
    ]


def test_pages_follow_each_other_and_leave_out_the_trash(api: Api, sample: Sample) -> None:
    mission = api.mission(api.project()["id"])["id"]
    ids = [sample.file(mission, f"{number}.mcap") for number in range(5)]
    api.delete(f"/files/{ids.pop()}").ok()
    path = f"/missions/{mission}/timeline"
    seen = []
    cursor: dict[str, str] = {}
    while True:
        page = api.get(path, {"limit": "3", **cursor}).ok()
        seen += [item["id"] for item in page["items"]]
        if page["next"] is None:
            break
        cursor = {"cursor": page["next"]}
    assert seen == ids
    with connect(api.url, api.token) as client:
        assert [str(file.id) for file in client.missions.timeline(uuid.UUID(mission))] == ids
    api.get(path, {"cursor": "x"}).refused(422, "invalid_cursor")
    api.get(path, {"limit": "10001"}).refused(422, "invalid_request")


def test_the_number_of_queries_does_not_depend_on_the_number_of_files(api: Api, sample: Sample) -> None:
    mission = api.mission(api.project()["id"])["id"]
    api.get(f"/missions/{mission}/timeline").ok()
    counts = []
    for number in range(2):
        sample.file(mission, f"{number}.mcap")
        with api.statements() as statements:
            api.get(f"/missions/{mission}/timeline").ok()
        counts.append(len(statements))
    assert counts == [3, 3]
