"""Recordings of several files: the server agrees with `klein inspect` on the same folder."""

import uuid
from typing import Any

import pytest
from ruamel.yaml import YAML
from sqlalchemy import event

from kleinkram.server.context import AppContext
from kleinkram.server.jobs.execution import BackPressure
from kleinkram.server.overviews import jobs as derivation_jobs
from kleinkram.server.overviews.jobs import DerivationDebounce
from kleinkram.server.recordings import derive as derivation
from kleinkram.server.recordings.derive import Derived
from tests.integration.api_server import Api
from tests.integration.jobs import drain, on_site, run_jobs
from tests.integration.sample import Sample
from tests.integration.upload_client import upload_all


@pytest.fixture(name="api", scope="module")
def _api(start_api: Any) -> Api:
    api: Api = start_api()
    return api


def test_deriving_takes_as_many_queries_for_many_recordings_as_for_one(api: Api, mission_id: str) -> None:
    sample = Sample(api)
    topic = {"name": "/imu", "message_type": "sensor_msgs/msg/Imu", "count": 5}
    counts: list[int] = []

    async def derive(context: AppContext) -> list[Derived]:
        seen: list[str] = []
        event.listen(context.database.engine.sync_engine, "before_cursor_execute", lambda *named: seen.append(named[2]))
        async with context.database.begin() as db:
            actual = await derivation.derive(db, await derivation.live_files(db, uuid.UUID(mission_id)), {})
        counts.append(len(seen))
        return actual

    for number in range(1, 4):
        for part in range(2):
            name = f"run{number}_{part}.mcap"
            sample.file(mission_id, name, topics=[topic], message_count=5, start_ns=part, end_ns=part + 1)
        actual = on_site(api, derive)
        assert [item.values["message_count"] for item in actual] == [10] * number
    assert counts == [2, 2, 2]


_BROKEN = b"\x89MCAP0\r\n"


def test_unchanged_recordings_are_not_written_again(api: Api, mission_id: str) -> None:
    upload_all(api, mission_id, {"a.mcap": _BROKEN + b"a", "b.mcap": _BROKEN + b"b"})
    run_jobs(api)
    written = "SELECT name, xmin::text FROM recording WHERE mission_id = %s ORDER BY name"
    linked = "SELECT path, xmin::text, recording_id FROM file WHERE mission_id = %s ORDER BY path"
    recordings, files = api.sql(written, mission_id), api.sql(linked, mission_id)
    upload_all(api, mission_id, {"c.mcap": _BROKEN + b"c"})
    run_jobs(api)
    assert api.sql(written, mission_id)[:2] == recordings
    assert api.sql(linked, mission_id)[:2] == files
    assert [row[0] for row in api.sql(written, mission_id)] == ["a.mcap", "b.mcap", "c.mcap"]
    assert None not in {row[2] for row in api.sql(linked, mission_id)}


def test_a_mission_whose_grouping_took_long_is_grouped_again_after_a_pause(api: Api, mission_id: str) -> None:
    """With ten thousand files it would be derived, and held, all the time that these are read."""
    upload_all(api, mission_id, {"a.mcap": _BROKEN + b"1"})
    run_jobs(api)
    upload_all(api, mission_id, {"b.mcap": _BROKEN + b"2"})
    rests = DerivationDebounce()
    rests.took(uuid.UUID(mission_id), 5.0)
    on_site(api, lambda context: _drain_courteously(context, rests))
    waiting = (
        "SELECT id, scheduled_at - now() > interval '15 s' FROM procrastinate_jobs"
        " WHERE status = 'todo' AND args ->> 'ref' = %s"
    )
    ((job_id, is_later),) = api.sql(waiting, mission_id)
    assert is_later
    assert len(api.all(f"/missions/{mission_id}/recordings")) == 1
    upload_all(api, mission_id, {"c.mcap": _BROKEN + b"3"})
    run_jobs(api)
    assert api.sql(waiting, mission_id) == [(job_id, True)], "what changed meanwhile asked for a round of its own"
    api.sql("UPDATE procrastinate_jobs SET scheduled_at = now() WHERE id = %s", job_id)
    run_jobs(api)
    assert len(api.all(f"/missions/{mission_id}/recordings")) == 3


async def _drain_courteously(context: AppContext, rests: DerivationDebounce) -> None:
    back_pressure = BackPressure(context.database)
    back_pressure.end()
    await drain(context, back_pressure, rests)


def test_the_pause_after_grouping_is_a_multiple_of_its_duration() -> None:
    rests, (quick, slow, other) = DerivationDebounce(), (uuid.uuid4() for _ in range(3))
    rests.took(quick, 0.05)
    rests.took(slow, 2.0)
    assert rests.left(quick).total_seconds() == 0
    assert 6 < rests.left(slow).total_seconds() <= 8
    rests.took(other, 2.0)
    assert 14 < rests.left(other).total_seconds() <= 16, "two at once take no more of the worker than one"
    rests.took(slow, 1000.0)
    assert rests.left(slow).total_seconds() <= 30
    rests.took(slow, 0.05)
    assert rests.left(slow).total_seconds() > 0, "who took long rests to the end"


def test_unread_metadata_is_reported(api: Api, mission_id: str) -> None:
    large = b"rosbag2_bagfile_information:\n  relative_file_paths: [run_0.mcap]\n" + b"#" * 300_000
    upload_all(api, mission_id, {"run/metadata.yaml": large, "run/run_0.mcap": b"\x89MCAP0\r\n" + large[:50]})
    run_jobs(api)
    (recording,) = api.all(f"/missions/{mission_id}/recordings")
    assert [problem["code"] for problem in recording["problems"]] == ["metadata-unread"]
    assert (recording["kind"], recording["content"]) == ("rosbag2", "broken")


_METADATA = b"""rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  relative_file_paths: [run_0.mcap]
"""


def _refuse(*_: object, **__: object) -> None:
    raise RuntimeError("YAML of a stranger, parsed beside the credentials")


def test_metadata_files_are_parsed_in_a_child_process_only(
    api: Api, mission_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    upload_all(api, mission_id, {"run/metadata.yaml": _METADATA, "run/run_1.mcap": b"\x89MCAP0\r\n"})
    monkeypatch.setattr(YAML, "load", _refuse)
    run_jobs(api)
    (recording,) = api.all(f"/missions/{mission_id}/recordings")
    assert (recording["missing"], recording["unlisted"]) == (["run_0.mcap"], ["run_1.mcap"])


def test_metadata_that_takes_too_long_to_read_is_reported(
    api: Api, mission_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(derivation_jobs, "_LIMIT_S", 0.001)
    upload_all(api, mission_id, {"run/metadata.yaml": _METADATA + b"# slow", "run/run_0.mcap": b"\x89MCAP0\r\n"})
    run_jobs(api)
    (recording,) = api.all(f"/missions/{mission_id}/recordings")
    assert [problem["code"] for problem in recording["problems"]] == ["metadata-unread"]
