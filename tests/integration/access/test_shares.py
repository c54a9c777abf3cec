"""Shares: what a link shows and what it hides, and how it ends."""

import datetime
import re
import uuid
from dataclasses import dataclass
from typing import Any

import pytest
import urllib3

from kleinkram import connect
from kleinkram.contract.access import Right, Scope
from kleinkram.contract.errors import NotFound
from kleinkram.contract.token_format import has_valid_checksum
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.sample import Sample

_HOUR_NS = 3_600_000_000_000


def _in(**span: float) -> str:
    return (datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(**span)).isoformat()


def _link(api: Api, mission_id: str, **expected: Any) -> Any:
    body = {"name": "for a partner", "expires_at": _in(days=1), **expected}
    return api.post(f"/missions/{mission_id}/shares", body).ok(201)


@dataclass(frozen=True)
class Outing:
    """A mission with two files of one recording and a file of another, and a second project."""

    project: Any
    mission: Any
    first: str
    second: str
    other: str
    split: str
    alone: str


@pytest.fixture
def outing(api: Api, sample: Sample) -> Outing:
    """Two files of a split recording, and a single recording that is much longer."""
    project = api.project(description="the secret of the project")
    mission = api.mission(project["id"], notes="the secret of the mission", metadata_yaml="robot: anymal\n")
    topic = {"name": "/imu", "message_type": "sensor_msgs/Imu", "count": 5}
    first, second = (
        sample.file(
            mission["id"],
            f"split_{number}.mcap",
            topics=[topic],
            start_ns=number * _HOUR_NS,
            end_ns=(number + 1) * _HOUR_NS,
            message_count=5,
        )
        for number in range(2)
    )
    other = sample.file(
        mission["id"],
        "other.mcap",
        topics=[{**topic, "name": "/hidden"}],
        start_ns=5 * _HOUR_NS,
        end_ns=90 * _HOUR_NS,
        message_count=7,
        size_bytes=999,
    )
    split = sample.recording(mission["id"], "split", [first, second], start_ns=0, end_ns=2 * _HOUR_NS)
    alone = sample.recording(mission["id"], "other", [other], start_ns=5 * _HOUR_NS, end_ns=90 * _HOUR_NS)
    api.sql("UPDATE mission SET start_ns = 0, end_ns = %s WHERE id = %s", 90 * _HOUR_NS, mission["id"])
    return Outing(project, mission, first, second, other, split, alone)


def test_a_share_of_a_mission_shows_all_of_it_and_nothing_else(api: Api, outing: Outing) -> None:
    api.mission(outing.project["id"])
    made = _link(api, outing.mission["id"])
    assert has_valid_checksum(made["secret"])
    assert made["url"].endswith(f"/s#{made['secret']}")
    guest = api.as_(made["secret"])
    shown = guest.get("/share").ok()
    assert (shown["mission"]["name"], shown["file_count"], shown["size_bytes"]) == (outing.mission["name"], 3, 1199)
    (mission,) = guest.all("/missions")
    assert (mission["metadata"], mission["notes"]) == ({"robot": "anymal"}, "the secret of the mission")
    assert {item["id"] for item in guest.all("/files")} == {outing.first, outing.second, outing.other}
    assert {item["id"] for item in guest.all(f"/missions/{mission['id']}/recordings")} == {outing.split, outing.alone}
    assert guest.all("/projects") == []
    guest.get(f"/projects/{outing.project['id']}").refused(404, "not_found")


