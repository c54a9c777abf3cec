"""Events are sent as changes happen, to people who may see them."""

import time
from collections.abc import Callable
from contextlib import ExitStack

import pytest

from kleinkram.contract.access import Right, Scope
from kleinkram.server.access.operations import OPERATIONS
from kleinkram.server.events import hub as hubs
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.event_client import Ears, listening
from tests.integration.jobs import run_jobs
from tests.integration.upload_client import begin, complete, send, upload, upload_all, wait_until
from tests.services import RunningPostgres


@pytest.fixture(scope="module")
def lab(start_api: StartApi) -> Api:
    """An API of its own: its jobs are run here."""
    return start_api()


def _marked(api: Api, ears: Ears, mission_id: str) -> None:
    """Change something that is heard for certain: whatever was told before it has arrived by then."""
    made = api.post(f"/missions/{mission_id}/uploads", {"files": [{"path": "mark", "size_bytes": 1}]}).ok()
    upload_id = made["items"][0]["upload"]["id"]
    api.delete(f"/uploads/{upload_id}").ok(204)
    ears.receive(resource_type="upload", id=upload_id, change="removed")


def test_events_follow_a_file_from_announcement_to_summary_and_verification(lab: Api) -> None:
    project = lab.project()
    mission = lab.mission(project["id"])
    member = people.person(lab)
    people.grant(lab, member, Right.read, mission_id=mission["id"])
    with listening(lab.as_(member.token)) as ears:
        begun = begin(lab, mission["id"], {"seen.txt": b"some words"})[0]["upload"]
        message = ears.receive(resource_type="upload", id=begun["id"], change="created")
        assert (message["mission_id"], message["project_id"]) == (mission["id"], project["id"])
        send(lab, begun, b"some words")
        file_id = complete(lab, begun, b"some words")["file"]["id"]
        ears.receive(resource_type="upload", id=begun["id"], change="removed")
        message = ears.receive(resource_type="file", id=file_id, change="created")
        assert set(message) == {"resource_type", "change", "id", "project_id", "mission_id"}, "no contents"
        run_jobs(lab)
        ears.receive(resource_type="file", id=file_id, change="changed")
        ears.receive(resource_type="recording", change="changed", mission_id=mission["id"])


def test_creating_renaming_moving_and_deleting_send_events(lab: Api) -> None:
    project, target = lab.project(), lab.project()
    with listening(lab) as ears:
        mission = lab.mission(project["id"])
        ears.receive(resource_type="mission", id=mission["id"], change="created")
        file = upload(lab, mission["id"], "a.txt", b"a file that is renamed")
        lab.patch(f"/files/{file['id']}", {"path": "b.txt"}).ok()
        ears.receive(resource_type="file", id=file["id"], change="changed", mission_id=mission["id"])
        lab.delete(f"/files/{file['id']}").ok()
        ears.receive(resource_type="file", id=file["id"], change="removed")
        lab.patch(f"/missions/{mission['id']}", {"project_id": target["id"]}).ok()
        ears.receive(resource_type="mission", id=mission["id"], change="removed", project_id=project["id"])
        ears.receive(resource_type="mission", id=mission["id"], change="created", project_id=target["id"])
        lab.delete(f"/missions/{mission['id']}").ok()
        ears.receive(resource_type="mission", id=mission["id"], change="removed", project_id=target["id"])


def test_events_of_hidden_objects_are_not_sent(lab: Api) -> None:
    theirs, mine = lab.mission(lab.project()["id"]), lab.mission(lab.project()["id"])
    member = people.person(lab)
    people.grant(lab, member, Right.read, project_id=mine["project"]["id"])
    limited = people.token(lab, member, [Scope.read], limits=[theirs["id"]]).secret
    with listening(lab.as_(member.token)) as ears, listening(lab.as_(limited)) as deaf:
        file = upload(lab, theirs["id"], "secret.txt", b"not for them")
        lab.patch(f"/files/{file['id']}", {"labels": ["secret"]}).ok()
        lab.patch(f"/missions/{theirs['id']}", {"notes": "secret"}).ok()
        lab.patch(f"/projects/{theirs['project']['id']}", {"description": "secret"}).ok()
        people.person(lab)
        _marked(lab, ears, mine["id"])
        assert {data["mission_id"] for _, data in ears.events} == {mine["id"]}
        assert deaf.events == [], "a token that is limited to what its carrier may not see hears nothing"


def test_many_changes_at_once_are_one_event(lab: Api) -> None:
    mission = lab.mission(lab.project()["id"])
    with listening(lab) as ears, lab.statements() as statements:
        upload_all(lab, mission["id"], {f"{number}.txt": f"file {number}".encode() for number in range(30)})
        ears.receive(resource_type="file", id=None, change="created", mission_id=mission["id"])
        _marked(lab, ears, mission["id"])
    message = [event for event in ears.events if event[1]["resource_type"] == "file"]
    assert len(message) == 1, "not one event a file"
    announced, finished, marks = 1, 2, 2
    assert sum("pg_notify" in item for item in statements) <= announced + finished + marks


def _ended_token(lab: Api, member: people.Person) -> None:
    lab.as_(member.token).delete(f"/tokens/{member.token_id}").ok(204)


def _ended_account(lab: Api, member: people.Person) -> None:
    lab.post(f"/people/{member.id}/deactivate").ok()


def _ended_behind_the_back(lab: Api, member: people.Person) -> None:
    people.revoke(lab, people.Token(member.token_id, member.token))


