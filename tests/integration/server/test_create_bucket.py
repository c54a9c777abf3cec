"""`python -m kleinkram.server create-bucket`."""

import asyncio
import os

import pytest

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.server.s3.bucket import create_bucket
from kleinkram.server.settings import Settings
from tests.klein import run_server
from tests.ports import choose_port
from tests.services import RunningStore


def _settings(store: RunningStore, **changes: str) -> Settings:
    values = {
        "database_url": "postgresql://unused@127.0.0.1/unused",
        "s3_internal_url": store.endpoint,
        "s3_bucket": f"created-{choose_port()}",
        "s3_access_key": store.access_key,
        "s3_secret_key": store.secret_key,
        "s3_region": store.region,
    }
    return Settings.model_validate({**values, **changes})


def test_the_bucket_is_created_once(store: RunningStore) -> None:
    settings = _settings(store)
    environment = {
        f"KLEINKRAM_{name.upper()}": str(getattr(settings, name))
        for name in ("database_url", "s3_internal_url", "s3_bucket", "s3_access_key", "s3_region")
    }
    environment["KLEINKRAM_S3_SECRET_KEY"] = store.secret_key
    for outcome in ("was created", "exists"):
        done = run_server(["create-bucket"], {**os.environ, **environment})
        assert (done.returncode, done.stdout) == (0, f"The bucket {settings.s3_bucket} {outcome}.\n"), done.stderr


def test_a_region_is_named(store: RunningStore) -> None:
    assert asyncio.run(create_bucket(_settings(store, s3_region="eu-central-1"), timeout_s=0))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"s3_access_key": "nobody"}, "it does not know the access key: correct KLEINKRAM_S3_ACCESS_KEY"),
        ({"s3_secret_key": "wrong"}, "the secret key does not fit the access key: correct KLEINKRAM_S3_SECRET_KEY"),
        ({"s3_internal_url": "http://127.0.0.1:1"}, "it does not answer: Connect call failed ('127.0.0.1', 1)"),
    ],
)
def test_a_refusal_is_explained(store: RunningStore, changes: dict[str, str], reason: str) -> None:
    with pytest.raises(StoreUnavailable) as refused:
        asyncio.run(create_bucket(_settings(store, **changes), timeout_s=0))
    assert refused.value.reason == reason