def test_a_share_of_one_split_file_reveals_nothing_of_the_others(api: Api, outing: Outing) -> None:
    guest = api.as_(_link(api, outing.mission["id"], file_ids=[outing.first, outing.first])["secret"])
    assert {key: guest.get("/share").ok()[key] for key in ("file_count", "size_bytes", "is_whole_mission")} == {
        "file_count": 1,
        "size_bytes": 100,
        "is_whole_mission": False,
    }
    (mission,) = guest.all("/missions")
    numbers = ("file_count", "size_bytes", "message_count", "start_ns", "end_ns")
    assert [mission[name] for name in numbers] == [1, 100, 5, 0, _HOUR_NS]
    assert "secret" not in str(mission)
    assert mission["metadata"] == {}
    assert guest.get(f"/missions/{mission['id']}").ok() == mission

    assert [item["id"] for item in guest.all("/files")] == [outing.first]
    assert guest.get("/files", {"count": "true"}).ok()["total"] == 1
    guest.get(f"/files/{outing.other}").refused(404, "not_found")
    guest.post("/files/download", {"file_ids": [outing.first, outing.other]}).refused(404, "not_found")
    assert [item["name"] for item in guest.all("/topics")] == ["/imu"]
    assert guest.all("/missions", {"topic": "/hidden"}) == []
    assert guest.all("/missions", {"recorded_after": "1970-01-02T00:00:00Z"}) == []
    assert len(guest.all("/missions", {"topic": "/imu"})) == 1

    assert guest.all(f"/missions/{mission['id']}/recordings") == [], "half a recording is none to them"
    for recording in (outing.split, outing.alone):
        guest.get(f"/recordings/{recording}").refused(404, "not_found")
    total = guest.get("/stats", {"by": "month"}).ok()["total"]
    assert [total[name] for name in ("missions", "files", "recordings", "duration_ns")] == [1, 1, 0, 0]


def test_a_share_of_all_split_files_shows_their_recording(api: Api, outing: Outing) -> None:
    guest = api.as_(_link(api, outing.mission["id"], file_ids=[outing.first, outing.second])["secret"])
    assert [item["id"] for item in guest.all(f"/missions/{outing.mission['id']}/recordings")] == [outing.split]
    total = guest.get("/stats", {"by": "project"}).ok()["total"]
    assert [total[name] for name in ("files", "recordings", "duration_ns")] == [2, 1, 2 * _HOUR_NS]


@pytest.mark.parametrize(
    ("path", "query"),
    [
        ("/missions", {"where": "robot=anymal"}),
        ("/missions", {"satisfied": "true"}),
        ("/files", {"where": "robot=anymal"}),
        ("/stats", {"by": "metadata.robot"}),
    ],
)
def test_a_share_of_files_gives_no_access_to_anything_else(
    api: Api, outing: Outing, path: str, query: dict[str, str]
) -> None:
    guest = api.as_(_link(api, outing.mission["id"], file_ids=[outing.first])["secret"])
    guest.get(path, query).refused(422, "invalid_query")
    for nowhere in ("/missions", "/files"):
        assert guest.all(nowhere, {"text": "secret"}) == []
        assert guest.all(nowhere, {"text": "anymal"}) == []


def test_the_sdk_accepts_the_url_of_a_share(api: Api, outing: Outing) -> None:
    mission_id = uuid.UUID(outing.mission["id"])
    with connect(api.url, api.token) as client:
        ends = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=1)
        made = client.shares.create(mission_id, "for Bob", file_ids=[uuid.UUID(outing.first)], expires_at=ends)
        assert made.secret not in repr(made)
    with connect(f"{api.url}/s#{made.secret}") as guest:
        assert guest.shares.shown().file_count == 1
        assert [str(file.id) for file in guest.files.list()] == [outing.first]
        with pytest.raises(NotFound):
            guest.files.get(outing.other)
    with connect(api.url, api.token) as client:
        assert [client.shares.get(ref).id for ref in (made.url, made.secret, made.share.prefix)] == [made.share.id] * 3
        client.shares.revoke(made.share.id)
        assert [item.id for item in client.shares.list(mission_id=mission_id, ended=True)] == [made.share.id]


