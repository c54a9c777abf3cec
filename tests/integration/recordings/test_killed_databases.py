"""rosbag2 databases of killed recorders, uploaded with the SQLite log beside them."""

from pathlib import Path

import pytest

from kleinkram.client import connect
from kleinkram.recordings.inspect import inspect_paths
from tests.conftest import MakeCase
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import run_jobs
from tests.integration.upload_client import upload_all


def _files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("bag_0.*")}


def _state(api: Api, mission_id: str) -> tuple[str, int | None, list[str]]:
    """What the server says of the recording: content, messages, and the problems of its file."""
    (recording,) = api.all(f"/missions/{mission_id}/recordings")
    file = next(item for item in api.all("/files", {"mission_id": mission_id}) if item["path"].endswith(".db3"))
    problems = api.get(f"/files/{file['id']}").ok()["problems"]
    return recording["content"], recording["message_count"], [item["code"] for item in problems]


def _codes_here(folder: Path) -> tuple[str, int | None, list[str]]:
    (actual,) = inspect_paths([folder])
    summary = actual.summary
    return summary.content.value, summary.message_count, [item.code for item in summary.problems]


@pytest.mark.parametrize(("case", "messages"), [("02A", 20), ("03A", 25)])
def test_messages_in_the_log_are_read_as_they_are_here(
    api: Api, mission_id: str, make_case: MakeCase, case: str, messages: int
) -> None:
    folder = make_case(case)
    upload_all(api, mission_id, _files(folder))
    run_jobs(api)
    assert _state(api, mission_id) == ("recovered", messages, ["wal-not-merged"]) == _codes_here(folder)


@pytest.mark.parametrize("first", ["-wal", ".db3"])
def test_a_database_and_its_journal_may_arrive_in_any_order(
    start_api: StartApi, make_case: MakeCase, first: str
) -> None:
    api = start_api()
    mission_id = str(api.mission(api.project()["id"])["id"])
    bodies = _files(make_case("03A")) | {"bag/bag_0.db3-journal": b""}
    for path in sorted(bodies, key=lambda path: not path.endswith(first)):
        upload_all(api, mission_id, {path: bodies[path]})
        run_jobs(api)
    assert _state(api, mission_id) == ("recovered", 25, ["wal-not-merged"])
    (recording,) = api.all(f"/missions/{mission_id}/recordings")
    with connect(api.url, api.token) as client, client.recordings.open(recording["id"]) as opened:
        assert sum(1 for _ in opened.raw_messages()) == 25
        assert [item.code for item in opened.problems] == ["wal-not-merged"]


def test_a_log_beside_a_copy_in_another_mission_does_not_change_the_first(
    start_api: StartApi, make_case: MakeCase
) -> None:
    """Both missions hold one blob; whoever may read the first must not be able to change what others see of it."""
    api = start_api()
    first, other = (str(api.mission(api.project()["id"])["id"]) for _ in range(2))
    bodies = _files(make_case("03A"))
    upload_all(api, first, {path: body for path, body in bodies.items() if path.endswith(".db3")})
    run_jobs(api)
    before = _state(api, first)
    assert before[2] == []
    for path in sorted(bodies):
        upload_all(api, other, {path: bodies[path]})
    run_jobs(api)
    assert _state(api, first) == before
