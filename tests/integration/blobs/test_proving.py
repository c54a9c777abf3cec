"""Reading an object through: the connection is held for as long as bytes are wanted, and no longer."""

import pytest

from kleinkram.server.blobs.proving import read_through
from kleinkram.server.site import Site
from tests.integration.jobs import on_site
from tests.integration.running import Api
from tests.integration.uploading import upload


def test_a_reader_that_stops_early_gives_its_connection_back_at_once(api: Api) -> None:
    body = bytes(5_000_000)
    file = upload(api, str(api.mission(api.project()["id"])["id"]), "long.bin", body)
    [(key,)] = api.sql("SELECT b.key FROM blob b JOIN file f ON f.blob_id = b.id WHERE f.id = %s", file["id"])

    async def stop(_piece: bytes) -> None:
        raise RuntimeError("enough")

    async def work(site: Site) -> None:
        with pytest.raises(RuntimeError, match="enough"):
            await read_through(site, key, stop)
        connector = site.storage._s3._session.connector
        assert connector is not None
        assert len(connector._acquired) == 0
        assert (await read_through(site, key)).size_bytes == len(body)

    on_site(api, work)