def test_a_share_only_allows_reading(api: Api, outing: Outing) -> None:
    guest = api.as_(_link(api, outing.mission["id"])["secret"])
    mission_id = outing.mission["id"]
    guest.patch(f"/missions/{mission_id}", {"notes": "x"}).refused(403, "scope_missing")
    guest.delete(f"/files/{outing.first}").refused(403, "scope_missing")
    guest.post(f"/missions/{mission_id}/uploads", {"files": [{"path": "a", "size_bytes": 1}]}).refused(
        403, "scope_missing"
    )
    guest.post(f"/missions/{mission_id}/shares", {"name": "x", "expires_at": _in(hours=1)}).refused(
        403, "scope_missing"
    )
    for path in ("/shares", "/tokens", "/audit", "/trash"):
        guest.get(path).refused(403, "scope_missing")


def test_downloads_with_a_share_are_counted_and_audited(api: Api, outing: Outing) -> None:
    made = _link(api, outing.mission["id"])
    guest = api.as_(made["secret"])
    guest.post("/files/download", {"file_ids": [outing.first, outing.other]}).ok()
    guest.post("/files/download", {"file_ids": [outing.first]}).ok()
    (listed,) = api.all("/shares", {"mission_id": outing.mission["id"]})
    assert (listed["download_count"], listed["download_bytes"]) == (3, 100 + 999 + 100)
    assert listed["last_used_at"] is not None
    assert made["secret"] not in str(listed)
    fetched = [event for event in api.events(outing.other) if event["operation"] == "file.download"]
    remaining = api.sql("SELECT share_id::text, address FROM audit_event WHERE id = %s", fetched[0]["id"])
    assert remaining == [(made["share"]["id"], "127.0.0.1")]


def test_a_share_ends_when_revoked_expired_or_its_mission_is_deleted(api: Api, outing: Outing) -> None:
    mission_id = outing.mission["id"]
    revoked, expired, rests = (_link(api, mission_id) for _ in range(3))
    guests = [api.as_(item["secret"]) for item in (revoked, expired, rests)]
    for guest in guests:
        guest.get("/share").ok()
    api.delete(f"/shares/{revoked['share']['id']}").ok(204)
    api.delete(f"/shares/{revoked['share']['id']}").ok(204)
    api.sql("UPDATE share SET expires_at = now() - interval '1 s' WHERE id = %s", expired["share"]["id"])
    for guest in guests[:2]:
        guest.get("/share").refused(401, "not_authenticated")
        guest.get("/files").refused(401, "not_authenticated")
    assert [item["id"] for item in api.all("/shares", {"mission_id": mission_id})] == [rests["share"]["id"]]
    ended = api.all("/shares", {"mission_id": mission_id, "ended": "true"})
    assert {item["id"] for item in ended} == {item["share"]["id"] for item in (revoked, expired, rests)}
    assert [event["operation"] for event in api.events(revoked["share"]["id"])] == ["share.revoke", "share.create"]

    api.delete(f"/missions/{mission_id}").ok()
    guests[2].get("/share").refused(401, "not_authenticated")
    api.post(f"/trash/mission/{mission_id}/restore").ok(204)
    guests[2].get("/share").ok()
    api.delete(f"/projects/{outing.project['id']}").ok()
    guests[2].get("/files").refused(401, "not_authenticated")


def test_a_share_ends_when_its_creator_loses_access(api: Api, outing: Outing) -> None:
    ada = people.person(api)
    people.grant(api, ada, Right.write, mission_id=outing.mission["id"])
    guest = api.as_(_link(api.as_(ada.token), outing.mission["id"])["secret"])
    guest.get("/share").ok()
    people.deactivate(api, ada)
    guest.get("/share").refused(401, "not_authenticated")


def test_creating_a_share_requires_write_and_the_scope_admin(api: Api, outing: Outing) -> None:
    ada = people.person(api)
    path, body = f"/missions/{outing.mission['id']}/shares", {"name": "x", "expires_at": _in(days=1)}
    hers = api.as_(ada.token)
    hers.post(path, body).refused(404, "not_found")
    people.grant(api, ada, Right.create, mission_id=outing.mission["id"])
    hers.post(path, body).refused(403, "forbidden")
    people.grant(api, ada, Right.write, mission_id=outing.mission["id"])
    hers.post(path, body).ok(201)
    api.as_(people.token(api, ada, [Scope.write]).secret).post(path, body).refused(403, "scope_missing")


