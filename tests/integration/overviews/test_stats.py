"""Statistics of a project by month and by metadata fields, in a bounded number of buckets."""

import uuid
from typing import Any

import pytest

from kleinkram import connect
from kleinkram.recordings.message_density import count_stamps, pack
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.sample import Sample

HOUR = 3600 * 10**9
MAY = 1_715_000_000 * 10**9
JUNE = 1_718_000_000 * 10**9
FORM = {
    "fields": [
        {"name": "robot", "type": "string"},
        {"name": "speed", "type": "number", "unit": "m/s"},
    ]
}


def _mission(api: Api, sample: Sample, project_id: str, start_ns: int, hours: int, **metadata: Any) -> str:
    mission = str(api.mission(project_id, metadata=metadata)["id"])
    span: dict[str, Any] = {"start_ns": start_ns, "end_ns": start_ns + hours * HOUR}
    topic = {"name": "/imu", "message_type": "a/B", "count": 1, "first_ns": start_ns, "last_ns": start_ns}
    own = {**topic, "name": f"/{uuid.uuid4()}"}
    density = {"density": pack(count_stamps([start_ns]))}
    file_id = sample.file(mission, "a.mcap", topics=[{**topic, **density}, {**own, **density}], **span)
    sample.recording(mission, "a.mcap", [file_id], **span)
    return mission


@pytest.fixture(name="project_id")
def _project_id(api: Api) -> str:
    return str(api.project(metadata_fields=FORM)["id"])


def _stats(actual: Any) -> list[tuple[Any, ...]]:
    return [(item["value"], item["low"], item["high"], item["stats"]["missions"]) for item in actual["buckets"]]


def test_by_month_in_their_order(api: Api, sample: Sample, project_id: str) -> None:
    _mission(api, sample, project_id, JUNE, 3)
    _mission(api, sample, project_id, MAY, 1)
    mission = _mission(api, sample, project_id, MAY, 2)
    sample.file(mission, "notes.yaml", content="opaque", size_bytes=5)
    actual = api.get(f"/projects/{project_id}/stats").ok()
    assert _stats(actual) == [("2024-05", None, None, 2), ("2024-06", None, None, 1), (None, None, None, 1)]
    assert [item["stats"]["duration_ns"] // HOUR for item in actual["buckets"]] == [3, 3, 0]
    total = actual["total"]
    assert (total["missions"], total["files"], total["size_bytes"], total["duration_ns"]) == (3, 4, 305, 6 * HOUR)


def test_topics_are_counted_by_name(api: Api, sample: Sample, project_id: str) -> None:
    for start_ns in (MAY, JUNE):
        mission = _mission(api, sample, project_id, start_ns, 1)
        api.patch(f"/missions/{mission}", {"name": f"n{uuid.uuid4()}"}).ok()
        file_id = sample.file(mission, "gone.yaml")
        api.delete(f"/files/{file_id}").ok()
    run_jobs(api)
    assert api.get(f"/projects/{project_id}/stats").ok()["topics"] == 3


def test_by_values_of_a_field_with_the_longest_first(api: Api, sample: Sample, project_id: str) -> None:
    for number, hours in enumerate((1, 5, 2, 4)):
        _mission(api, sample, project_id, MAY, hours, robot=f"r{number}")
    _mission(api, sample, project_id, MAY, 1)
    actual = api.get(f"/projects/{project_id}/stats", {"by": "robot", "max_buckets": "2"}).ok()
    assert _stats(actual) == [("r1", None, None, 1), ("r3", None, None, 1), (None, None, None, 1)]
    assert (actual["other"]["missions"], actual["other"]["duration_ns"]) == (2, 3 * HOUR)
    assert api.get(f"/projects/{project_id}/stats", {"by": "metadata.robot"}).ok()["other"] is None


def test_by_ranges_of_numbers(api: Api, sample: Sample, project_id: str) -> None:
    for speed in (-0.5, 0, 0.4, 1.1, 1.9, 3):
        _mission(api, sample, project_id, MAY, 1, speed=speed)
    actual = api.get(f"/projects/{project_id}/stats", {"by": "speed", "max_buckets": "4"}).ok()
    assert _stats(actual) == [(None, -1, 0, 1), (None, 0, 1, 2), (None, 1, 2, 2), (None, 3, 4, 1)]
    assert actual["unit"] == "m/s"
    several = api.get(f"/projects/{project_id}/stats", {"by": "speed"}).ok()
    assert [item["value"] for item in several["buckets"]] == ["-0.5", "0", "0.4", "1.1", "1.9", "3"]


@pytest.mark.parametrize("values", [(0, 5e-324), (1e308, -1e308), (1e300, 1.0000000000000002e300)])
def test_numbers_of_any_size_find_a_range(
    api: Api, sample: Sample, project_id: str, values: tuple[float, float]
) -> None:
    for speed in values:
        _mission(api, sample, project_id, MAY, 1, speed=speed)
    actual = api.get(f"/projects/{project_id}/stats", {"by": "speed", "max_buckets": "1"}).ok()
    assert sum(item["stats"]["missions"] for item in actual["buckets"]) == 2


def test_statistics_by_an_unused_field_are_refused(api: Api, sample: Sample, project_id: str) -> None:
    _mission(api, sample, project_id, MAY, 1)
    problem = api.get(f"/projects/{project_id}/stats", {"by": "colour"}).refused(422, "invalid_query")
    assert problem["expression"] == "colour"
    assert _stats(api.get(f"/projects/{project_id}/stats", {"by": "robot"}).ok()) == [(None, None, None, 1)]
    api.get(f"/projects/{uuid.uuid4()}/stats").refused(404, "not_found")


def test_an_overview_combines_all_visible_projects(api: Api, sample: Sample, project_id: str) -> None:
    _mission(api, sample, project_id, MAY, 1, robot="spot")
    within = {"project_id": project_id, "by": "robot"}
    assert _stats(api.get("/overview", within).ok()) == [("spot", None, None, 1)]
    assert api.get("/overview").ok()["total"]["missions"] >= 1
    assert api.get("/overview", {"project_id": str(uuid.uuid4())}).ok()["total"]["missions"] == 0
    with connect(api.url, api.token) as client:
        actual = client.stats.overview("robot", project=uuid.UUID(project_id))
        assert [bucket.value for bucket in actual.buckets] == ["spot"]
        assert client.stats.overview().total.missions >= 1
