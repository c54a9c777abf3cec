"""Reading an object through: the connection is held for as long as bytes are wanted, and no longer."""

import pytest

from kleinkram.server.blobs.proving import read_through
from kleinkram.server.site import Site
from tests.integration.jobs import on_site
from tests.integration.running import Api


def test_a_reader_that_stops_early_gives_its_connection_back_at_once(api: Api) -> None:
    async def stop(_piece: bytes) -> None:
        raise RuntimeError("enough")

    async def work(site: Site) -> None:
        body = bytes(1_000_000)
        await site.storage.put_small("long", body)
        with pytest.raises(RuntimeError, match="enough") as stopped:
            await read_through(site, "long", stop)
        print("ACQ", len(site.storage._s3._session.connector._acquired))
        connector = site.storage._s3._session.connector
        assert connector is not None
        assert (len(connector._acquired), stopped.type) == (0, RuntimeError)
        assert (await read_through(site, "long")).size_bytes == len(body)
        await site.storage.delete("long")

    on_site(api, work)