@pytest.mark.parametrize(
    "expires", [{}, {"expires_at": None}, {"expires_at": _in(days=-1)}, {"expires_at": _in(days=91)}]
)
def test_a_share_must_expire_within_the_maximum_lifetime(api: Api, outing: Outing, expires: dict[str, Any]) -> None:
    body = {"name": "x", **expires}
    refused = api.post(f"/missions/{outing.mission['id']}/shares", body).refused(422, "invalid_request")
    assert "expires_at" in refused["detail"]


def test_a_share_contains_only_files_of_its_mission(api: Api, sample: Sample, outing: Outing) -> None:
    elsewhere = sample.file(api.mission(outing.project["id"])["id"], "a.mcap")
    body = {"name": "x", "expires_at": _in(days=1), "file_ids": [outing.first, elsewhere]}
    api.post(f"/missions/{outing.mission['id']}/shares", body).refused(404, "not_found")


def test_its_creator_and_writers_can_revoke_a_share(api: Api, outing: Outing) -> None:
    mission_id = outing.mission["id"]
    ada, bob = people.person(api), people.person(api)
    people.grant(api, ada, Right.write, mission_id=mission_id)
    hers = api.as_(ada.token)
    first, second = (_link(hers, mission_id)["share"]["id"] for _ in range(2))
    bobs = api.as_(bob.token)
    bobs.delete(f"/shares/{first}").refused(404, "not_found")
    people.grant(api, bob, Right.read, mission_id=mission_id)
    bobs.delete(f"/shares/{first}").refused(403, "forbidden")
    assert bobs.all("/shares") == []
    people.grant(api, bob, Right.write, mission_id=mission_id)
    assert {item["id"] for item in bobs.all("/shares")} == {first, second}
    bobs.delete(f"/shares/{first}").ok(204)
    api.sql("DELETE FROM access_grant WHERE group_id = %s", ada.group_id)
    assert [item["id"] for item in hers.all("/shares")] == [second], "what one made, one finds again"
    hers.delete(f"/shares/{second}").ok(204)


def test_the_viewer_of_a_share_of_files_reads_nothing_of_the_others(api: Api, outing: Outing) -> None:
    mission_id, project_id = outing.mission["id"], outing.project["id"]
    event = {"name": "stumble", "start_ns": 1, "file_id": outing.first, "note": "the secret of the event"}
    event_id = api.post(f"/missions/{mission_id}/events", event).ok(201)["id"]
    guest = api.as_(_link(api, mission_id, file_ids=[outing.first])["secret"])
    files = guest.all("/files", {"mission_id": mission_id, "format": "mcap", "content": "indexed"})
    assert [file["id"] for file in files] == [outing.first]
    topics = guest.get(f"/missions/{mission_id}/topics", {"bins": "192"}).ok()
    assert [topic["name"] for topic in topics["items"]] == ["/imu"]
    assert topics["recordings"] == [], "half a recording is none to them"
    assert topics["is_current"], "the viewer does not wait for more"
    assert [topic["name"] for topic in guest.all(f"/files/{outing.first}/topics")] == ["/imu"]
    assert guest.get(f"/files/{outing.first}/preview").ok()["state"] == "none"
    for hidden in (outing.second, outing.other):
        for part in ("", "/topics", "/preview", "/slice.mcap"):
            guest.get(f"/files/{hidden}{part}").refused(404, "not_found")
        guest.post("/files/download", {"file_ids": [hidden], "purpose": "preview"}).refused(404, "not_found")
    assert guest.all("/mission-events", {"mission_id": mission_id}) == []
    guest.get(f"/mission-events/{event_id}").refused(404, "not_found")
    guest.get(f"/projects/{project_id}/viewer-layouts").refused(404, "not_found")


