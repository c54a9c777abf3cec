"""Event streams and their clients when the API restarts."""

import threading
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from kleinkram.client import connect
from kleinkram.contract.audit import Change, Refetch, RefetchReason
from tests.integration.api_server import serving
from tests.integration.event_client import listening
from tests.integration.upload_client import wait_until
from tests.services import RunningPostgres, RunningStore


@pytest.fixture
def settings(postgres: RunningPostgres, store: RunningStore, template_database: str) -> dict[str, Any]:
    """Settings of a server whose database outlives it."""
    name = postgres.create_database(template=template_database)
    return {
        "database_url": postgres.serve_url(name),
        "s3_internal_url": store.endpoint,
        "s3_bucket": store.create_bucket(),
        "s3_access_key": store.access_key,
        "s3_secret_key": store.secret_key,
    }


def test_a_stream_client_continues_after_a_restart(
    settings: dict[str, Any], postgres: RunningPostgres, tmp_path: Path
) -> None:
    admin_url = postgres.migrate_url(settings["database_url"].rpartition("/")[2])
    received: list[Change | Refetch] = []
    last = {"id": ""}
    with serving(settings, admin_url=admin_url, folder=tmp_path) as api:
        project = api.project()
        # The owner's token is another one after the restart.
        client = connect(api.url, api.post("/tokens", {"name": "follower", "scopes": ["read"]}).ok(201)["secret"])

        def follow() -> None:
            for item in client.events.follow(for_s=100):
                received.append(item)
                if isinstance(item, Change) and str(item.id) == last["id"]:
                    return

        follower = threading.Thread(target=follow, name="follower")
        follower.start()
        wait_until(lambda: len(api.app.state.hub._streams) == 1)
        made = api.mission(project["id"])
        wait_until(lambda: any(isinstance(item, Change) and str(item.id) == made["id"] for item in received))
        port = urlsplit(api.url).port or 0
        stopped_at = time.monotonic()
    assert time.monotonic() - stopped_at < 15, "open streams hold up the end of the server"
    with serving(settings, admin_url=admin_url, folder=tmp_path, port=port) as again:
        wait_until(lambda: Refetch(reason=RefetchReason.missed) in received)
        last["id"] = again.mission(project["id"])["id"]
        again.patch(f"/missions/{last['id']}", {"notes": "told after its id is known here"}).ok()
        follower.join(60)
        assert not follower.is_alive()


def test_clients_reload_after_a_restart_of_the_database(
    settings: dict[str, Any], postgres: RunningPostgres, tmp_path: Path
) -> None:
    name = settings["database_url"].rpartition("/")[2]
    with serving(settings, admin_url=postgres.migrate_url(name), folder=tmp_path) as api, listening(api) as ears:
        postgres.sql(
            "SELECT pg_terminate_backend(pid) FROM pg_stat_activity"
            f" WHERE datname = '{name}' AND usename = 'kleinkram_serve'"
        )
        ears.until(lambda: ("refetch", {"reason": "missed"}) in ears.events)
        made = api.project()
        ears.receive(resource_type="project", id=made["id"], change="created")