@pytest.mark.parametrize("end", [_ended_token, _ended_account, _ended_behind_the_back])
def test_a_stream_ends_with_its_session_or_token(lab: Api, end: Callable[[Api, people.Person], None]) -> None:
    mission = lab.mission(lab.project()["id"])
    member = people.person(lab)
    people.grant(lab, member, Right.read, mission_id=mission["id"])
    with listening(lab.as_(member.token)) as ears:
        end(lab, member)
        ended_at = time.monotonic()
        lab.patch(f"/missions/{mission['id']}", {"notes": "not for them any more"}).ok()
        ears.ends()
        assert time.monotonic() - ended_at < 30
        assert [data for event, data in ears.events if event == "change" and data["resource_type"] == "mission"] == []


def test_signing_out_ends_the_stream_of_the_browser(lab: Api) -> None:
    member = people.person(lab)
    cookie = {"Cookie": f"kleinkram={people.session(lab, member)}"}
    with listening(lab, headers=cookie) as ears:
        origin = lab.app.state.settings.public_origin
        lab.as_(None).call("POST", "/auth/sign-out", headers={**cookie, "Origin": origin}).ok(204)
        ears.ends()


def test_changed_rights_make_clients_reload_and_hide_events(lab: Api) -> None:
    mission, other = lab.mission(lab.project()["id"]), lab.mission(lab.project()["id"])
    member = people.person(lab)
    people.grant(lab, member, Right.read, mission_id=other["id"])
    changed = ("refetch", {"reason": "rights"})
    with listening(lab.as_(member.token)) as ears:
        grant_id = people.grant(lab, member, Right.read, mission_id=mission["id"])
        ears.until(lambda: ears.events == [changed])
        lab.delete(f"/missions/{mission['id']}/grants/{grant_id}").ok(204)
        ears.until(lambda: ears.events.count(changed) == 2)
        lab.patch(f"/missions/{mission['id']}", {"notes": "not for them any more"}).ok()
        _marked(lab, ears, other["id"])
        assert {data["mission_id"] for event, data in ears.events if event == "change"} == {other["id"]}


def test_a_reconnecting_client_receives_missed_events(lab: Api) -> None:
    mission = lab.mission(lab.project()["id"])
    with listening(lab) as ears:
        last = ears.last_id
    made = lab.mission(mission["project"]["id"])
    with listening(lab, after=last) as ears:
        ears.receive(resource_type="mission", id=made["id"], change="created")
        assert all(event == "change" for event, _ in ears.events)
        last = ears.last_id
    headers = {"Authorization": f"Bearer {lab.token}", "Last-Event-ID": "gone-5"}
    with listening(lab, headers=headers) as ears:
        ears.until(lambda: ears.events == [("refetch", {"reason": "missed"})])
        assert ears.last_id.partition("-")[0] == last.partition("-")[0]


def test_an_unknown_last_event_id_is_not_echoed(lab: Api) -> None:
    for after in ("1\nevent: change\ndata: {}", "1\r", "é"):
        lab.get("/events", {"after": after, "for_s": "0"}).refused(422, "invalid_request")


def test_a_slow_client_must_reload(lab: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hubs, "MAX_PENDING", 3)
    mission = lab.mission(lab.project()["id"])
    written = f'["thing", "changed", "\' || gen_random_uuid() || \'", null, "{mission["id"]}", null]'
    with listening(lab) as ears:
        lab.sql(f"SELECT pg_notify('kleinkram_changes', '{written}') FROM generate_series(1, 30)")
        ears.until(lambda: ("refetch", {"reason": "behind"}) in ears.events)
        assert len(ears.events) < 15


def test_streams_per_account_are_limited(lab: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hubs, "MAX_STREAMS_PER_PERSON", 2)
    member, other = people.person(lab), people.person(lab)
    with listening(lab.as_(member.token)), ExitStack() as second:
        second.enter_context(listening(lab.as_(member.token)))
        lab.as_(member.token).get("/events").refused(429, "too_many_streams")
        lab.as_(other.token).get("/events", {"for_s": "0"}).ok()
        second.close()
        wait_until(lambda: lab.as_(member.token).get("/events", {"for_s": "0"}).status == 200)


def test_a_stream_occupies_no_database_connection(lab: Api, postgres: RunningPostgres) -> None:
    pool = lab.app.state.database.engine.pool
    with ExitStack() as stack:
        streams = [stack.enter_context(listening(lab)) for _ in range(12)]
        wait_until(lambda: pool.checkedout() == 0)
        lab.get("/projects").ok()
        assert not any(item.is_over for item in streams)
    name = lab.sql("SELECT current_database()")[0][0]
    listeners = "SELECT count(*) FROM pg_stat_activity WHERE datname = '{}' AND query LIKE 'LISTEN%'"
    assert postgres.sql(listeners.format(name)).strip() == "1"


def test_guests_and_robots_receive_no_events(lab: Api) -> None:
    mission = lab.mission(lab.project()["id"])
    lab.as_(None).get("/events").refused(401, "not_authenticated")
    lab.as_(people.share(lab, mission["id"]).secret).get("/events").refused(403, "scope_missing")
    robot = people.token(lab, people.person(lab), [Scope.upload])
    lab.as_(robot.secret).get("/events").refused(403, "scope_missing")
    assert OPERATIONS["watch_events"].scopes == {Scope.read}