def test_the_viewer_of_a_share_of_a_mission_shows_events_without_people_and_changes_nothing(
    api: Api, outing: Outing
) -> None:
    mission_id, project_id = outing.mission["id"], outing.project["id"]
    event_id = api.post(f"/missions/{mission_id}/events", {"name": "stumble", "start_ns": 1}).ok(201)["id"]
    layout = {"name": "mine", "panels": ["plot:1@/imu"]}
    api.post(f"/projects/{project_id}/viewer-layouts", layout).ok(201)
    guest = api.as_(_link(api, mission_id)["secret"])
    (event,) = guest.all("/mission-events", {"mission_id": mission_id})
    assert (event["id"], event["created_by"]) == (event_id, None)
    guest.get(f"/projects/{project_id}/viewer-layouts").refused(404, "not_found")
    for refused in (
        guest.post(f"/missions/{mission_id}/events", {"name": "x", "start_ns": 1}),
        guest.patch(f"/mission-events/{event_id}", {"name": "x"}),
        guest.delete(f"/mission-events/{event_id}"),
        guest.post(f"/projects/{project_id}/viewer-layouts", layout),
        guest.post(f"/files/{outing.first}/preview"),
        guest.delete(f"/files/{outing.first}/preview"),
        guest.get("/me"),
    ):
        refused.refused(403, "scope_missing")


def test_an_ended_share_opens_no_viewer(api: Api, outing: Outing) -> None:
    mission_id = outing.mission["id"]
    revoked, expired = (_link(api, mission_id, file_ids=[outing.first]) for _ in range(2))
    api.delete(f"/shares/{revoked['share']['id']}").ok(204)
    api.sql("UPDATE share SET expires_at = now() - interval '1 s' WHERE id = %s", expired["share"]["id"])
    of_file = (f"/files/{outing.first}{part}" for part in ("", "/topics", "/preview", "/slice.mcap"))
    of_mission = (f"/missions/{mission_id}{part}" for part in ("", "/topics", "/recordings"))
    paths = ["/share", "/files", "/mission-events", *of_file, *of_mission]
    for ended in (revoked, expired):
        guest = api.as_(ended["secret"])
        for path in paths:
            guest.get(path).refused(401, "not_authenticated")
        guest.post("/files/download", {"file_ids": [outing.first], "purpose": "preview"}).refused(
            401, "not_authenticated"
        )


def test_the_viewer_of_shares_may_load_only_what_it_needs(api: Api) -> None:
    page = urllib3.PoolManager(retries=False).request("GET", f"{api.url}/s/view")
    assert page.status == 200
    directives = dict(part.strip().split(" ", 1) for part in page.headers["Content-Security-Policy"].split(";"))
    assert directives == {
        "default-src": "'none'",
        "script-src": "'self' 'wasm-unsafe-eval'",
        "style-src": "'self'",
        "font-src": "'self'",
        "img-src": "'self' blob:",
        "connect-src": f"'self' {api.app.state.settings.store_origin}",
        "worker-src": "'self'",
        "form-action": "'none'",
        "base-uri": "'none'",
        "frame-ancestors": "'none'",
    }


def test_the_share_page_is_static_and_loads_only_our_scripts(api: Api) -> None:
    pool = urllib3.PoolManager(retries=False)
    page = pool.request("GET", f"{api.url}/s")
    assert page.status == 200
    assert "default-src 'none'; script-src 'self'" in page.headers["Content-Security-Policy"]
    sources = re.findall(r'(?:src|href)="([^"]+)"', page.data.decode())
    assert {"/s/static/share.css", "/s/static/share.js"} <= set(sources)
    for source in sources:
        assert source.startswith("/"), "nothing from elsewhere"
        static = pool.request("GET", api.url + source)
        assert (static.status, len(static.data) > 100) == (200, True)
        assert static.headers["X-Content-Type-Options"] == "nosniff"
    assert pool.request("GET", f"{api.url}/s/static/page.py").status == 404


def test_the_share_endpoint_requires_a_share(api: Api) -> None:
    api.get("/share").refused(404, "not_found")
    api.as_(None).get("/share").refused(404, "not_found")
