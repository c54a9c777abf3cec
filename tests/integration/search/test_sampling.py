"""Searches among very many files: estimated totals, exact lists, a fixed number of statements."""

import uuid
from types import ModuleType
from urllib.parse import urlencode

import pytest

from kleinkram.server.filters import plan
from kleinkram.server.filters import text as text_filters
from kleinkram.server.search import planner
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.sample import Sample

_FILES, _RARE = 120, 2
_LISTS: tuple[tuple[str, dict[str, str]], ...] = (
    ("/projects", {}),
    ("/missions", {}),
    ("/files", {}),
    ("/files", {"sort": "-start"}),
    ("/search", {"query": "drive"}),
    ("/topics", {}),
    ("/search/facets", {}),
)
_KEEP = """
INSERT INTO mission_topic (mission_id, name, message_type, file_count, recording_count, recording_ranges)
VALUES (%s, '/imu', 'Imu', 1, 0, '{}')
"""


@pytest.fixture(name="full", scope="module")
def _full(start_api: StartApi) -> Api:
    """An API with one mission of many files."""
    api, tail = start_api(), uuid.uuid4().hex
    mission = api.mission(api.project(name=f"many {tail}")["id"], name=f"forest {tail}")["id"]
    sample = Sample(api)
    for number in range(_FILES):
        name = "rarely" if number < _RARE else "drive"
        sample.file(mission, f"{name}_{number}.mcap", start_ns=number + 1, end_ns=number + 2, topics=[{"name": "/imu"}])
    return api


def _set_limit(monkeypatch: pytest.MonkeyPatch, module: ModuleType, name: str, value: int) -> None:
    """Change a limit of the search; statements that were built with the old one are not used."""
    monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(plan, "_built", {})


@pytest.fixture(name="sampled")
def _sampled(monkeypatch: pytest.MonkeyPatch) -> int:
    """A sample so small that the files count as very many."""
    _set_limit(monkeypatch, planner, "SAMPLED_FILES", 60)
    return planner.SAMPLED_FILES


def test_a_small_number_of_files_is_counted_exactly(full: Api) -> None:
    result = full.get("/search", {"query": "drive"}).ok()
    assert (result["is_exact"], result["files"]["total"], result["missions"]["total"]) == (True, _FILES - _RARE, 1)
    assert result["topics"]["items"][0]["file_count"] == _FILES - _RARE


def test_an_estimated_total_of_very_many_files_is_declared_as_one(full: Api, sampled: int) -> None:
    result = full.get("/search", {"query": "drive", "limit": "5"}).ok()
    assert not result["is_exact"]
    # Ids are random: of 120 files, the 60th id lies near the middle, and seldom beyond these.
    assert _FILES / 2 < result["files"]["total"] < _FILES * 2
    assert [item["start_ns"] for item in result["files"]["items"]] == [*range(_FILES, _FILES - 5, -1)]
    assert [item["name"] for item in result["topics"]["items"]] == ["/imu"]
    for query in ("drive", "", "drive topic:/imu", "project:many*"):
        facets = full.get("/search/facets", {"query": query}).ok()
        assert not facets["is_exact"]
        assert 0 < facets["file_count"] <= sampled
        (topics,) = (item["values"] for item in facets["facets"] if item["name"] == "topic")
        assert [(item["value"], item["file_count"]) for item in topics] == [("/imu", facets["file_count"])]


def test_a_rare_word_among_very_many_files_finds_all_its_files(full: Api, sampled: int) -> None:
    result = full.get("/search", {"query": "rarely"}).ok()
    assert (result["is_exact"], result["files"]["total"]) == (True, _RARE)
    assert full.get("/search", {"query": "zzyzx"}).ok()["files"] == {"items": [], "next": None, "total": 0}
    facets = full.get("/search/facets", {"query": "rarely"}).ok()
    assert (facets["is_exact"], facets["file_count"]) == (True, _RARE)


