"""Events of missions through HTTP: who may do what, what is refused, and what is recorded."""

import json
import uuid
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from kleinkram.contract.access import Right, Scope
from kleinkram.contract.mission_events import MAX_MISSION_EVENTS
from kleinkram.server.access.builtin_groups import OWNER_ID
from kleinkram.server.filters import plan as search_plan
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.event_client import listening
from tests.integration.sample import Sample

_S = 10**9
_AT_NS = 1_780_000_000 * _S


@pytest.fixture(name="mission_id")
def _mission_id(api: Api) -> str:
    return str(api.mission(api.project()["id"])["id"])


def _add(api: Api, mission_id: str, **fields: Any) -> Any:
    return api.post(f"/missions/{mission_id}/events", {"name": "stumble", "start_ns": _AT_NS, **fields}).ok(201)


def _finding(api: Api, mission_id: str) -> tuple[str, int]:
    """Insert a run of a mission with a file, and a finding of it; returns their ids."""
    Sample(api).file(mission_id, "one.mcap")
    body = {"mission_ids": [mission_id], "definition": {"name": "gait", "script": "print(1)"}, "force": True}
    run_id = str(api.post("/runs", body).ok()["items"][0]["run"]["id"])
    ((finding_id,),) = api.sql(
        "INSERT INTO run_finding (run_id, severity, code, message, time_ns) VALUES (%s, 'error', 'gait.slip', 'x', %s)"
        " RETURNING id",
        *(run_id, _AT_NS),
    )
    return run_id, finding_id


def test_a_span_with_all_fields_is_added_and_read_back(api: Api, mission_id: str) -> None:
    file_id = Sample(api).file(mission_id, "one.mcap")
    fields = {"labels": ["night", "slope"], "colour": "#ff8800", "note": "Left leg.", "topic": "/imu"}
    made = _add(api, mission_id, end_ns=_AT_NS + 3 * _S, file_id=file_id, **fields)
    assert {name: made[name] for name in fields} == fields
    assert (made["start_ns"], made["end_ns"]) == (_AT_NS, _AT_NS + 3 * _S)
    assert (made["file"], made["recording"]) == ({"id": file_id, "path": "one.mcap"}, None)
    assert (made["mission"]["id"], made["created_by"]["id"], made["run_id"]) == (mission_id, str(OWNER_ID), None)
    assert api.get(f"/mission-events/{made['id']}").ok() == made
    assert api.all("/mission-events", {"mission_id": mission_id}) == [made]


def test_adding_takes_a_bounded_number_of_statements_and_writes_one_audit_event(api: Api, mission_id: str) -> None:
    before = len(api.events(mission_id))
    with api.statements() as statements:
        made = _add(api, mission_id)
    assert len(statements) <= 10  # who, lock project, lock mission, right, count, insert, read, audit, tell
    entries = api.events(mission_id)
    assert len(entries) == before + 1
    assert (entries[0]["operation"], entries[0]["after"]["event"]) == ("mission.create_event", made["name"])
    assert entries[0]["after"]["start_ns"] == _AT_NS


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"name": ""}, "body.name"),
        ({"name": "a/b"}, "body.name"),
        ({"name": "x" * 129}, "body.name"),
        ({"start_ns": -1}, "body.start_ns"),
        ({"start_ns": 2**63}, "body.start_ns"),
        ({"end_ns": _AT_NS - 1}, "end_ns"),
        ({"colour": "red"}, "body.colour"),
        ({"labels": ["a,b"]}, "body.labels.0"),
        ({"labels": [f"label {number}" for number in range(21)]}, "body.labels"),
        ({"note": "x" * 10_001}, "body.note"),
        ({"note": "a\x00b"}, "body.note"),
        ({"topic": ""}, "body.topic"),
        ({"file_id": str(uuid.uuid4())}, "file_id"),
        ({"recording_id": str(uuid.uuid4())}, "recording_id"),
        ({"finding_id": 2**62}, "finding_id"),
        ({"file_id": str(uuid.uuid4()), "recording_id": str(uuid.uuid4())}, "body"),
    ],
)
def test_what_is_wrong_is_refused_with_the_field(
    api: Api, mission_id: str, fields: dict[str, object], field: str
) -> None:
    body = {"name": "stumble", "start_ns": _AT_NS, **fields}
    problem = api.post(f"/missions/{mission_id}/events", body).refused(422, "invalid_request")
    assert [one["field"] for one in problem["problems"]] == [field]
    assert api.all("/mission-events", {"mission_id": mission_id}) == []


