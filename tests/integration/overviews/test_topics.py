"""The topics of all recordings of a mission: derived by the worker, or added up for people who see only a part."""

import datetime
import uuid
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from kleinkram import connect
from kleinkram.recordings.message_density import count_stamps, pack
from kleinkram.recordings.sample import generate_mcap
from kleinkram.server.context import AppContext
from kleinkram.server.recordings.derive import derive_forgotten
from tests.integration.api_server import Api
from tests.integration.jobs import on_site, run_jobs
from tests.integration.sample import Sample
from tests.integration.upload_client import upload_all

T0 = 1_700_000_000_000_000_000
S = 1_000_000_000


def _times(name: str, stamps: list[int], kind: str = "a/msg/B", **values: Any) -> dict[str, Any]:
    gap = max((b - a for a, b in pairwise(stamps)), default=None)
    span = {"first_ns": stamps[0], "last_ns": stamps[-1], "longest_gap_ns": gap, "stored_bytes": 10}
    density = pack(count_stamps(stamps))
    return {"name": name, "message_type": kind, "count": len(stamps), **span, "density": density, **values}


def _put(sample: Sample, mission_id: str, path: str, *topics: dict[str, Any]) -> str:
    known = [topic for topic in topics if topic["first_ns"] is not None]
    start_ns = min((topic["first_ns"] for topic in known), default=None)
    end_ns = max((topic["last_ns"] for topic in known), default=None)
    span: dict[str, Any] = {"start_ns": start_ns, "end_ns": end_ns}
    file_id = sample.file(mission_id, path, topics=[*topics], **span)
    sample.recording(mission_id, path, [file_id], **span)
    return file_id


def _span(api: Api, mission_id: str, start_ns: int, end_ns: int) -> None:
    api.sql("UPDATE mission SET start_ns = %s, end_ns = %s WHERE id = %s", start_ns, end_ns, mission_id)


def _by_key(result: Any) -> dict[tuple[str, str], Any]:
    return {(item["name"], item["message_type"]): item for item in result["items"]}


