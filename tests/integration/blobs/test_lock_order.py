"""One lock order: storing results about a blob and linking it do not deadlock."""

import os
import uuid
from collections.abc import Awaitable, Callable

import pytest

from kleinkram.recordings import Content, RecordingFormat, RecordingSummary
from kleinkram.server.blobs import service
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from tests.integration.api_server import Api
from tests.integration.jobs import on_site
from tests.integration.races import racing
from tests.integration.upload_client import begin, upload

_Keep = Callable[[Connection, uuid.UUID], Awaitable[None]]


async def _summary(db: Connection, blob_id: uuid.UUID) -> None:
    await service.record_summaries(db, {blob_id: RecordingSummary(RecordingFormat.unknown, Content.opaque)})


async def _failure(db: Connection, blob_id: uuid.UUID) -> None:
    await service.record_read_failure(db, blob_id, "it could not be read")


@pytest.mark.parametrize("keep", [_summary, _failure])
@pytest.mark.parametrize("link_first", [True, False])
def test_a_blob_is_linked_while_its_summary_is_stored(api: Api, keep: _Keep, link_first: bool) -> None:
    mission_id = api.mission(api.project()["id"])["id"]
    body = os.urandom(1000)
    file = upload(api, mission_id, "a.bin", body)
    [[blob_id]] = api.sql("SELECT blob_id FROM file WHERE id = %s", file["id"])

    def link() -> str:
        return str(begin(api, mission_id, {"b.bin": body})[0]["decision"])

    def read() -> str:
        async def work(context: AppContext) -> str:
            async with context.database.begin() as db:
                await keep(db, blob_id)
            return "kept"

        return on_site(api, work)

    with racing(api, "SELECT 1 FROM blob WHERE id = %s FOR UPDATE", blob_id) as send:
        works = [send(work) for work in ([link, read] if link_first else [read, link])]
    assert {work.result(30) for work in works} == {"deduplicated", "kept"}


@pytest.mark.parametrize("link_first", [True, False])
def test_a_linked_file_has_the_start_of_its_blob_in_either_order_of_reading_and_linking(
    api: Api, link_first: bool
) -> None:
    mission_id = api.mission(api.project()["id"])["id"]
    body = os.urandom(1000)
    file = upload(api, mission_id, "a.bin", body)
    [[blob_id]] = api.sql("SELECT blob_id FROM file WHERE id = %s", file["id"])
    read = RecordingSummary(RecordingFormat.mcap, Content.indexed, start_ns=5, end_ns=9)

    def link() -> None:
        assert begin(api, mission_id, {"b.bin": body})[0]["decision"] == "deduplicated"

    def keep() -> None:
        async def work(context: AppContext) -> None:
            async with context.database.begin() as db:
                await service.record_summaries(db, {blob_id: read})

        on_site(api, work)

    with racing(api, "SELECT 1 FROM blob WHERE id = %s FOR UPDATE", blob_id) as send:
        works = [send(work) for work in ([link, keep] if link_first else [keep, link])]
    for work in works:
        work.result(30)
    starts = "SELECT path, file.start_ns FROM file WHERE blob_id = %s ORDER BY path"
    assert api.sql(starts, blob_id) == [("a.bin", 5), ("b.bin", 5)]
    api.sql("UPDATE blob SET start_ns = NULL, end_ns = NULL WHERE id = %s", blob_id)
    assert api.sql(starts, blob_id) == [("a.bin", None), ("b.bin", None)]
