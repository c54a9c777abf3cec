"""Lists, searches and numbers show each person exactly what they may see."""

import random
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import pytest

from kleinkram.server.filters import plan as search_plan
from tests.integration.access import visibility_model
from tests.integration.access.visibility_model import File, Lab, Mission, Project, Viewer
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi

T = TypeVar("T")
# Objects per viewer in the tests that request single objects, by round.
_SAMPLE_SIZE = {"short": 4, "long": 10_000}


def _round(seed: int) -> str:
    return "short" if seed == 0 else "long"


_ROUND = [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(1, 16))]


@pytest.fixture(scope="module", params=_ROUND)
def lab(request: pytest.FixtureRequest, start_api: StartApi) -> Lab:
    return visibility_model.build(start_api(), request.param)


def _viewers(lab: Lab) -> Iterable[tuple[Viewer, Api]]:
    return [(viewer, lab.api.as_(viewer.secret)) for viewer in lab.viewers]


def _listed(api: Api, path: str, **query: str) -> list[Any]:
    """Return all items of a list, in pages of two, and check its count."""
    items = api.all(path, {"limit": "2", **query})
    if path != "/trash":
        assert api.get(path, {"limit": "1", "count": "true", **query}).ok()["total"] == len(items)
    return items


def _ids(items: Iterable[Any], key: str = "id") -> list[str]:
    return sorted(str(item[key]) for item in items)


def _sample(lab: Lab, viewer: Viewer, items: Sequence[T]) -> Sequence[T]:
    return random.Random(f"{lab.seed} {viewer.name}").sample(items, min(len(items), _SAMPLE_SIZE[_round(lab.seed)]))


def _visible_files(lab: Lab, viewer: Viewer, missions: Iterable[Mission] | None = None) -> list[File]:
    actual = lab.missions if missions is None else missions
    return [file for mission in actual for file in mission.files if visibility_model.sees_file(viewer, file)]


def test_lists_of_projects_show_only_visible_ones_and_their_totals(lab: Lab) -> None:
    for viewer, api in _viewers(lab):
        visible = {project.id: project for project in lab.projects if visibility_model.sees_project(viewer, project)}
        listed = _listed(api, "/projects")
        assert _ids(listed) == sorted(visible), viewer
        for item in listed:
            missions = [
                mission for mission in visible[item["id"]].missions if visibility_model.sees_mission(viewer, mission)
            ]
            files = _visible_files(lab, viewer, missions)
            amounts = (item["mission_count"], item["file_count"], item["size_bytes"])
            assert amounts == (len(missions), len(files), sum(file.size_bytes for file in files)), viewer
            assert api.get(f"/projects/{item['id']}").ok() == item


def test_lists_of_missions_show_only_visible_ones_and_their_totals(lab: Lab) -> None:
    for viewer, api in _viewers(lab):
        visible = {mission.id: mission for mission in lab.missions if visibility_model.sees_mission(viewer, mission)}
        listed = _listed(api, "/missions")
        assert _ids(listed) == sorted(visible), viewer
        for item in listed:
            files = _visible_files(lab, viewer, [visible[item["id"]]])
            amounts = (item["file_count"], item["size_bytes"], item["message_count"])
            expected = (len(files), sum(file.size_bytes for file in files), sum(file.messages for file in files))
            assert amounts == expected, viewer
            assert api.get(f"/missions/{item['id']}").ok() == item


def test_lists_of_recordings_show_only_visible_ones(lab: Lab) -> None:
    for viewer, api in _viewers(lab):
        if not viewer.reads:
            continue
        for mission in _sample(lab, viewer, lab.missions):
            answer = api.get(f"/missions/{mission.id}/recordings")
            if visibility_model.sees_mission(viewer, mission):
                assert set(_ids(answer.ok()["items"])) == visibility_model.recordings(viewer, mission.files), viewer
            else:
                answer.refused(404, "not_found")


def test_lists_of_files_and_topics_show_only_visible_ones(lab: Lab) -> None:
    for viewer, api in _viewers(lab):
        if not viewer.reads:
            api.get("/files").refused(403, "scope_missing")
            continue
        visible = sorted(file.id for file in _visible_files(lab, viewer))
        assert _ids(_listed(api, "/files")) == visible, viewer
        assert _ids(_listed(api, "/topics"), "file_id") == visible, viewer