def test_topics_of_several_recordings_are_one(api: Api, sample: Sample, mission_id: str) -> None:
    first = [T0 + number * S // 10 for number in range(1000)]
    later = [T0 + 500 * S + number * S // 10 for number in range(500)]
    _put(sample, mission_id, "b.mcap", _times("/imu", first), _times("/odd", first[:10]))
    _put(sample, mission_id, "a.mcap", _times("/imu", later), _times("/odd", later[:5], "c/msg/D"))
    silent = {"name": "/imu", "message_type": "a/msg/B", "count": 0, "first_ns": None, "last_ns": None}
    _put(sample, mission_id, "c.mcap", {**silent, "stored_bytes": 0})
    _span(api, mission_id, first[0], later[-1])
    result = api.get(f"/missions/{mission_id}/topics").ok()
    assert [item["name"] for item in result["recordings"]] == ["b.mcap", "a.mcap", "c.mcap"]
    assert result["is_current"]
    topics = _by_key(result)
    assert topics.keys() == {("/imu", "a/msg/B"), ("/odd", "a/msg/B"), ("/odd", "c/msg/D")}
    imu = topics["/imu", "a/msg/B"]
    assert (imu["count"], imu["file_count"], imu["recording_count"]) == (1500, 3, 2)
    assert (imu["recordings"], imu["other_types"]) == ([[0, 1]], [])
    assert (imu["first_ns"], imu["last_ns"], imu["longest_gap_ns"]) == (first[0], later[-1], S // 10)
    assert imu["rate_hz"] == pytest.approx(10)
    axis = result["axis"]
    assert 128 <= axis["bins"] <= 256
    counted = Counter((stamp - axis["start_ns"]) // axis["bin_ns"] for stamp in [*first, *later])
    assert imu["counts"] == [counted[number] for number in range(axis["bins"])]
    assert topics["/odd", "a/msg/B"]["other_types"] == ["c/msg/D"]
    assert topics["/odd", "c/msg/D"]["recordings"] == [[1, 1]]


def test_the_worker_derives_the_same_topics(api: Api, sample: Sample, mission_id: str) -> None:
    stamps = [T0 + number * S for number in range(300)]
    for number in range(3):
        shifted = [stamp + number * 400 * S for stamp in stamps]
        _put(sample, mission_id, f"{number}.mcap", _times("/imu", shifted), _times(f"/only{number}", shifted[:7]))
    _put(sample, mission_id, "3.mcap", _times("/imu", stamps, "other/msg/T"))
    file_id = _put(sample, mission_id, "gone.mcap", _times("/gone", stamps))
    _span(api, mission_id, T0, T0 + 1099 * S)
    api.delete(f"/files/{file_id}").ok()  # whatever changes files has recordings and topics derived
    path = f"/missions/{mission_id}/topics"
    added_up = api.get(path).ok()
    run_jobs(api)
    stored = api.get(path).ok()
    assert api.sql("SELECT count(*) FROM mission_topic WHERE mission_id = %s", mission_id) == [(5,)]
    # The recording of the deleted file was still there.
    assert [{**item, "recordings": None} for item in added_up["items"]] == [
        {**item, "recordings": None} for item in stored["items"]
    ]
    assert _by_key(stored)["/imu", "a/msg/B"]["recordings"] == [[0, 0], [2, 3]]
    assert (stored["axis"], stored["is_current"], stored["next"]) == (added_up["axis"], True, None)
    assert [item["name"] for item in stored["recordings"]] == ["0.mcap", "3.mcap", "1.mcap", "2.mcap"]
    assert {item["name"] for item in stored["items"]} == {"/imu", "/only0", "/only1", "/only2"}
    assert _by_key(stored)["/imu", "other/msg/T"]["other_types"] == ["a/msg/B"]
    pages = [api.get(path, {"limit": "2"}).ok()]
    while pages[-1]["next"]:
        pages.append(api.get(path, {"limit": "2", "cursor": pages[-1]["next"]}).ok())
    assert [item for page in pages for item in page["items"]] == stored["items"]
    with connect(api.url, api.token) as client:
        assert client.missions.topics(uuid.UUID(mission_id)).model_dump(mode="json") == stored
    api.sql("UPDATE mission SET files_revision = files_revision + 1 WHERE id = %s", mission_id)
    assert api.get(path).ok()["is_current"] is False


def test_fewer_bins_are_sums(api: Api, sample: Sample, mission_id: str) -> None:
    stamps = [T0 + number * S // 7 for number in range(5000)]
    _put(sample, mission_id, "a.mcap", _times("/imu", stamps))
    _span(api, mission_id, stamps[0], stamps[-1])
    path = f"/missions/{mission_id}/topics"
    for bins in (1, 2, 40, 512):
        result = api.get(path, {"bins": str(bins)}).ok()
        assert result["axis"]["bins"] == len(result["items"][0]["counts"]) <= bins
        assert sum(result["items"][0]["counts"]) == 5000
    bare = api.get(path, {"bins": "0"}).ok()
    assert (bare["axis"], bare["items"][0]["counts"]) == (None, None)
    api.get(path, {"bins": "513"}).refused(422, "invalid_request")
    api.get(path, {"cursor": "x"}).ok()  # nothing is kept yet, so there is one page only


def test_unknown_values_are_null_and_unset_clocks_do_not_widen_the_span(
    api: Api, sample: Sample, mission_id: str
) -> None:
    stamps = [T0 + number * S for number in range(100)]
    _put(sample, mission_id, "old.mcap", _times("/old", stamps, density=None), _times("/both", stamps, density=None))
    _put(sample, mission_id, "new.mcap", _times("/both", [stamp + 200 * S for stamp in stamps]))
    _put(sample, mission_id, "1970.mcap", _times("/both", [5, 6, 7]))
    _span(api, mission_id, T0, T0 + 299 * S)
    result = api.get(f"/missions/{mission_id}/topics").ok()
    topics = _by_key(result)
    assert topics["/old", "a/msg/B"]["counts"] is None
    both = topics["/both", "a/msg/B"]
    assert (both["count"], sum(both["counts"]), both["first_ns"]) == (203, 100, T0)
    assert both["recordings"] == [[0, 2]]
    assert result["axis"]["start_ns"] > T0 - 10 * S


def test_a_mission_without_anything_has_no_topics(api: Api, mission_id: str) -> None:
    result = api.get(f"/missions/{mission_id}/topics").ok()
    assert (result["items"], result["axis"], result["recordings"]) == ([], None, [])
    api.get(f"/missions/{uuid.uuid4()}/topics").refused(404, "not_found")


def test_a_link_to_some_files_shows_topics_of_these(api: Api, sample: Sample, mission_id: str) -> None:
    stamps = [T0 + number * S for number in range(10)]
    shown = _put(sample, mission_id, "a.mcap", _times("/imu", stamps), _times("/a", stamps))
    _put(sample, mission_id, "b.mcap", _times("/imu", stamps), _times("/b", stamps))
    _span(api, mission_id, stamps[0], stamps[-1])
    until = (datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(hours=1)).isoformat()
    expected = {"name": "one", "expires_at": until, "file_ids": [shown]}
    link = api.post(f"/missions/{mission_id}/shares", expected).ok(201)
    result = api.as_(link["secret"]).get(f"/missions/{mission_id}/topics").ok()
    assert {(item["name"], item["count"]) for item in result["items"]} == {("/imu", 10), ("/a", 10)}
    assert [item["name"] for item in result["recordings"]] == ["a.mcap"]


def test_topics_of_a_file_have_a_message_density(api: Api, sample: Sample, mission_id: str) -> None:
    stamps = [T0 + number * S for number in range(1000)]
    file_id = _put(sample, mission_id, "a.mcap", _times("/imu", stamps), _times("/old", stamps, density=None))
    imu, old = api.all(f"/files/{file_id}/topics")
    known = count_stamps(stamps)
    assert imu["density"] == {"start_ns": known.start_ns, "bin_ns": known.bin_ns, "counts": [*known.counts]}
    assert old["density"] is None
    assert api.all("/topics", {"mission_id": mission_id})[0]["density"] is None


def test_a_recording_that_is_uploaded_gets_its_density(api: Api, mission_id: str, tmp_path: Path) -> None:
    generate_mcap(tmp_path / "a.mcap", size_bytes=1_000_000, seed=1)
    upload_all(api, mission_id, {"a.mcap": (tmp_path / "a.mcap").read_bytes()})
    run_jobs(api)
    result = api.get(f"/missions/{mission_id}/topics").ok()
    assert result["is_current"]
    assert all(sum(item["counts"]) == item["count"] > 0 for item in result["items"])
    assert len(result["items"]) > 1


def test_missing_topics_of_a_mission_are_derived_later(api: Api, sample: Sample, mission_id: str) -> None:
    _put(sample, mission_id, "a.mcap", _times("/imu", [T0, T0 + S]))
    api.sql("UPDATE mission SET files_revision = 1, derived_revision = 1 WHERE id = %s", mission_id)

    async def look_after(context: AppContext) -> None:
        async with context.database.begin() as db:
            await derive_forgotten(db, limit=1000)

    on_site(api, look_after)
    run_jobs(api)
    assert api.sql("SELECT revision FROM mission_topics WHERE mission_id = %s", mission_id) == [(1,)]
