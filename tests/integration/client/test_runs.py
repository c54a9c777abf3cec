"""Runs in the SDK: launch many, follow the log, wait, download artifacts."""

import datetime
import hashlib
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from kleinkram.client import Client, Endpoint, EndpointSource
from kleinkram.client.errors import InvalidInput, TimedOut, VerifyFailed
from kleinkram.client.transfer import Outcome
from kleinkram.contract.actions import ActionDefinition, ActionRead
from kleinkram.contract.base import Page
from kleinkram.contract.errors import AmbiguousName
from kleinkram.contract.runs import (
    MAX_LAUNCHED,
    ArtifactRead,
    ArtifactUrl,
    ArtifactUrls,
    LogChunkRead,
    RunDetail,
    RunsCreated,
    RunState,
)
from tests.api_objects import NOW, action_read, run_detail
from tests.http_server import QuietHandler, serving
from tests.scripted_server import Scripted, scripted

SCRIPT = ActionDefinition(name="look", script="print(1)")


def client_of(script: Scripted) -> Client:
    return Client(Endpoint("x", script.url, "t", EndpointSource.argument))


def piece(text: str, offset: int, *, attempt: int = 1, is_over: bool = False) -> LogChunkRead:
    return LogChunkRead(attempt=attempt, offset=offset, next_offset=offset + len(text), text=text, is_over=is_over)


def test_runs_are_launched_in_batches() -> None:
    missions = [uuid.uuid4() for _ in range(MAX_LAUNCHED + 1)]
    with scripted(RunsCreated(items=[]), RunsCreated(items=[])) as script, client_of(script) as client:
        assert client.runs.launch(SCRIPT, missions, parameters={"rate": 2}) == []
    first, second = (request.body for request in script.requests)
    assert (len(first["mission_ids"]), second["mission_ids"]) == (MAX_LAUNCHED, [str(missions[-1])])
    assert first["definition"]["script"] == "print(1)"
    assert "action_id" not in first
    assert first["parameters"] == {"rate": 2}


def test_a_definition_has_no_versions() -> None:
    with scripted() as script, client_of(script) as client, pytest.raises(InvalidInput, match="published action"):
        client.runs.launch(SCRIPT, [uuid.uuid4()], version=2)


def test_following_a_log_continues_with_the_next_attempt() -> None:
    answers = [piece("one\n", 0), piece("", 4), piece("", 0, attempt=2), piece("ONE\n", 0, attempt=2)]
    with scripted(*answers, piece("two\n", 4, attempt=2, is_over=True)) as script, client_of(script) as client:
        pieces = [*client.runs.log(uuid.uuid4(), follow=True)]
    assert [(piece.attempt, piece.text) for piece in pieces] == [(1, "one\n"), (2, "ONE\n"), (2, "two\n")]
    queries = [request.path.partition("?")[2] for request in script.requests]
    assert queries[0] == "offset=0&wait_s=0.0"
    assert [query.partition("&")[0] for query in queries] == [
        "offset=0",
        "offset=4",
        "offset=4",
        "offset=0",
        "offset=4",
    ]
    assert "wait_s=20" in queries[1]


def test_a_log_that_is_not_followed_ends_at_its_current_end() -> None:
    with scripted(piece("one\n", 0), piece("", 4)) as script, client_of(script) as client:
        assert [piece.text for piece in client.runs.log(uuid.uuid4())] == ["one\n"]


def test_waiting_ends_with_the_run_or_the_timeout() -> None:
    seen: list[RunDetail] = []
    with scripted(run_detail(RunState.running), run_detail(RunState.failed)) as script, client_of(script) as client:
        assert client.runs.wait(uuid.uuid4(), seen=seen.append).state is RunState.failed
    assert [run.state for run in seen] == [RunState.running, RunState.failed]
    with scripted(run_detail(RunState.queued)) as script, client_of(script) as client, pytest.raises(TimedOut):
        client.runs.wait(uuid.uuid4(), timeout_s=0)


def test_a_run_has_no_name() -> None:
    with scripted() as script, client_of(script) as client, pytest.raises(InvalidInput, match="klein run list"):
        client.runs.get("look")


def test_ambiguous_names_of_actions_are_refused() -> None:
    of_lab, of_project = action_read("look"), action_read("Look", project="alps")
    with scripted(Page(items=[of_lab, of_project], next=None)) as script, client_of(script) as client:
        with pytest.raises(AmbiguousName, match="alps/Look") as caught:
            client.actions.get("look")
        assert any("of the whole lab" in candidate for candidate in caught.value.candidates)
    nothing = Page[ActionRead](items=[], next=None)
    with scripted(nothing, Page(items=[of_lab], next=None)) as script, client_of(script) as client:
        assert client.actions.get("look").id == of_lab.id
    assert "archived=true" in script.requests[1].path


def test_a_version_of_an_action_is_read_with_its_lock() -> None:
    action = action_read("look")
    with scripted(action.latest) as script, client_of(script) as client:
        assert client.actions.version(action) == action.latest
        assert script.requests == [], "the latest is part of the action"
        assert client.actions.version(action, 7) == action.latest
    assert script.requests[0].path.endswith(f"/actions/{action.id}/versions/7")


def artifact(path: str, content: bytes) -> ArtifactRead:
    sha256 = hashlib.sha256(content).hexdigest()
    return ArtifactRead(
        id=uuid.uuid4(), run_id=uuid.uuid4(), path=path, size_bytes=len(content), sha256=sha256, file_id=None
    )


@contextmanager
def store_of(content: bytes) -> Iterator[str]:
    """A store that gives these bytes for whatever is asked."""

    class Speaker(QuietHandler):
        def do_GET(self) -> None:
            self.send(200, content)

    with serving(Speaker) as port:
        yield f"http://127.0.0.1:{port}/key"


def test_artifacts_are_verified_before_they_get_their_name(tmp_path: Path) -> None:
    good, bad = artifact("tables/counts.csv", b"topic,count\n"), artifact("../escape", b"")
    later = NOW + datetime.timedelta(minutes=5)
    with store_of(b"topic,count\n") as url:
        urls = ArtifactUrls(items=[ArtifactUrl(artifact=good, url=url, expires_at=later)])
        with scripted(Page(items=[good, bad], next=None), urls) as script, client_of(script) as client:
            report = client.runs.download_artifacts(good.run_id, tmp_path)
        assert [result.outcome for result in report.results] == [Outcome.downloaded]
        assert len(report.left_out) == 1
        assert (tmp_path / "tables" / "counts.csv").read_bytes() == b"topic,count\n"
        assert script.requests[1].body == {"artifact_ids": [str(good.id)]}
        with scripted(Page(items=[good], next=None)) as script, client_of(script) as client:
            (result,) = client.runs.download_artifacts(good.run_id, tmp_path).results
        assert result.outcome is Outcome.already_present

        other = artifact("other.csv", b"TOPIC,COUNT\n")
        urls = ArtifactUrls(items=[ArtifactUrl(artifact=other, url=url, expires_at=later)])
        with scripted(urls) as script, client_of(script) as client:
            (result,) = client.runs.download_artifacts(other.run_id, tmp_path, artifacts=[other]).results
        assert isinstance(result.error, VerifyFailed)
        assert not (tmp_path / "other.csv").exists()
