"""Statistics: what is counted where, and how often."""

import uuid
from typing import Any

import pytest

from kleinkram.server.search import statistics
from tests.integration.api_server import Api
from tests.integration.sample import Sample

HOUR_NS = 3600 * 10**9
MAY, JUNE = 1_714_521_600 * 10**9, 1_717_200_000 * 10**9  # 2024-05-01 and 2024-06-01, 00:00 UTC


@pytest.fixture(scope="module")
def project(api: Api, sample: Sample) -> Any:
    """Alps: one recording of two files that runs from May into June; Lake: one of one file, and a text."""
    made = api.project(name=f"Stats {uuid.uuid4()}")
    alps = api.mission(made["id"], name="Alps", metadata_yaml="robot: anymal\nsite: {name: top}\n")["id"]
    lake = api.mission(made["id"], name="Lake", metadata_yaml="robot: spot\n")["id"]
    imu = {"message_type": "Imu"}
    parts = [
        sample.file(
            alps,
            f"run/{number}.db3",
            format="db3",
            size_bytes=100,
            start_ns=start,
            end_ns=start + HOUR_NS,
            message_count=30,
            topics=[{"name": "/imu", "count": 20, **imu}, {"name": "/imu2", "count": 10, **imu}],
        )
        for number, start in enumerate((JUNE - HOUR_NS, JUNE))
    ]
    sample.recording(alps, "run", parts, kind="rosbag2", start_ns=JUNE - HOUR_NS, end_ns=JUNE + HOUR_NS)
    single = sample.file(
        lake,
        "a.mcap",
        size_bytes=50,
        start_ns=JUNE,
        end_ns=JUNE + HOUR_NS,
        message_count=7,
        topics=[{"name": "/imu", "count": 7, **imu}],
    )
    sample.recording(lake, "a", [single], start_ns=JUNE, end_ns=JUNE + HOUR_NS)
    sample.file(lake, "readme.txt", size_bytes=1, format=None, content="opaque")
    gone = sample.file(lake, "gone.mcap", size_bytes=1000)
    api.delete(f"/files/{gone}").ok()
    return made


def _row(group: str | None, *numbers: int) -> dict[str, Any]:
    missions, files, recordings, size_bytes, hours, messages = numbers
    return {
        "group": group,
        "missions": missions,
        "files": files,
        "recordings": recordings,
        "size_bytes": size_bytes,
        "duration_ns": hours * HOUR_NS,
        "messages": messages,
    }


TOTAL = _row(None, 2, 4, 2, 251, 3, 67)


@pytest.mark.parametrize(
    ("by", "rows"),
    [
        (
            "month",
            [_row("2024-05", 1, 2, 1, 200, 2, 60), _row("2024-06", 1, 1, 1, 50, 1, 7), _row(None, 1, 1, 0, 1, 0, 0)],
        ),
        ("format", [_row("db3", 1, 2, 1, 200, 2, 60), _row("mcap", 1, 1, 1, 50, 1, 7), _row(None, 1, 1, 0, 1, 0, 0)]),
        ("metadata.robot", [_row("anymal", 1, 2, 1, 200, 2, 60), _row("spot", 1, 2, 1, 51, 1, 7)]),
        ("metadata.site.name", [_row("top", 1, 2, 1, 200, 2, 60), _row(None, 1, 2, 1, 51, 1, 7)]),
        (
            "topic",
            [_row("/imu", 2, 3, 2, 250, 3, 47), _row("/imu2", 1, 2, 1, 200, 2, 20), _row(None, 1, 1, 0, 1, 0, 0)],
        ),
        ("type", [_row("Imu", 2, 3, 2, 250, 3, 67), _row(None, 1, 1, 0, 1, 0, 0)]),
    ],
)
def test_groups(api: Api, project: Any, by: str, rows: list[dict[str, Any]]) -> None:
    api.get(f"/projects/{project['id']}").ok()  # so that an admin's look is noted already
    with api.statements() as statements:
        stats = api.get("/stats", {"project_id": project["id"], "by": by}).ok()
    assert (stats["by"], stats["rows"], stats["total"]) == (by, rows, TOTAL)
    # Who, room to count, groups, all (which groups that no mission shares add up to); whether a project has that field.
    assert len(statements) == 4


def test_by_project_and_mission(api: Api, project: Any) -> None:
    stats = api.get("/stats", {"project_id": project["id"]}).ok()
    assert (stats["by"], stats["rows"]) == ("project", [{**TOTAL, "group": project["name"]}])
    assert stats["total"] == TOTAL
    stats = api.get("/stats", {"project_id": project["id"], "by": "mission"}).ok()
    assert stats["total"] == TOTAL
    groups = [f"{project['name']}/{name}" for name in ("Alps", "Lake")]
    assert [row["group"] for row in stats["rows"]] == groups


def test_a_filter_narrows_what_is_counted(api: Api, project: Any) -> None:
    query = {"project_id": project["id"], "by": "topic", "topic": "/imu2"}
    stats = api.get("/stats", query).ok()
    assert stats["rows"] == [_row("/imu2", 1, 2, 1, 200, 2, 20)]
    assert stats["total"] == _row(None, 1, 2, 1, 200, 2, 20)
    query = {"project_id": project["id"], "by": "mission", "where": "robot=spot", "format": "mcap"}
    assert api.get("/stats", query).ok()["total"] == _row(None, 1, 1, 1, 50, 1, 7)


def test_more_groups_than_can_be_answered_are_refused(api: Api, project: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    query = {"project_id": project["id"], "by": "topic"}
    monkeypatch.setattr(statistics, "MAX_GROUPS", 3)
    assert len(api.get("/stats", query).ok()["rows"]) == 3
    monkeypatch.setattr(statistics, "MAX_GROUPS", 2)
    problem = api.get("/stats", query).refused(422, "invalid_query")
    assert (problem["expression"], "narrow the filter" in problem["detail"]) == ("topic", True)
    assert api.get("/stats", {**query, "topic": "/imu"}).ok()["total"]["files"] == 3


def test_statistics_of_an_empty_server_are_empty(api: Api) -> None:
    stats = api.get("/stats", {"project_id": str(uuid.uuid4())}).ok()
    assert (stats["rows"], stats["total"]) == ([], _row(None, 0, 0, 0, 0, 0, 0))


@pytest.mark.parametrize("by", ["colour", "", "metadata", "metadata.", "metadata..", "metadata.a..b", "project.x"])
def test_an_unknown_grouping_is_refused(api: Api, by: str) -> None:
    assert api.get("/stats", {"by": by}).refused(422, "invalid_query")["expression"] == by


def test_times_at_the_limits_of_the_range_are_accepted(api: Api, sample: Sample) -> None:
    mission = api.mission(api.project()["id"])["id"]
    sample.file(mission, "a.mcap", start_ns=-(2**63), end_ns=2**63 - 1)
    stats = api.get("/stats", {"mission_id": mission, "by": "month"}).ok()
    assert [row["group"] for row in stats["rows"]] == ["1677-09"]