@pytest.mark.parametrize("timed_by", ["nothing", "path", "label", "topic", "mission", "project"])
@pytest.mark.usefixtures("sampled")
def test_files_without_a_time_come_last_among_very_many(start_api: StartApi, timed_by: str) -> None:
    api, reported = (
        start_api(),
        dict.fromkeys(["path", "label", "topic", "mission", "project"], "plain") | {timed_by: "sheet"},
    )
    sample, mission = Sample(api), api.mission(api.project(name="of many")["id"], name="of many")["id"]
    ids = [sample.file(mission, f"a/sheet_{number}.yaml") for number in range(_FILES)]
    project = api.project(name=f"{reported['project']} project")["id"]
    timed = sample.file(
        api.mission(project, name=f"{reported['mission']} mission")["id"],
        f"a/{reported['path']}.mcap",
        start_ns=5,
        end_ns=6,
        labels=(f"of {reported['label']}",),
        topics=[{"name": f"/{reported['topic']}"}],
    )
    in_order = ([] if timed_by == "nothing" else [timed]) + sorted(ids, reverse=True)
    for query, shown in (
        ("sheet", set(in_order)),
        ("sheet sheet_1", _holding(api, "sheet_1")),
        ("a sheet", set(in_order)),
    ):
        result = api.get("/search", {"query": query, "limit": "5"}).ok()
        assert [item["id"] for item in result["files"]["items"]] == [item for item in in_order if item in shown][:5], (
            query
        )
        assert query == "sheet sheet_1" or result["is_exact"] == (timed_by != "nothing")
    assert api.get("/search", {"query": "sheet", "sort": "size", "limit": "1"}).ok()["files"]["items"]


