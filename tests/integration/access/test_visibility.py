"""Lists, searches and numbers show each person exactly what they may see."""

import random
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import pytest

from kleinkram.server.filters import plan as search_plan
from tests.integration.access import visibility_model
from tests.integration.access.visibility_model import Eye, File, Lab, Mission, Project
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi

T = TypeVar("T")
# What is asked of each thing is asked of so many of them by each who looks.
_SOME = {"short": 4, "long": 20, "longest": 10_000}
_MARKS: dict[str, list[pytest.MarkDecorator]] = {"short": [], "long": [pytest.mark.slow], "longest": [pytest.mark.soak]}


def _round(seed: int) -> str:
    return "short" if seed == 0 else "long" if seed < 5 else "longest"


_ROUND = [pytest.param(seed, marks=_MARKS[_round(seed)]) for seed in range(16)]


@pytest.fixture(scope="module", params=_ROUND)
def lab(request: pytest.FixtureRequest, start_api: StartApi) -> Lab:
    return visibility_model.build(start_api(), request.param)


def _looks(lab: Lab) -> Iterable[tuple[Eye, Api]]:
    return [(eye, lab.api.as_(eye.secret)) for eye in lab.eyes]


def _listed(api: Api, path: str, **query: str) -> list[Any]:
    """Return all that a list shows, two at a time, and see that it counts what it shows."""
    items = api.all(path, {"limit": "2", **query})
    if path != "/trash":
        assert api.get(path, {"limit": "1", "count": "true", **query}).ok()["total"] == len(items)
    return items


def _ids(items: Iterable[Any], key: str = "id") -> list[str]:
    return sorted(str(item[key]) for item in items)


def _some(lab: Lab, eye: Eye, items: Sequence[T]) -> Sequence[T]:
    return random.Random(f"{lab.seed} {eye.name}").sample(items, min(len(items), _SOME[_round(lab.seed)]))


def _visible_files(lab: Lab, eye: Eye, missions: Iterable[Mission] | None = None) -> list[File]:
    actual = lab.missions if missions is None else missions
    return [file for mission in actual for file in mission.files if visibility_model.sees_file(eye, file)]


def test_projects(lab: Lab) -> None:
    for eye, api in _looks(lab):
        visible = {project.id: project for project in lab.projects if visibility_model.sees_project(eye, project)}
        listed = _listed(api, "/projects")
        assert _ids(listed) == sorted(visible), eye
        for item in listed:
            missions = [
                mission for mission in visible[item["id"]].missions if visibility_model.sees_mission(eye, mission)
            ]
            files = _visible_files(lab, eye, missions)
            amounts = (item["mission_count"], item["file_count"], item["size_bytes"])
            assert amounts == (len(missions), len(files), sum(file.size_bytes for file in files)), eye
            assert api.get(f"/projects/{item['id']}").ok() == item


def test_missions(lab: Lab) -> None:
    for eye, api in _looks(lab):
        visible = {mission.id: mission for mission in lab.missions if visibility_model.sees_mission(eye, mission)}
        listed = _listed(api, "/missions")
        assert _ids(listed) == sorted(visible), eye
        for item in listed:
            files = _visible_files(lab, eye, [visible[item["id"]]])
            amounts = (item["file_count"], item["size_bytes"], item["message_count"])
            expected = (len(files), sum(file.size_bytes for file in files), sum(file.messages for file in files))
            assert amounts == expected, eye
            assert api.get(f"/missions/{item['id']}").ok() == item


def test_recordings(lab: Lab) -> None:
    for eye, api in _looks(lab):
        if not eye.reads:
            continue
        for mission in _some(lab, eye, lab.missions):
            answer = api.get(f"/missions/{mission.id}/recordings")
            if visibility_model.sees_mission(eye, mission):
                assert set(_ids(answer.ok()["items"])) == visibility_model.recordings(eye, mission.files), eye
            else:
                answer.refused(404, "not_found")


def test_files_and_topics(lab: Lab) -> None:
    for eye, api in _looks(lab):
        if not eye.reads:
            api.get("/files").refused(403, "scope_missing")
            continue
        visible = sorted(file.id for file in _visible_files(lab, eye))
        assert _ids(_listed(api, "/files")) == visible, eye
        assert _ids(_listed(api, "/topics"), "file_id") == visible, eye


