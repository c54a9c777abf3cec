"""Concurrent searches of several people use each person's own words and rights."""

import uuid
from collections.abc import Iterator

import pytest

from kleinkram.contract.access import Right
from kleinkram.server.filters import plan as search_plan
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.sample import Sample

_READERS, _TOPICS = 2, ("/imu", "/gps")


@pytest.fixture(name="readers", params=[True, False], ids=["sees many", "sees few"])
def _readers(start_api: StartApi, request: pytest.FixtureRequest) -> Iterator[list[tuple[Api, str, str]]]:
    """People who each see one mission, its id, and the word that names it alone."""
    api, result = start_api(), []
    sample = Sample(api)
    for number in range(_READERS):
        word = f"w{uuid.uuid4().hex[:12]}"
        project = api.project(name=f"project {word}")["id"]
        mission = api.mission(project, name=f"mission {word}", metadata={"robot": word})["id"]
        sample.file(mission, "drive.mcap", labels=(word,), topics=[{"name": _TOPICS[number]}])
        reader = people.person(api)
        people.grant(api, reader, Right.read, project_id=project)
        result.append((api.as_(people.token(api, reader).secret), mission, word))
    with pytest.MonkeyPatch.context() as patch:
        if request.param:
            patch.setattr(search_plan, "MAX_VISIBLE_MISSIONS", 0)
        yield result


@pytest.mark.parametrize("query", ["{}", "drive", "drive {}", "meta.robot={}", "{} -word_0", "label:{}", ""])
def test_everyone_finds_only_what_their_own_query_and_rights_allow(
    readers: list[tuple[Api, str, str]], query: str
) -> None:
    for api, mission, word in [*readers, *readers]:
        for sort in ("-start", "path"):
            result = api.get("/search", {"query": query.format(word), "sort": sort}).ok()
            assert [item["mission"]["id"] for item in result["files"]["items"]] == [mission]
            assert {item["id"] for item in result["missions"]["items"]} <= {mission}
            assert (result["files"]["total"], result["topics"]["total"], result["is_exact"]) == (1, 1, True)
        facets = api.get("/search/facets", {"query": query.format(word)}).ok()
        assert facets["file_count"] == 1
        (labels,) = (item["values"] for item in facets["facets"] if item["name"] == "label")
        assert [item["value"] for item in labels] == [word]


def test_a_word_in_other_peoples_missions_finds_nothing(readers: list[tuple[Api, str, str]]) -> None:
    words = [word for *_, word in readers]
    for (api, *_), others in zip(readers, reversed(words), strict=True):
        assert api.get("/search", {"query": others}).ok()["files"]["total"] == 0
        assert api.get("/search", {"query": f"drive {others}"}).ok()["missions"]["total"] == 0
