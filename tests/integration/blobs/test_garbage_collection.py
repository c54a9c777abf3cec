"""Unreferenced blobs are marked for deletion: all at once, or in batches where there are very many."""

import uuid

import pytest

from kleinkram.server.blobs import garbage_collection
from kleinkram.server.context import AppContext
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site
from tests.integration.sample import Sample

_ORPHANS = 100


async def _mark(context: AppContext) -> int:
    async with context.database.begin() as db:
        return await garbage_collection.mark_unreferenced(db, limit=1000)


def _marked(api: Api) -> set[str]:
    return {str(row[0]) for row in api.sql("SELECT id FROM blob WHERE marked_for_deletion_at IS NOT NULL")}


def test_garbage_collection_checks_many_blobs_in_shares(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    api = start_api()
    sample = Sample(api)
    mission_id = api.mission(api.project()["id"])["id"]
    remaining = [sample.file(mission_id, f"{number}.bin") for number in range(5)]
    orphans = {sample.blob() for _ in range(_ORPHANS)}
    # The first and the last ids there are, and those on both sides of where one turn ends.
    edge = 2**128 // garbage_collection._SHARES
    orphans |= {sample.blob(id=str(uuid.UUID(int=number))) for number in (0, edge - 1, edge, 2**128 - 1)}
    monkeypatch.setattr(garbage_collection, "_MAX_AT_ONCE", 10)
    counts = []
    for turn in range(garbage_collection._SHARES):
        monkeypatch.setattr(garbage_collection, "_current_share", lambda turn=turn: turn)
        counts.append(on_site(api, _mark))
    assert _marked(api) == orphans
    assert sum(counts) == len(orphans)
    assert max(counts) < len(orphans) / 3
    assert len(api.all("/files", {"mission_id": mission_id})) == len(remaining)


def test_a_small_number_of_blobs_is_checked_at_once(start_api: StartApi) -> None:
    api = start_api()
    orphans = {Sample(api).blob() for _ in range(10)}
    assert on_site(api, _mark) == len(orphans)
    assert _marked(api) == orphans
    assert 0 <= garbage_collection._current_share() < garbage_collection._SHARES