def test_a_file_or_recording_of_another_mission_is_refused(api: Api, mission_id: str) -> None:
    sample, other_id = Sample(api), str(api.mission(api.project()["id"])["id"])
    file_id = sample.file(other_id, "one.mcap")
    recording_id = sample.recording(other_id, "one", [file_id])
    for reference in ({"file_id": file_id}, {"recording_id": recording_id}):
        body = {"name": "stumble", "start_ns": _AT_NS, **reference}
        api.post(f"/missions/{mission_id}/events", body).refused(422, "invalid_request")


def test_a_request_that_is_sent_again_adds_nothing(api: Api, mission_id: str) -> None:
    event_id = str(uuid.uuid4())
    made = _add(api, mission_id, id=event_id)
    changed = api.patch(f"/mission-events/{event_id}", {"note": "Looked at."}).ok()
    assert (made["id"], _add(api, mission_id, id=event_id)) == (event_id, changed)
    body = {"id": str(uuid.uuid4()), "name": "fall", "start_ns": _AT_NS}
    with ThreadPoolExecutor(4) as pool:
        sent = [pool.submit(api.post, f"/missions/{mission_id}/events", body) for _ in range(4)]
    assert {one.result().ok(201)["id"] for one in sent} == {body["id"]}
    operations = [one["operation"] for one in api.events(mission_id)]
    assert operations.count("mission.create_event") == 2


def test_the_id_of_an_event_of_another_mission_is_refused(api: Api, mission_id: str) -> None:
    made = _add(api, str(api.mission(api.project()["id"])["id"]))
    body = {"id": made["id"], "name": "stumble", "start_ns": _AT_NS}
    problem = api.post(f"/missions/{mission_id}/events", body).refused(422, "invalid_request")
    assert problem["problems"][0]["field"] == "id"


def test_a_finding_becomes_one_event_with_its_run(api: Api, mission_id: str) -> None:
    run_id, finding_id = _finding(api, mission_id)
    made = _add(api, mission_id, name="gait.slip", finding_id=finding_id)
    assert (made["run_id"], made["finding_id"]) == (run_id, finding_id)
    assert _add(api, mission_id, name="again", finding_id=finding_id) == made
    assert api.all("/mission-events", {"run_id": run_id}) == [made]
    other_id = str(api.mission(api.project()["id"])["id"])
    body = {"name": "stumble", "start_ns": _AT_NS, "finding_id": finding_id}
    api.post(f"/missions/{other_id}/events", body).refused(422, "invalid_request")


def test_a_change_needs_the_etag_that_was_read(api: Api, mission_id: str) -> None:
    made = _add(api, mission_id, colour="#000000")
    path, first = f"/mission-events/{made['id']}", {"If-Match": f'"{made["etag"]}"'}
    changed = api.call("PATCH", path, body={"name": "fall", "end_ns": _AT_NS + 1, "colour": None}, headers=first).ok()
    assert (changed["name"], changed["end_ns"], changed["colour"]) == ("fall", _AT_NS + 1, None)
    api.call("PATCH", path, body={"name": "slip"}, headers=first).refused(412, "edit_conflict")
    api.call("PATCH", path, body={"name": "fall"}, headers=first).ok()
    assert api.patch(path, {"end_ns": None}).ok()["end_ns"] is None
    api.patch(path, {"start_ns": _AT_NS, "end_ns": _AT_NS - 1}).refused(422, "invalid_request")
    entries = [one for one in api.events(mission_id) if one["operation"] == "mission.update_event"]
    assert entries[-1]["before"] == {"event": "stumble", "end_ns": None, "colour": "#000000"}
    assert entries[-1]["after"] == {"event": "fall", "end_ns": _AT_NS + 1, "colour": None}