@pytest.mark.usefixtures("sampled")
def test_very_many_files_in_one_mission_find_that_mission(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether or not it is among the sampled missions."""
    api = start_api()
    sample, project = Sample(api), api.project(name="of many")["id"]
    missions = [api.mission(project, name=f"plain {number}")["id"] for number in range(6)]
    for mission in missions:
        sample.file(mission, "other.mcap", start_ns=1, end_ns=2)
    full = api.mission(project, name="plain full")["id"]
    for number in range(_FILES):
        sample.file(full, f"sheet_{number}.mcap", start_ns=number + 1, end_ns=number + 2)
    sampled_first = str(api.sql("SELECT id FROM mission ORDER BY id LIMIT 1")[0][0])
    _set_limit(monkeypatch, planner, "SAMPLED_MISSIONS", 1)
    result = api.get("/search", {"query": "sheet"}).ok()
    assert not result["is_exact"]
    assert [item["id"] for item in result["missions"]["items"]] == [full]
    assert result["missions"]["total"] == 1 or sampled_first == full


@pytest.mark.parametrize("globs", [["*sheet*"], ["*sheet*", "*notes*"]])
def test_globs_of_paths_use_both_trigram_indexes(start_api: StartApi, globs: list[str]) -> None:
    api = start_api()
    Sample(api).file(api.mission(api.project(name="of paths")["id"])["id"], "sheet.mcap")
    requested = [("sort", "size"), *(("path", glob) for glob in globs)]
    with api.statements() as statements:
        (result,) = api.get(f"/files?{urlencode(requested)}").ok()["items"]
    assert result["path"] == "sheet.mcap"
    (listed,) = (item for item in statements if "path_key LIKE" in item)
    assert listed.count("start_ns IS NULL AND") == listed.count("start_ns IS NOT NULL AND") == len(globs)


def _holding(api: Api, word: str) -> set[str]:
    return {str(result) for (result,) in api.sql("SELECT id FROM file WHERE path_key LIKE %s", f"%{word}%")}


@pytest.mark.parametrize("query", ["imu", "topic:/imu", "type:Imu", "imu drive"])
@pytest.mark.usefixtures("sampled")
def test_stored_topics_exclude_a_mission_only_where_current_and_complete(
    full: Api, monkeypatch: pytest.MonkeyPatch, query: str
) -> None:
    """Among very many files, which are read mission by mission."""
    ((mission_id,),) = full.sql("SELECT DISTINCT mission_id FROM file WHERE path = 'rarely_0.mcap'")
    full.sql("UPDATE topic SET message_type = 'Imu' WHERE name = '/imu'")

    def is_found() -> bool:
        result = full.get("/search", {"query": query}).ok()
        assert not result["is_exact"]
        in_missions = {item["id"] for item in result["missions"]["items"]}
        in_files = {item["mission"]["id"] for item in result["files"]["items"]}
        assert (str(mission_id) in in_missions) == (str(mission_id) in in_files)
        return str(mission_id) in in_missions

    assert is_found()  # nothing is kept
    full.sql("INSERT INTO mission_topics VALUES (%s, 0, '{}', 1)", mission_id)
    try:
        assert not is_found()
        full.sql(_KEEP, mission_id)
        assert is_found()
        full.sql("UPDATE mission_topic SET name = '/gps', message_type = 'Fix' WHERE mission_id = %s", mission_id)
        assert not is_found()
        with monkeypatch.context() as patch:
            _set_limit(patch, text_filters, "MAX_STORED_TOPICS", 1)
            assert is_found()
        full.sql("UPDATE mission SET files_revision = 1 WHERE id = %s", mission_id)
        assert is_found()
    finally:
        full.sql("DELETE FROM mission_topics WHERE mission_id = %s", mission_id)
        full.sql("UPDATE mission SET files_revision = 0 WHERE id = %s", mission_id)


@pytest.mark.parametrize(("path", "query"), _LISTS)
def test_a_page_of_many_rows_takes_as_many_statements_as_a_page_of_one(
    full: Api, path: str, query: dict[str, str]
) -> None:
    full.get(path, query).ok()  # so that an admin's access is recorded already
    counts = []
    for limit in ("1", "100"):
        requested = query if path == "/search/facets" else {**query, "limit": limit}
        with full.statements() as statements:
            full.get(path, requested).ok()
        counts.append(len(statements))
    assert counts[0] == counts[1] <= 10


@pytest.fixture(name="spread", scope="module")
def _spread(start_api: StartApi) -> tuple[Api, str]:
    """An API, and a word that is said in every place there is, each time of something else."""
    api, word = start_api(), f"w{uuid.uuid4().hex[:12]}"
    sample = Sample(api)
    plain = api.project(name=f"plain {uuid.uuid4().hex}")["id"]
    named = api.project(name=f"in {word} project")["id"]
    for number in range(3):
        in_project = api.mission(named, name=f"a {number}")["id"]
        by_name = api.mission(plain, name=f"{word} {number}")["id"]
        by_metadata = api.mission(plain, name=f"b {number}", metadata={"place": [f"near {word.upper()}"]})["id"]
        by_field = api.mission(plain, name=f"c {number}", metadata={word: "nothing"})["id"]
        for mission in (in_project, by_name, by_metadata, by_field):
            sample.file(mission, "a.mcap", topics=[{"name": "/imu"}])
        sample.file(by_field, f"{word}_{number}.mcap")
        sample.file(by_field, "topic.mcap", topics=[{"name": f"/{word}/{number}"}])
        sample.file(by_field, "type.mcap", topics=[{"name": "/odd", "message_type": f"lab/msg/{word}{number}"}])
        sample.file(by_field, "label.mcap", labels=(f"of {word}",))
    api.mission(plain, name=f"empty {word}")
    return api, word


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        (text_filters, "_MAX_NAMES", 500),
        (text_filters, "_MAX_NAMES", 1),
        (text_filters, "_MAX_NAMES", 0),
        (planner, "_MAX_MATCHED", 2),
        (planner, "COMMON", 0),
    ],
)
def test_a_search_finds_the_same_whichever_plan_it_follows(
    spread: tuple[Api, str], monkeypatch: pytest.MonkeyPatch, module: ModuleType, name: str, value: int
) -> None:
    api, word = spread
    _set_limit(monkeypatch, module, name, value)
    queries = ((word, 21, 13), (f"{word} imu", 9, 9), (f"{word} {word}_1", 1, 1), (f"-{word}", 3, 3))
    for query, files, missions in queries:
        result = api.get("/search", {"query": query, "limit": "50"}).ok()
        assert (result["files"]["total"], result["missions"]["total"]) == (files, missions), query
        assert len(result["files"]["items"]) == files
        assert len(result["missions"]["items"]) == missions


def test_a_common_word_lists_what_a_rare_one_does(spread: tuple[Api, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading a list in its order finds the same files and missions as looking them up."""
    api, word = spread
    rare = api.get("/search", {"query": word, "limit": "50"}).ok()
    size = api.sql("SELECT count(*) FROM file")[0][0]
    _set_limit(monkeypatch, planner, "SAMPLED_FILES", size)
    _set_limit(monkeypatch, planner, "_COMMON_WITHOUT_INDEX", 0)
    _set_limit(monkeypatch, planner, "COMMON", 1)
    common = api.get("/search", {"query": word, "limit": "50"}).ok()
    assert (rare["is_exact"], common["is_exact"]) == (True, False)
    for kind in ("files", "missions"):
        assert [item["id"] for item in common[kind]["items"]] == [item["id"] for item in rare[kind]["items"]]