def test_files_sorted_by_time_show_only_visible_ones(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """The plan for viewers of many missions lists the same files."""
    monkeypatch.setattr(search_plan, "MAX_VISIBLE_MISSIONS", 0)
    for viewer, api in _viewers(lab):
        if not viewer.reads:
            continue
        visible = sorted(file.id for file in _visible_files(lab, viewer))
        for requested in ({}, {"message_type": "std_msgs/String"}):
            assert _ids(api.all("/files", {"sort": "-start", "limit": "50", **requested})) == visible, (
                viewer,
                requested,
            )


def test_searches_and_facets_count_only_visible_files(lab: Lab) -> None:
    """Each number of a search and of its facets is that of visible files only."""
    for viewer, api in _viewers(lab):
        if not viewer.reads:
            continue
        for query, files in _sample(lab, viewer, _queries(lab, viewer)):
            actual = api.get("/search", {"query": query, "limit": "500"}).ok()
            assert _ids(actual["files"]["items"]) == sorted(file.id for file in files), viewer
            assert actual["files"]["total"] == actual["topics"]["total"] == len(files), viewer
            assert sum(item["file_count"] for item in actual["topics"]["items"]) == len(files), viewer
            if query:  # an empty query also finds missions without files
                assert _ids(actual["missions"]["items"]) == sorted({file.mission.id for file in files}), viewer
            facets = {entry["name"]: entry for entry in api.get("/search/facets", {"query": query}).ok()["facets"]}
            projects = Counter(file.mission.project.name for file in files)
            shown = facets.get("project", {"values": []})["values"]
            assert {entry["value"]: entry["file_count"] for entry in shown} == projects, viewer
            assert facets.get("topic", {"value_count": 0})["value_count"] == len(files), viewer


def _queries(lab: Lab, viewer: Viewer) -> list[tuple[str, list[File]]]:
    """Return queries with the visible files that they find."""
    visible = _visible_files(lab, viewer)
    alone = [file for file in visible if file.path == "alone.mcap"]
    return [
        ("", visible),
        ("path:alone.mcap", alone),
        ("-path:split/*", alone),
        ("mission:outing* path:none", []),
        ("topic:/* -path:alone.mcap", [file for file in visible if file not in alone]),
    ]


@pytest.mark.parametrize("by", ["project", "mission", "topic", "format"])
def test_statistics_count_only_visible_files(lab: Lab, by: str) -> None:
    for viewer, api in _viewers(lab):
        if not viewer.reads:
            continue
        files = _visible_files(lab, viewer)
        stats = api.get("/stats", {"by": by}).ok()
        total = stats["total"]
        assert (total["files"], total["size_bytes"]) == (len(files), sum(file.size_bytes for file in files)), viewer
        assert total["missions"] == len({file.mission.id for file in files}), viewer
        assert total["messages"] == sum(file.messages for file in files), viewer
        assert total["recordings"] == len(visibility_model.recordings(viewer, lab.files)), viewer
        groups = {
            "project": {file.mission.project.name for file in files},
            "mission": {f"{file.mission.project.name}/{file.mission.name}" for file in files},
        }
        assert {row["group"] for row in stats["rows"]} == groups.get(by, {row["group"] for row in stats["rows"]})


def test_search_finds_only_visible_missions(lab: Lab) -> None:
    for viewer, api in _viewers(lab):
        for project in _sample(lab, viewer, lab.projects):
            actual = _search(api, "/projects", name=project.name)
            assert actual == ([project.id] if visibility_model.sees_project(viewer, project) else []), viewer
            missions = sorted(
                mission.id for mission in project.missions if visibility_model.sees_mission(viewer, mission)
            )
            files = sorted(file.id for file in _visible_files(lab, viewer, project.missions))
            for query in ({"project": project.name}, {"project_id": project.id}, {"text": project.name}):
                assert _search(api, "/missions", **query) == missions, (viewer, query)
                if viewer.reads:
                    assert _search(api, "/files", **query) == files, (viewer, query)


def _search(api: Api, path: str, **query: str) -> list[str]:
    return _ids(api.get(path, {"limit": "500", **query}).ok()["items"])


def test_hidden_objects_are_not_found_by_id(lab: Lab) -> None:
    for viewer, api in _viewers(lab):
        for project in lab.projects:
            assert api.get(f"/projects/{project.id}").status == (
                200 if visibility_model.sees_project(viewer, project) else 404
            ), viewer
        for file in _sample(lab, viewer, lab.files) if viewer.reads else []:
            sees = visibility_model.sees_file(viewer, file)
            for path in (f"/files/{file.id}", f"/files/{file.id}/topics"):
                assert api.get(path).status == (200 if sees else 404), viewer
            listed = file.recording in visibility_model.recordings(viewer, lab.files)
            assert api.get(f"/recordings/{file.recording}").status == (200 if listed else 404), viewer


def test_the_trash_lists_only_objects_that_the_viewer_owns(lab: Lab) -> None:
    for viewer, api in _viewers(lab):
        answer = api.get("/trash")
        if viewer.secret is None or viewer.is_link or not viewer.reads:
            assert answer.status in {401, 403}
            continue
        places: list[Project | Mission] = [*lab.projects, *lab.missions]
        owned = [place.id for place in places if place.is_deleted and visibility_model.level(viewer, place) == 4]
        owned += [
            file.id for file in lab.files if file.is_deleted and visibility_model.level(viewer, file.mission) == 4
        ]
        assert _ids(_listed(api, "/trash")) == sorted(owned), viewer


def test_the_audit_log_shows_only_projects_that_the_viewer_owns(lab: Lab) -> None:
    for viewer, api in _viewers(lab):
        if viewer.secret is None or viewer.is_link or not viewer.reads:
            continue
        message = {event["project_id"] for event in api.all("/audit", {"limit": "500"})} - {None}
        assert message == {project.id for project in lab.projects if visibility_model.level(viewer, project) == 4}, (
            viewer
        )


def test_the_cursor_of_another_persons_list_shows_only_own_rows(lab: Lab) -> None:
    """A cursor does not reveal hidden objects."""
    admin = next(viewer for viewer in lab.viewers if viewer.is_admin and viewer.reach is None)
    cursor = lab.api.as_(admin.secret).get("/missions", {"limit": "1"}).ok()["next"]
    for viewer, api in _viewers(lab):
        rest = {item["id"] for item in api.get("/missions", {"limit": "500", "cursor": cursor}).ok()["items"]}
        assert rest <= {mission.id for mission in lab.missions if visibility_model.sees_mission(viewer, mission)}, (
            viewer
        )