def test_a_reference_to_a_recording_replaces_that_to_a_file(api: Api, mission_id: str) -> None:
    sample = Sample(api)
    file_id = sample.file(mission_id, "one.mcap")
    recording_id = sample.recording(mission_id, "one", [file_id])
    made = _add(api, mission_id, file_id=file_id)
    changed = api.patch(f"/mission-events/{made['id']}", {"recording_id": recording_id}).ok()
    assert (made["refers_to"], changed["refers_to"]) == ("file", "recording")
    assert (changed["file"], changed["recording"]) == (None, {"id": recording_id, "name": "one"})
    api.sql("DELETE FROM recording WHERE id = %s", recording_id)
    lost = api.get(f"/mission-events/{made['id']}").ok()
    assert (lost["refers_to"], lost["recording"]) == ("recording", None)


def test_a_reference_is_removed_only_on_request_also_when_its_file_is_gone(api: Api, mission_id: str) -> None:
    path = f"/mission-events/{_add(api, mission_id, file_id=Sample(api).file(mission_id, 'one.mcap'))['id']}"
    assert api.patch(path, {"recording_id": None, "note": "x"}).ok()["refers_to"] == "file"
    api.sql("DELETE FROM file WHERE mission_id = %s", mission_id)
    lost = api.patch(path, {"note": "y"}).ok()
    assert (lost["refers_to"], lost["file"]) == ("file", None)
    removed = api.patch(path, {"file_id": None}).ok()
    assert (removed["refers_to"], removed["etag"] == lost["etag"]) == ("mission", False)
    entry = api.events(mission_id)[0]
    assert (entry["before"], entry["after"]) == ({"refers_to": "file"}, {"refers_to": "mission"})
    assert _add(api, mission_id)["refers_to"] == "mission"


def test_rights_are_those_of_files_and_people_may_change_their_own(api: Api, mission_id: str) -> None:
    made = _add(api, mission_id)
    path, body = f"/mission-events/{made['id']}", {"name": "fall", "start_ns": _AT_NS}
    stranger, reader, creator, writer = (people.person(api) for _ in range(4))
    for who, right in ((reader, Right.read), (creator, Right.create), (writer, Right.write)):
        people.grant(api, who, right, mission_id=mission_id)
    as_stranger, as_reader, as_creator, as_writer = (api.as_(who.token) for who in (stranger, reader, creator, writer))
    for answer in (as_stranger.get(path), as_stranger.patch(path, {"note": "x"}), as_stranger.delete(path)):
        answer.refused(404, "not_found")
    as_stranger.post(f"/missions/{mission_id}/events", body).refused(404, "not_found")
    assert as_stranger.all("/mission-events", {"mission_id": mission_id}) == []
    assert as_reader.get(path).ok() == made
    for answer in (
        as_reader.post(f"/missions/{mission_id}/events", body),
        as_reader.patch(path, {"note": "x"}),
        as_creator.patch(path, {"note": "x"}),
        as_creator.delete(path),
        as_writer.delete(path),
    ):
        answer.refused(403, "forbidden")
    as_writer.patch(path, {"note": "x"}).ok()
    own = as_creator.post(f"/missions/{mission_id}/events", body).ok(201)
    as_creator.patch(f"/mission-events/{own['id']}", {"note": "Mine."}).ok()
    as_creator.delete(f"/mission-events/{own['id']}").ok(204)
    api.delete(path).ok(204)
    api.delete(path).refused(404, "not_found")


