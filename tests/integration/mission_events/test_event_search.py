"""`event:` finds missions with such an event, and the files that were recorded then."""

from dataclasses import dataclass
from typing import Any

import pytest

from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.sample import Sample

_S = 10**9
_AT_NS = 1_780_000_000 * _S


@dataclass(frozen=True)
class Walk:
    """A project with two missions: `early` and `late` were recorded one after the other, `side` beside both."""

    api: Api
    project_id: str
    mission_id: str
    files: dict[str, str]

    def add(self, name: str, second: float, **fields: Any) -> None:
        """Add an event that many seconds after the start of the mission."""
        body = {"name": name, "start_ns": _AT_NS + round(second * _S), **fields}
        self.api.post(f"/missions/{self.mission_id}/events", body).ok(201)

    def files_with(self, query: str) -> set[str]:
        """Return the names of the files that a query finds, by the list and by the search."""
        text = f"project:{self.project_id} {query}"
        names = {item["path"] for item in self.api.all("/files", {"query": text})}
        searched = self.api.get("/search", {"query": text}).ok()
        assert {item["path"] for item in searched["files"]["items"]} == names
        return {name.removesuffix(".mcap") for name in names}

    def missions_with(self, query: str) -> int:
        """Return how many missions a query finds."""
        return len(self.api.all("/missions", {"query": f"project:{self.project_id} {query}"}))


@pytest.fixture(name="walk", scope="module")
def _walk(api: Api) -> Walk:
    sample, project_id = Sample(api), str(api.project()["id"])
    mission_id, other_id = (str(api.mission(project_id)["id"]) for _ in range(2))
    spans = {"early": (0, 10), "late": (10, 20), "side": (0, 20)}
    files = {}
    for name, (start, end) in spans.items():
        times: dict[str, Any] = {"start_ns": _AT_NS + start * _S, "end_ns": _AT_NS + end * _S}
        files[name] = sample.file(mission_id, f"{name}.mcap", topics=[{"name": "/imu", "count": 1}], **times)
    files["notes"] = sample.file(mission_id, "notes.txt.mcap")
    files["other"] = sample.file(other_id, "other.mcap", start_ns=_AT_NS, end_ns=_AT_NS + 20 * _S)
    walk = Walk(api, project_id, mission_id, files)
    recording_id = sample.recording(mission_id, "side", [files["side"]])
    walk.add("stumble", 3)
    walk.add("Slip left", 8, end_ns=_AT_NS + 12 * _S)
    walk.add("glare", 4, file_id=files["side"])
    walk.add("shake", 15, recording_id=recording_id)
    walk.add("handover", 500)
    return walk


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        ("event:stumble", {"early", "side"}),
        ("event:STUM*", {"early", "side"}),
        ("event:*umbl*", {"early", "side"}),
        ('event:"slip left"', {"early", "late", "side"}),
        ("event:glare", {"side"}),
        ("event:shake", {"side"}),
        ("event:handover", set()),
        ("event:umbl", set()),
        ("event:stumble event:shake", {"early", "side"}),
        ("event:* -event:stumble", {"late"}),
        ("-event:s*", {"notes.txt", "other"}),
        ("event:stumble topic:/imu path:early*", {"early"}),
        ("event:stumble early", {"early"}),
    ],
)
def test_files_are_found_by_the_events_during_which_they_were_recorded(
    walk: Walk, query: str, expected: set[str]
) -> None:
    assert walk.files_with(query) == expected


@pytest.mark.parametrize(
    ("query", "count"),
    [
        ("event:stumble", 1),
        ("event:handover", 1),
        ("event:nothing", 0),
        ("-event:stumble", 2),
        ("event:* path:late*", 1),
    ],
)
def test_missions_are_found_by_their_events(walk: Walk, query: str, count: int) -> None:
    # Of the mission itself, or of one of its files: a file of the first mission has no such event.
    assert walk.missions_with(query) == count


def test_an_event_of_a_file_or_recording_that_is_gone_finds_no_file(walk: Walk) -> None:
    sample = Sample(walk.api)
    files = {name: sample.file(walk.mission_id, name, start_ns=_AT_NS, end_ns=_AT_NS + _S) for name in ("1", "2", "3")}
    for name in ("1", "2"):
        walk.add("gone", 1, file_id=files[name])
    walk.add("gone", 1, recording_id=sample.recording(walk.mission_id, "three", [files["3"]]))
    assert walk.files_with("event:gone") == {"1", "2", "3"}
    walk.api.delete(f"/files/{files['1']}").ok()
    walk.api.sql("DELETE FROM file WHERE id = ANY(%s)", [files["2"]])
    walk.api.sql("DELETE FROM recording WHERE mission_id = %s AND name = 'three'", walk.mission_id)
    assert walk.files_with("event:gone") == set()
    assert walk.missions_with("event:gone") == 1
    walk.api.sql("DELETE FROM file WHERE id = ANY(%s)", [files["1"], files["3"]])


def test_files_are_not_read_where_missions_decide(walk: Walk) -> None:
    with walk.api.statements() as statements:
        walk.missions_with("event:stumble")
    # Only the condition on files compares times.
    assert any("mission_event.name_key" in statement for statement in statements)
    assert not any("mission_event.start_ns" in statement for statement in statements)


def test_the_filter_of_missions_and_files_has_the_same_field(walk: Walk) -> None:
    own = {"project_id": walk.project_id}
    assert [one["id"] for one in walk.api.all("/missions", {**own, "event": "handover"})] == [walk.mission_id]
    assert {one["path"] for one in walk.api.all("/files", {**own, "event": "glare"})} == {"side.mcap"}
    topics = walk.api.all("/topics", {**own, "event": "stumble"})
    assert {one["file_id"] for one in topics} == {walk.files["early"], walk.files["side"]}
    facets = walk.api.get("/search/facets", {"query": f"project:{walk.project_id} event:stumble"}).ok()
    assert facets["file_count"] == 2
    assert walk.api.get("/stats", {**own, "event": "stumble"}).ok()["total"]["files"] == 2


def test_events_of_missions_that_are_not_visible_find_nothing(walk: Walk) -> None:
    stranger = walk.api.as_(people.person(walk.api).token)
    assert stranger.all("/files", {"query": "event:stumble"}) == []
    assert stranger.all("/missions", {"query": "event:stumble"}) == []