def test_files_in_the_order_of_time(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """Someone who sees very many missions lists the same files by time."""
    monkeypatch.setattr(search_plan, "MAX_VISIBLE_MISSIONS", 0)
    for eye, api in _looks(lab):
        if not eye.reads:
            continue
        visible = sorted(file.id for file in _visible_files(lab, eye))
        for requested in ({}, {"message_type": "std_msgs/String"}):
            assert _ids(api.all("/files", {"sort": "-start", "limit": "50", **requested})) == visible, (eye, requested)


def test_searches(lab: Lab) -> None:
    """Each number of a search and of its facets is that of visible files only."""
    for eye, api in _looks(lab):
        if not eye.reads:
            continue
        for query, files in _some(lab, eye, _queries(lab, eye)):
            actual = api.get("/search", {"query": query, "limit": "500"}).ok()
            assert _ids(actual["files"]["items"]) == sorted(file.id for file in files), eye
            assert actual["files"]["total"] == actual["topics"]["total"] == len(files), eye
            assert sum(item["file_count"] for item in actual["topics"]["items"]) == len(files), eye
            if query:  # what says nothing finds missions without files, too
                assert _ids(actual["missions"]["items"]) == sorted({file.mission.id for file in files}), eye
            facets = {entry["name"]: entry for entry in api.get("/search/facets", {"query": query}).ok()["facets"]}
            projects = Counter(file.mission.project.name for file in files)
            shown = facets.get("project", {"values": []})["values"]
            assert {entry["value"]: entry["file_count"] for entry in shown} == projects, eye
            assert facets.get("topic", {"value_count": 0})["value_count"] == len(files), eye


def _queries(lab: Lab, eye: Eye) -> list[tuple[str, list[File]]]:
    """Return queries with the visible files that they find."""
    visible = _visible_files(lab, eye)
    alone = [file for file in visible if file.path == "alone.mcap"]
    return [
        ("", visible),
        ("path:alone.mcap", alone),
        ("-path:split/*", alone),
        ("mission:outing* path:none", []),
        ("topic:/* -path:alone.mcap", [file for file in visible if file not in alone]),
    ]


@pytest.mark.parametrize("by", ["project", "mission", "topic", "format"])
def test_statistics(lab: Lab, by: str) -> None:
    for eye, api in _looks(lab):
        if not eye.reads:
            continue
        files = _visible_files(lab, eye)
        stats = api.get("/stats", {"by": by}).ok()
        total = stats["total"]
        assert (total["files"], total["size_bytes"]) == (len(files), sum(file.size_bytes for file in files)), eye
        assert total["missions"] == len({file.mission.id for file in files}), eye
        assert total["messages"] == sum(file.messages for file in files), eye
        assert total["recordings"] == len(visibility_model.recordings(eye, lab.files)), eye
        groups = {
            "project": {file.mission.project.name for file in files},
            "mission": {f"{file.mission.project.name}/{file.mission.name}" for file in files},
        }
        assert {row["group"] for row in stats["rows"]} == groups.get(by, {row["group"] for row in stats["rows"]})


def test_search_finds_only_visible_missions(lab: Lab) -> None:
    for eye, api in _looks(lab):
        for project in _some(lab, eye, lab.projects):
            actual = _search(api, "/projects", name=project.name)
            assert actual == ([project.id] if visibility_model.sees_project(eye, project) else []), eye
            missions = sorted(mission.id for mission in project.missions if visibility_model.sees_mission(eye, mission))
            files = sorted(file.id for file in _visible_files(lab, eye, project.missions))
            for query in ({"project": project.name}, {"project_id": project.id}, {"text": project.name}):
                assert _search(api, "/missions", **query) == missions, (eye, query)
                if eye.reads:
                    assert _search(api, "/files", **query) == files, (eye, query)


def _search(api: Api, path: str, **query: str) -> list[str]:
    return _ids(api.get(path, {"limit": "500", **query}).ok()["items"])


def test_objects_by_their_id(lab: Lab) -> None:
    for eye, api in _looks(lab):
        for project in lab.projects:
            assert api.get(f"/projects/{project.id}").status == (
                200 if visibility_model.sees_project(eye, project) else 404
            ), eye
        for file in _some(lab, eye, lab.files) if eye.reads else []:
            sees = visibility_model.sees_file(eye, file)
            for path in (f"/files/{file.id}", f"/files/{file.id}/topics"):
                assert api.get(path).status == (200 if sees else 404), eye
            listed = file.recording in visibility_model.recordings(eye, lab.files)
            assert api.get(f"/recordings/{file.recording}").status == (200 if listed else 404), eye


def test_the_trash(lab: Lab) -> None:
    for eye, api in _looks(lab):
        answer = api.get("/trash")
        if eye.secret is None or eye.is_link or not eye.reads:
            assert answer.status in {401, 403}
            continue
        places: list[Project | Mission] = [*lab.projects, *lab.missions]
        owned = [place.id for place in places if place.is_gone and visibility_model.level(eye, place) == 4]
        owned += [file.id for file in lab.files if file.is_gone and visibility_model.level(eye, file.mission) == 4]
        assert _ids(_listed(api, "/trash")) == sorted(owned), eye


def test_the_audit_log(lab: Lab) -> None:
    for eye, api in _looks(lab):
        if eye.secret is None or eye.is_link or not eye.reads:
            continue
        message = {event["project_id"] for event in api.all("/audit", {"limit": "500"})} - {None}
        assert message == {project.id for project in lab.projects if visibility_model.level(eye, project) == 4}, eye


def test_the_cursor_of_another_persons_list_shows_only_own_rows(lab: Lab) -> None:
    """A cursor does not reveal hidden objects."""
    admin = next(eye for eye in lab.eyes if eye.is_admin and eye.reach is None)
    cursor = lab.api.as_(admin.secret).get("/missions", {"limit": "1"}).ok()["next"]
    for eye, api in _looks(lab):
        rest = {item["id"] for item in api.get("/missions", {"limit": "500", "cursor": cursor}).ok()["items"]}
        assert rest <= {mission.id for mission in lab.missions if visibility_model.sees_mission(eye, mission)}, eye