def test_a_token_that_only_uploads_adds_events_and_reads_none(api: Api, mission_id: str) -> None:
    other = _add(api, mission_id)
    robot = people.person(api)
    people.grant(api, robot, Right.create, mission_id=mission_id)
    token = people.token(api, robot, {Scope.upload}).secret
    made = _add(api.as_(token), mission_id, id=str(uuid.uuid4()))
    assert _add(api.as_(token), mission_id, id=made["id"]) == made
    api.as_(token).get(f"/mission-events/{made['id']}").refused(403, "scope_missing")
    body = {"id": other["id"], "name": "x", "start_ns": 0}
    api.as_(token).post(f"/missions/{mission_id}/events", body).refused(422, "invalid_request")


def test_a_link_to_a_mission_shows_its_events_without_people_and_one_to_files_none(api: Api, mission_id: str) -> None:
    file_id = Sample(api).file(mission_id, "one.mcap")
    made = _add(api, mission_id, file_id=file_id)
    guest = api.as_(people.share(api, mission_id).secret)
    (shown,) = guest.all("/mission-events")
    assert shown == {**made, "created_by": None}
    of_file = api.as_(people.share(api, mission_id, file_ids=[file_id]).secret)
    assert of_file.all("/mission-events") == []
    of_file.get(f"/mission-events/{made['id']}").refused(404, "not_found")
    of_file.get("/files", {"event": "stumble"}).refused(422, "invalid_query")


def test_a_run_adds_events_of_its_own_and_changes_no_others(api: Api, mission_id: str) -> None:
    run_id, _ = _finding(api, mission_id)
    other = _add(api, mission_id)
    token = people.token(api, str(OWNER_ID), {Scope.read, Scope.upload, Scope.write})
    of_run = "UPDATE token SET kind = 'run', run_id = %s, max_right = %s WHERE id = %s"
    api.sql(of_run, run_id, Right.create.value, token.id)
    run = api.as_(token.secret)
    made = _add(run, mission_id)
    assert made["run_id"] == run_id
    run.patch(f"/mission-events/{made['id']}", {"note": "x"}).ok()
    run.patch(f"/mission-events/{other['id']}", {"note": "x"}).refused(403, "forbidden")
    assert api.all("/mission-events", {"run_id": run_id}) == [api.get(f"/mission-events/{made['id']}").ok()]


def test_texts_of_events_that_mention_a_person_are_listed(api: Api, mission_id: str) -> None:
    word = f"falcon{uuid.uuid4().hex[:8]}"
    who = people.person(api, word)
    _add(api, mission_id, note=f"{word} slipped", labels=[word])
    people.grant(api, who, Right.read, mission_id=mission_id)
    lines = api.as_(who.token).get(f"/people/{who.id}/export").ok().splitlines()
    mentions = [line["record"] for line in map(json.loads, lines) if line["section"] == "mentions"]
    assert [(one["id"], one["fields"]) for one in mentions] == [
        (mission_id, ["note of an event", "labels of an event"])
    ]
    own = api.as_(who.token).post  # what they wrote is theirs
    people.grant(api, who, Right.create, mission_id=mission_id)
    own(f"/missions/{mission_id}/events", {"name": "mine", "start_ns": 1}).ok(201)
    lines = api.as_(who.token).get(f"/people/{who.id}/export").ok().splitlines()
    records = [line["record"] for line in map(json.loads, lines) if line["section"] == "mission_events"]
    assert [(one["mission_id"], one["name"]) for one in records] == [(mission_id, "mine")]


def test_lists_are_filtered_and_ordered_page_by_page(api: Api, mission_id: str) -> None:
    names = ("Stumble", "stumble left", "fall")
    for number, name in enumerate(names):
        _add(api, mission_id, name=name, start_ns=_AT_NS + number * 60 * _S, labels=["night"] if number else [])
    own = {"mission_id": mission_id}

    def listed(**query: str) -> list[str]:
        return [one["name"] for one in api.all("/mission-events", {**own, **query})]

    assert listed() == [*names]
    assert listed(sort="-start", limit="1") == [*reversed(names)]
    assert listed(sort="-created", limit="2") == [*reversed(names)]
    assert listed(name="STUMBLE") == ["Stumble"]
    assert listed(name="stumble*") == ["Stumble", "stumble left"]
    assert listed(label="night") == ["stumble left", "fall"]
    assert listed(after="2026-05-28T20:28:00Z") == ["fall"]
    assert listed(before="2026-05-28T20:26:40Z") == ["Stumble"]
    assert api.get("/mission-events", {**own, "count": "true", "limit": "1"}).ok()["total"] == 3
    with api.statements() as statements:
        api.get("/mission-events", own).ok()
    assert len(statements) <= 3


def test_lists_of_all_missions_name_those_that_a_person_sees(
    api: Api, mission_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, reader = _add(api, mission_id), people.person(api)
    _add(api, str(api.mission(api.project()["id"])["id"]))
    people.grant(api, reader, Right.read, mission_id=mission_id)

    def is_named(token: str | None, **query: str) -> bool:
        with api.statements() as statements:
            assert made in api.as_(token).all("/mission-events", {"limit": "500", **query})
        return any("mission_event.mission_id = ANY" in statement for statement in statements)

    assert api.as_(reader.token).all("/mission-events") == [made]
    assert is_named(reader.token)
    assert is_named(reader.token, sort="-created", name="stum*")
    assert not is_named(reader.token, mission_id=mission_id)
    assert not is_named(api.token, sort="-created")
    monkeypatch.setattr(search_plan, "MAX_VISIBLE_MISSIONS", 0)
    assert not is_named(reader.token)


def test_events_go_with_their_mission_and_its_project(api: Api, mission_id: str) -> None:
    made, destination = _add(api, mission_id), api.project()["id"]
    api.patch(f"/missions/{mission_id}", {"project_id": destination}).ok()
    (shown,) = api.all("/mission-events", {"project_id": destination})
    assert shown["mission"]["project"]["id"] == destination
    api.delete(f"/missions/{mission_id}").ok()
    api.get(f"/mission-events/{made['id']}").refused(404, "not_found")
    api.post(f"/trash/mission/{mission_id}/restore").ok(204)
    assert api.get(f"/mission-events/{made['id']}").ok()["name"] == "stumble"


def test_an_event_stays_when_its_file_is_deleted(api: Api, mission_id: str) -> None:
    file_id = Sample(api).file(mission_id, "one.mcap")
    made = _add(api, mission_id, file_id=file_id)
    for remove in (
        lambda: api.delete(f"/files/{file_id}").ok(),
        lambda: api.sql("DELETE FROM file WHERE id = %s", file_id),
    ):
        remove()
        shown = api.get(f"/mission-events/{made['id']}").ok()
        assert (shown["name"], shown["refers_to"], shown["file"]) == ("stumble", "file", None)


def test_a_mission_has_a_limited_number_of_events(api: Api, mission_id: str) -> None:
    api.sql(
        "INSERT INTO mission_event (id, mission_id, name, name_key, start_ns, created_by_id)"
        " SELECT gen_random_uuid(), %s, 'x', 'x', n, %s FROM generate_series(1, %s) n",
        *(mission_id, OWNER_ID, MAX_MISSION_EVENTS),
    )
    body = {"name": "stumble", "start_ns": _AT_NS}
    problem = api.post(f"/missions/{mission_id}/events", body).refused(422, "invalid_request")
    assert "10,000" in problem["problems"][0]["message"]


def test_open_pages_learn_of_every_change(api: Api, mission_id: str) -> None:
    with listening(api) as ears:
        made = _add(api, mission_id)
        change = {"resource_type": "mission_event", "id": made["id"], "mission_id": mission_id}
        ears.receive(**change, change="created")
        api.patch(f"/mission-events/{made['id']}", {"note": "x"}).ok()
        ears.receive(**change, change="changed")
        api.delete(f"/mission-events/{made['id']}").ok(204)
        ears.receive(**change, change="removed")
